/* SPDX-License-Identifier: Apache-2.0
 *
 * A reader-writer lock in one word: the number of readers, or RW_WRITER.  Between processes, in the frame's own line.
 * Readers pass waiting writers, as in the thesis.  The word names no owner: who dies holding it leaves it held for ever.
 */
#ifndef SHMTF_BENCH_RWLOCK_H
#define SHMTF_BENCH_RWLOCK_H

#include "baseline.h"

#define RW_WRITER (1ull << 63)

/* Each first tries what is so when nobody else is about: the line comes once, to be written. */
static inline void rw_read_lock(shmtf_word *lock) {
    uint64_t readers = 0;
    for (unsigned turn = 0; !cas_acq_rel(lock, readers, readers + 1);) { /* acquire: after the last writer's release */
        while ((readers = load_relaxed(lock)) & RW_WRITER) baseline_pause(&turn);
    }
}

static inline void rw_read_unlock(shmtf_word *lock) {
    uint64_t readers = 1;
    while (!cas_acq_rel(lock, readers, readers - 1)) readers = load_relaxed(lock); /* release: our loads are done */
}

static inline bool rw_write_try(shmtf_word *lock) {
    return cas_acq_rel(lock, 0, RW_WRITER); /* acquire: after every reader's and writer's release */
}

static inline void rw_write_lock(shmtf_word *lock) {
    for (unsigned turn = 0; !rw_write_try(lock);) {
        while (load_relaxed(lock)) baseline_pause(&turn);
    }
}

static inline void rw_write_unlock(shmtf_word *lock) { store_release(lock, 0); }

#endif
