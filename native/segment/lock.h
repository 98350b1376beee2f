/* SPDX-License-Identifier: Apache-2.0
 *
 * The words of the commit protocol: how owners, versions and heads are packed, and the one question that decides
 * everything: is that transaction committed?
 *
 * A lock is never a bare bit.  It is the identity of a transaction, and transaction numbers of a slot are never
 * used twice, not even by another process that inherits the slot.  So a lock word occurs once in a segment's life,
 * and every repair can be a compare-and-swap from a value that cannot come back: it may be done by anybody, any
 * number of times, dying anywhere.  A free lock keeps the number of its last owner for the same reason.
 */
#ifndef SHMTF_SEGMENT_LOCK_H
#define SHMTF_SEGMENT_LOCK_H

#include "segment/atomic.h"

#define LOCK_OWNED (1ull << 63)
#define LOCK_SEL (1ull << 62)
#define LOCK_SLOT_SHIFT 52
#define LOCK_TXN_MASK ((1ull << 52) - 1)

static inline uint64_t lock_make(unsigned slot, uint64_t txn) {
    return LOCK_OWNED | (uint64_t)slot << LOCK_SLOT_SHIFT | (txn & LOCK_TXN_MASK);
}
static inline bool lock_owned(uint64_t lock) { return (lock & LOCK_OWNED) != 0; }
static inline unsigned lock_sel(uint64_t lock) { return (unsigned)(lock >> 62) & 1; }
static inline unsigned lock_slot(uint64_t lock) { return (unsigned)(lock >> LOCK_SLOT_SHIFT) & 0x3ff; }
static inline uint64_t lock_txn(uint64_t lock) { return lock & LOCK_TXN_MASK; }
/* What the records of this lock's transaction carry as tag. */
static inline uint64_t lock_tag(uint64_t lock) { return lock & ~LOCK_SEL; }
/* Unlock, nothing happened.  Unlock, and the other head is in force. */
static inline uint64_t lock_released(uint64_t lock) { return lock & ~LOCK_OWNED; }
static inline uint64_t lock_applied(uint64_t lock) { return (lock & ~LOCK_OWNED) ^ LOCK_SEL; }

/* In a frame's `want`, where no lock's sel has a meaning: the one who waits has priority. */
#define WISH_PRIORITY LOCK_SEL
static inline bool wish_first(uint64_t want) { return (want & WISH_PRIORITY) != 0; }

#define VERSION_MASK ((1ull << 54) - 1)
static inline uint64_t commit_make(unsigned slot, uint64_t version) { return (uint64_t)slot << 54 | version; }
static inline uint64_t commit_version(uint64_t commit) { return commit & VERSION_MASK; }
static inline unsigned commit_slot(uint64_t commit) { return (unsigned)(commit >> 54); }

#define STATE_ACTIVE 0ull
#define STATE_PREPARED (1ull << 62)
#define STATE_COMMITTED (2ull << 62)
#define STATE_KIND_MASK (3ull << 62)
#define STATE_TOPOLOGY (1ull << 61)
static inline uint64_t state_kind(uint64_t state) { return state & STATE_KIND_MASK; }
static inline uint64_t state_version(uint64_t state) { return state & VERSION_MASK; }

/* Was the transaction that `slot` ran when its state was `state` committed, as far as a reading `commit` of the
 * commit word, taken *before* the state, can tell?  PREPARED counts only while the commit word names exactly it:
 * whoever moves the word on has turned the state into COMMITTED before. */
static inline bool state_decided(uint64_t commit, unsigned slot, uint64_t state) {
    uint64_t kind = state_kind(state);
    return kind == STATE_COMMITTED || (kind == STATE_PREPARED && commit == commit_make(slot, state_version(state)));
}

#define HEAD_INDEXED (1ull << 63)
#define HEAD_BIG (1ull << 62)
#define HEAD_COUNT_MASK ((1ull << 48) - 1)
#define HEAD_FLIP_MASK 0x3fffull
static inline uint64_t head_count(uint64_t head) { return head & HEAD_COUNT_MASK; }
static inline uint64_t head_flips(uint64_t head) { return head >> 48 & HEAD_FLIP_MASK; }
static inline uint64_t head_make(uint64_t count, uint64_t flips, uint64_t bits) {
    return (count & HEAD_COUNT_MASK) | (flips & HEAD_FLIP_MASK) << 48 | bits;
}

#endif
