/* SPDX-License-Identifier: Apache-2.0
 *
 * E10: a writer is killed (-DCRASH_AT: before its k-th store), then the kernel drops its lock; who asks the kernel and
 * finds it dropped must not undo what was committed.
 */
#define MORTAL
#include "scenario.h"

static shmtf_word kernel_lock = 1; /* the kernel's lock on the slot */

static void on_death(void) { store_release(&kernel_lock, 0); }

static void *victim(void *unused) {
    (void)unused;
    mortal = true;
    write_frames(0, 1, 0, 1, false);
    on_death();
    return NULL;
}

static void *finder(void *unused) {
    (void)unused;
    uint64_t lock = load_relaxed(&frames[1].lock);
    if (lock_owned(lock) && load_relaxed(&kernel_lock) == 0) recover_dead(&s, 1, lock);
    return NULL;
}

int main(void) {
    pthread_t t[2];
    uint64_t version;
    make_segment();
    dies = on_death;
    pthread_create(&t[0], NULL, victim, NULL);
    pthread_create(&t[1], NULL, finder, NULL);
    pthread_join(t[0], NULL);
    pthread_join(t[1], NULL);
    recover_adopt(&s, 0);
    assert(newest(snapshot_now(), 1, &version) == commit_version(snapshot_now()));
    return 0;
}
