/* SPDX-License-Identifier: Apache-2.0
 *
 * usage: waker STORE FRAME STAMP K
 *
 * Writes one record below "root", and kills itself before its K-th access to shared memory after the commit: unlocking, and
 * waking who waits.  Exit code 0: there were fewer.  Tier: test.
 */
#define _GNU_SOURCE
#include "../soak/crowd.h"
#include "segment/atomic.h"
#include "segment/failpoint.h"

static long left = -1;
static int committed;

void shmtf_step(int kind, const void *at) {
    (void)kind;
    (void)at;
    if (committed && left-- == 0) kill(getpid(), SIGKILL);
}

void shmtf_failpoint(const char *name) { committed |= left >= 0 && !strcmp(name, "committed"); }

int main(int argc, char **argv) {
    shmtf_error e;
    if (argc < 5) return 2;
    shmtf_store *h = join(argv[1], 0);
    shmtf_transform t = crowd_edge("root", argv[2], atoll(argv[3]), 0);
    left = atol(argv[4]);
    if (shmtf_set_transforms(h, &t, 1, NULL, NULL, &e)) stop("write", &e);
    committed = 0;
    shmtf_close(h);
    return 0;
}
