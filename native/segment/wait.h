/* SPDX-License-Identifier: Apache-2.0
 *
 * The bell: how a commit wakes those who sleep, when somebody sleeps.
 *
 * Problem.  A futex wake is a system call, worth several commits; nobody should pay it when nobody waits.  Waiters must
 * therefore announce themselves, but readers do not write to the store.  So the announcement has a small file of its
 * own, named after the store's uuid, writable by those who may write the store.
 *
 * Protocol.  Frames are hashed into buckets, each with a futex word, and one bit in `armed`.
 *   waiter:  w = word;  set the bit (seq_cst);  look at a fresh commit (seq_cst);  nothing there: sleep while word == w
 *   writer:  commit (seq_cst);  bits = armed (seq_cst);  for those it touched: clear the bit, word + 1, wake all
 * The two seq_cst pairs cross (E9): either the writer sees the bit or the waiter sees the commit.  A bit set before the
 * writer clears it belongs to a waiter whose w is older than word + 1, so its sleep ends at once.
 *
 * A killed waiter leaves a bit: one wake too many.  A writer killed between clearing and waking leaves sleepers, which
 * look again by themselves after 100 ms.  Who may not open the bell polls.
 */
#ifndef SHMTF_SEGMENT_WAIT_H
#define SHMTF_SEGMENT_WAIT_H

#include "segment/atomic.h"
#include "segment/map.h"

enum {
    BELL_BUCKETS = 512,
    BELL_WORDS = BELL_BUCKETS / 64,
    BELL_ANY = 0,   /* rung by every commit */
    BELL_SHAPE = 1, /* rung by commits that change the tree's shape, which ring all others too */
    BELL_MAX_WAIT = 32
};

typedef struct {
    shmtf_word armed[BELL_WORDS];
    shmtf_word32 word[BELL_BUCKETS];
} bell;

typedef struct {
    uint64_t bits[BELL_WORDS];
} bell_set;

static inline unsigned bell_bucket(uint32_t frame_id) { return 2 + frame_id % (BELL_BUCKETS - 2); }
static inline void bell_add(bell_set *set, unsigned bucket) { set->bits[bucket / 64] |= 1ull << bucket % 64; }

/* Open the bell of the store with this uuid, or make it if `file`'s owner is us.  NULL if that may not be. */
bell *bell_open(const uint64_t uuid[2], const map_file *file);
void bell_close(bell *b);
void bell_path(const uint64_t uuid[2], char path[64]);
/* Its name: 0 or an errno value.  A bell that is open goes on to ring. */
int bell_remove(const uint64_t uuid[2]);

/* After a commit: does anybody wait for anything? */
static inline bool bell_is_armed(const bell *b) {
    uint64_t bits = 0;
    for (int i = 0; i < BELL_WORDS; i++) bits |= load_seq_cst(&b->armed[i]); /* [E9 seq_cst] */
    return bits != 0;
}
/* Then: wake whoever waits for what the commit touched. */
void bell_ring(bell *b, const bell_set *touched);

/* Announce interest in up to BELL_MAX_WAIT buckets; seen[i]: what bell_sleep needs. */
void bell_arm(bell *b, const unsigned *buckets, unsigned n, uint32_t *seen);
/* Sleep until one of them is rung, at most timeout_ns.  0: look again; EINTR: a signal handler ran. */
int bell_sleep(bell *b, const unsigned *buckets, unsigned n, const uint32_t *seen, int64_t timeout_ns);

/* CLOCK_MONOTONIC and CLOCK_REALTIME in ns; a sleep of ns, EINTR if a signal handler ran. */
int64_t clock_monotonic_ns(void);
int64_t clock_realtime_ns(void);
int clock_sleep_ns(int64_t ns);

#endif
