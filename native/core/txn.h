/* SPDX-License-Identifier: Apache-2.0
 *
 * Transactions: two-phase locking with NoWait, and one word whose change is the commit.
 *
 *   1. a new transaction number, state ACTIVE
 *   2. growing phase: every frame's lock, in id order, none waited for
 *   3. checks, then records staged behind the heads; new names are bound but not visible
 *   4. the head to come, into the half that is not in force
 *   5. read the commit word g; what was checked about other frames must still hold at g; help g's transaction to
 *      COMMITTED; tags and state PREPARED(version of g + 1)
 *   6. CAS the commit word from g to {slot, version + 1}: everything is visible, or, if somebody committed since g,
 *      nothing is and 5 is done again
 *   7. state COMMITTED; shrinking phase: each unlock puts the other head in force
 *
 * A death before 6 leaves locks, which anybody releases; after 6, work that anybody finishes.  There is no log.
 *
 * What was checked about other frames, namely that parents exist, that no cycle arises, that a name is absent and that
 * nothing was cleared, can only be changed by a commit that changes the tree's shape; one word says when that was last.
 */
#ifndef SHMTF_CORE_TXN_H
#define SHMTF_CORE_TXN_H

#include "core/tree.h"

typedef struct {
    ring_writer w;
    bool born;    /* bound to its name by this transaction */
    bool reshapes; /* changes the tree's shape */
    bool claimed;  /* its ring was claimed by this transaction */
} txn_entry;

/* What outlives a transaction: a writer slot, and memory for the work.  Used by one thread at a time. */
typedef struct {
    const shmtf_segment *s;
    unsigned slot;
    uint64_t live_from; /* of the slot, as we set it: if it moved, the slot is not ours any more */
    txn_entry *entries; /* max_frames + 1 */
    uint64_t *parents;  /* per entry: the frame's newest parent once this commits, as in a record; 0: none */
    uint32_t *entry_of; /* per frame id: 0, or 1 + index of its entry */
    uint32_t *mark;     /* per frame id, for tree_find_cycle */
    uint32_t climbs;
    local_hint64 *checked; /* per frame id: topology version at which its parent was last seen alive; of the handle */
    /* the transaction at hand */
    uint64_t own;       /* its lock word */
    uint64_t snapshot, topology;
    tree_clears clears;
    bool reshapes;
    bool yields;        /* gives way to announced wishes: once an operation, or a stopped waiter would hold up others */
    bool defers;        /* gives way to those with priority: to each once, for the same reason */
    uint64_t deferred_to; /* the last of them */
    bool pushing;       /* waits for locks, in id order, and announces it */
    bool priority;      /* its wishes go before those of others, and it gives way to nobody */
    size_t n;
    uint64_t n_staged;
    uint32_t blocked_id; /* with TXN_HELD: the frame, and the lock or wish that is in the way */
    uint64_t blocked_by;
    bool wished;         /* it is a wish */
    uint64_t helps, recoveries, late_dropped, repeats;
} txn;

typedef enum {
    TXN_OK,
    TXN_HELD,     /* an undecided transaction is in the way: blocked_id, blocked_by */
    TXN_RETRY,    /* what was checked has changed: begin again */
    TXN_LOST,     /* the slot was taken from us: never write again */
    TXN_CORRUPT,
    TXN_FULL_FRAMES, /* no free frame */
    TXN_FULL_NAMES,  /* the name table is full around this name */
    TXN_FULL_ARENA   /* no room for a ring */
} txn_status;

txn_status txn_begin(txn *x);
/* Lock a frame.  Already locked by this transaction: fine.  *entry may be NULL. */
txn_status txn_lock_try(txn *x, uint32_t id, txn_entry **entry);
/* Lock frames, in ascending order of their ids, until one cannot be had. */
txn_status txn_lock_all(txn *x, const uint32_t *id, size_t n);
/* Take a free frame and bind it to a name. */
txn_status txn_birth(txn *x, const name_key *key, shmtf_frame *frame, txn_entry **entry);
/* The frame's big ring, claimed if it has none; log2: the size to claim. */
txn_status txn_need_ring(txn *x, txn_entry *e, unsigned log2);
/* Stage a record of a kind that has no order: it begins a segment in the inline ring. */
txn_status txn_put_mark(txn *x, txn_entry *e, record_kind kind, uint64_t flags, uint64_t parent, int64_t arrival,
                        uint16_t writer);
/* All or nothing, at this moment.  Not TXN_OK: everything was released, nothing was written. */
txn_status txn_commit(txn *x, uint64_t *version);
/* The same where nothing was staged because it was all there already: *version is that of a commit at which it was. */
txn_status txn_commit_nothing(txn *x, uint64_t *version);
/* Release everything, nothing happened. */
void txn_abort(txn *x);
/* Announce, or take back, that this transaction waits for a frame.  One wish stands at a time: the first, but one with
 * priority takes the place of one without. */
void txn_want(txn *x, uint32_t id);
void txn_unwant(txn *x, uint32_t id);
/* No cycle arises among the newest records: TXN_OK; else the frame in *cyclic and *found. */
txn_status txn_check_cycles(txn *x, uint32_t *cyclic, bool *found);

static inline txn_entry *txn_entry_for(const txn *x, uint32_t id) {
    uint32_t at = x->entry_of[id];
    return at ? &x->entries[at - 1] : NULL;
}
static inline uint64_t *txn_parent_of(const txn *x, const txn_entry *e) { return &x->parents[e - x->entries]; }

#endif
