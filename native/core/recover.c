/* SPDX-License-Identifier: Apache-2.0 */
#include "core/recover.h"
#include "segment/failpoint.h"

void recover_settle(const shmtf_segment *s, uint64_t commit) {
    unsigned slot = commit_slot(commit);
    uint64_t version = commit_version(commit);
    if (slot >= s->geo.max_writers || !version) return;
    uint64_t state = load_acquire(&s->writers[slot].state); /* [E4 acquire] */
    if (state_kind(state) != STATE_PREPARED || state_version(state) != version) return;
    if (state & STATE_TOPOLOGY) raise_to(&s->global->topology, version); /* [E6 release] */
    cas_acq_rel(&s->writers[slot].state, state, (state & ~STATE_KIND_MASK) | STATE_COMMITTED);
}

/* One look: finish the frame if its transaction is decided. */
static bool finish_if_decided(const shmtf_segment *s, uint32_t id, uint64_t lock, bool *gone) {
    unsigned slot = lock_slot(lock);
    uint64_t commit = load_acquire(&s->global->commit); /* [E2 acquire] */
    uint64_t state = load_acquire(&s->writers[slot].state); /* [E4 acquire] */
    *gone = load_acquire(&s->frames[id].lock) != lock; /* unchanged: the state is that transaction's */
    if (*gone || !state_decided(commit, slot, state)) return false;
    ring_apply(s, id, lock, state_version(state));
    return true;
}

void recover_dead(const shmtf_segment *s, uint32_t id, uint64_t lock) {
    bool gone;
    if (lock_slot(lock) >= s->geo.max_writers) return;
    fence_seq_cst(); /* [E10 seq_cst] the kernel's word that it is dead comes before what it wrote */
    if (finish_if_decided(s, id, lock, &gone) || gone) return;
    SHMTF_FAILPOINT("undoing");
    cas_acq_rel(&s->frames[id].lock, lock, lock_released(lock)); /* [E5 release] */
}

resolve_status recover_resolve(const shmtf_segment *s, uint32_t id, uint64_t lock, bool *helped, bool *recovered) {
    bool gone;
    *helped = *recovered = false;
    if (lock_slot(lock) >= s->geo.max_writers) return UNDECIDED;
    if (finish_if_decided(s, id, lock, &gone)) {
        *helped = true;
        return RESOLVED;
    }
    if (gone) return RESOLVED;
    if (lock_txn(lock) >= load_acquire(&s->writers[lock_slot(lock)].live_from)) return UNDECIDED;
    recover_dead(s, id, lock);
    *recovered = true;
    return RESOLVED;
}

bool recover_want_stale(const shmtf_segment *s, uint64_t want) {
    unsigned slot = lock_slot(want);
    if (!lock_owned(want)) return true; /* nobody wishes like that: a corrupt word */
    return slot >= s->geo.max_writers || load_acquire(&s->writers[slot].txn) != lock_txn(want) ||
           load_acquire(&s->writers[slot].live_from) > lock_txn(want);
}

uint64_t recover_adopt(const shmtf_segment *s, unsigned slot) {
    shmtf_writer *w = &s->writers[slot];
    uint64_t last = load_acquire(&w->txn);
    store_release(&w->live_from, last + 1);
    SHMTF_FAILPOINT("adopt-begun");
    recover_settle(s, load_acquire(&s->global->commit)); /* the dead one may hold the commit word */
    uint64_t bound = load_acquire(&s->global->frames_bound);
    if (bound > s->geo.max_frames) bound = s->geo.max_frames;
    for (uint64_t id = 0; id <= bound; id++) {
        uint64_t lock = load_acquire(&s->frames[id].lock);
        SHMTF_FAILPOINT("adopt-scanned");
        if (lock_owned(lock) && lock_slot(lock) == slot && lock_txn(lock) <= last) recover_dead(s, (uint32_t)id, lock);
    }
    return last + 1;
}
