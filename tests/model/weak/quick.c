/* SPDX-License-Identifier: Apache-2.0
 *
 * E3, E5: a frame is written twice while its newest record is read; so the copy beside the lock that was in force is
 * overwritten under the reader.  What is read is the record of S's own version, whole, or nothing.
 */
#include "scenario.h"

static void *turner(void *unused) {
    (void)unused;
    write_frames(0, 1, 0, 2, false);
    write_frames(0, 1, 0, 3, false);
    return NULL;
}

static void *reader(void *unused) {
    (void)unused;
    uint64_t snapshot = snapshot_now(), version, number = newest(snapshot, 1, &version);
    assert(!version || (version == commit_version(snapshot) && number == version));
    return NULL;
}

int main(void) {
    pthread_t t[2];
    make_segment();
    write_frames(0, 1, 0, 1, false);
    pthread_create(&t[0], NULL, turner, NULL);
    pthread_create(&t[1], NULL, reader, NULL);
    pthread_join(t[0], NULL);
    pthread_join(t[1], NULL);
    return 0;
}
