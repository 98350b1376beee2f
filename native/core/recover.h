/* SPDX-License-Identifier: Apache-2.0
 *
 * What to do with a lock found taken.
 *
 * A decided transaction is finished by whoever meets it.  An undecided one belongs to its owner while the owner lives;
 * who lives is a question to the kernel, asked above this layer.  Of a dead owner the commit word and the state are
 * read again, in this order, after its death is known: it may have committed before it died.
 */
#ifndef SHMTF_CORE_RECOVER_H
#define SHMTF_CORE_RECOVER_H

#include "core/ring.h"

typedef enum {
    RESOLVED, /* the lock has moved on, or was finished here: look again */
    UNDECIDED /* its owner has not committed, and is not known to be dead */
} resolve_status;

/* *helped: a committed transaction's frame was finished, *recovered: a dead one's was undone. */
resolve_status recover_resolve(const shmtf_segment *s, uint32_t id, uint64_t lock, bool *helped, bool *recovered);

/* The caller knows that the owner is dead for ever. */
void recover_dead(const shmtf_segment *s, uint32_t id, uint64_t lock);

/* Take over a writer slot.  The caller holds the slot's kernel lock, so its last owner is dead; a kill in here leaves
 * the slot to the next.  Finishes or undoes all that the dead left.  Returns the slot's new live_from. */
uint64_t recover_adopt(const shmtf_segment *s, unsigned slot);

/* Is the writer that left its lock word in a `want` no longer in that transaction? */
bool recover_want_stale(const shmtf_segment *s, uint64_t want);

/* Help the transaction named by `commit` to COMMITTED, so that the commit word may move on. */
void recover_settle(const shmtf_segment *s, uint64_t commit);

#endif
