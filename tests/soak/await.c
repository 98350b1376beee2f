/* SPDX-License-Identifier: Apache-2.0
 *
 * usage: await STORE FRAME SINCE
 *
 * Says "waiting", sleeps without a time limit until the frame has a record newer than SINCE, and prints the commit that it
 * saw.  Tier: test.
 */
#define _GNU_SOURCE
#include "crowd.h"

int main(int argc, char **argv) {
    shmtf_error e;
    if (argc < 4 || prctl(PR_SET_PDEATHSIG, SIGKILL)) return 2;
    uint64_t version, since = strtoull(argv[3], NULL, 10);
    shmtf_store *h = join(argv[1], SHMTF_READONLY);
    const shmtf_ref frame = shmtf_by_name(argv[2]);
    printf("waiting\n");
    fflush(stdout);
    if (shmtf_wait_for_change(h, &frame, 1, since, -1, &version, &e)) stop("wait", &e);
    printf("%llu\n", (unsigned long long)version);
    shmtf_close(h);
    return 0;
}
