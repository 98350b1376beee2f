/* SPDX-License-Identifier: Apache-2.0
 *
 * E4, E5: two writers of one frame; who meets the other's lock after the commit finishes it, and builds upon it.
 */
#include "scenario.h"

static void *first(void *unused) {
    (void)unused;
    write_frames(0, 1, 0, 1, false);
    return NULL;
}

static void *second(void *unused) {
    (void)unused;
    write_frames(1, 1, 0, 2, false);
    return NULL;
}

int main(void) {
    pthread_t t[2];
    uint64_t version;
    make_segment();
    pthread_create(&t[0], NULL, first, NULL);
    pthread_create(&t[1], NULL, second, NULL);
    pthread_join(t[0], NULL);
    pthread_join(t[1], NULL);
    newest(snapshot_now(), 1, &version);
    assert(version == commit_version(snapshot_now()));
    assert(head_count(frames[1].head[lock_sel(frames[1].lock)]) == version); /* nothing was written over */
    return 0;
}
