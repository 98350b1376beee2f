/* SPDX-License-Identifier: Apache-2.0 */
#include "core/txn.h"

#include "core/arena.h"
#include "core/recover.h"
#include "segment/failpoint.h"

enum { LOCK_TRIES = 64, TAGS_BEFORE_COMMIT = 64 };

txn_status txn_begin(txn *x) {
    const shmtf_segment *s = x->s;
    shmtf_writer *w = &s->writers[x->slot];
    if (load_acquire(&w->live_from) != x->live_from) return TXN_LOST;
    uint64_t number = load_relaxed(&w->txn) + 1;
    if (number > LOCK_TXN_MASK) return TXN_CORRUPT;
    store_relaxed(&w->txn, number);
    store_release(&w->state, STATE_ACTIVE); /* after the last one's topology [E6 release] */
    SHMTF_FAILPOINT("begun");
    x->own = lock_make(x->slot, number);
    x->n = 0;
    x->n_staged = 0;
    x->reshapes = false;
    x->snapshot = load_acquire(&s->global->commit); /* [E2 acquire] */
    x->topology = tree_topology_at(s, x->snapshot);
    /* The word was loaded after S and may be about a later commit; what is checked at S would count as checked there. */
    if (x->topology > commit_version(x->snapshot)) return TXN_RETRY;
    ring_status st = tree_clears_at(s, x->snapshot, &x->clears);
    return st == RING_OK ? TXN_OK : st == RING_CORRUPT ? TXN_CORRUPT : TXN_RETRY;
}

static inline txn_entry *add_entry(txn *x, uint32_t id, uint64_t lock) {
    SHMTF_FAILPOINT("locked");
    txn_entry *e = &x->entries[x->n];
    uint64_t head = load_acquire(&x->s->frames[id].head[lock_sel(lock)]);
    *e = (txn_entry){.w = {.id = id, .lock = lock, .head0 = head, .head = head}};
    x->parents[x->n] = 0;
    x->entry_of[id] = (uint32_t)++x->n;
    return e;
}

static txn_status held(txn *x, uint32_t id, uint64_t by, bool wished) {
    x->blocked_id = id;
    x->blocked_by = by;
    x->wished = wished;
    return TXN_HELD;
}

/* Give way to a writer that waits for this frame. */
static bool must_give_way(txn *x, shmtf_frame_words_t *f, uint64_t *want) {
    *want = load_relaxed(&f->want);
    if (!*want || lock_tag(*want) == x->own || x->priority) return false;
    if (!(wish_first(*want) ? x->defers && *want != x->deferred_to : x->yields)) return false;
    if (!recover_want_stale(x->s, *want)) return true;
    cas_acq_rel(&f->want, *want, 0);
    return false;
}

txn_status txn_lock_try(txn *x, uint32_t id, txn_entry **entry) {
    shmtf_frame_words_t *f = &x->s->frames[id];
    txn_entry *e = txn_entry_for(x, id);
    uint64_t lock = 0, want;
    for (int tries = 0; !e && tries < LOCK_TRIES; tries++) {
        lock = load_acquire(&f->lock); /* [E5 acquire] */
        if (lock_owned(lock)) {
            bool helped, recovered;
            if (recover_resolve(x->s, id, lock, &helped, &recovered) == UNDECIDED) return held(x, id, lock, false);
            x->helps += helped;
            x->recoveries += recovered;
        } else if (must_give_way(x, f, &want)) {
            return held(x, id, want, true);
        } else if (cas_acq_rel(&f->lock, lock, x->own | (lock & LOCK_SEL))) {
            e = add_entry(x, id, x->own | (lock & LOCK_SEL));
        }
    }
    if (entry) *entry = e;
    return e ? TXN_OK : held(x, id, lock, false);
}

txn_status txn_lock_all(txn *x, const uint32_t *id, size_t n) {
    for (size_t i = 0; i < n; i++) {
        shmtf_frame_words_t *f = &x->s->frames[id[i]];
        uint64_t lock = load_acquire(&f->lock); /* [E5 acquire] */
        bool plain = !lock_owned(lock) && !load_relaxed(&f->want) && !x->entry_of[id[i]];
        if (plain && cas_acq_rel(&f->lock, lock, x->own | (lock & LOCK_SEL))) {
            add_entry(x, id[i], x->own | (lock & LOCK_SEL));
            continue;
        }
        txn_status st = txn_lock_try(x, id[i], NULL);
        if (st != TXN_OK) return st;
    }
    return TXN_OK;
}

void txn_want(txn *x, uint32_t id) {
    shmtf_word *at = &x->s->frames[id].want;
    uint64_t want = load_acquire(at), mine = x->own | (x->priority ? WISH_PRIORITY : 0);
    if (want == mine) return;
    if (!want || (x->priority && !wish_first(want)) || recover_want_stale(x->s, want)) cas_acq_rel(at, want, mine);
}

void txn_unwant(txn *x, uint32_t id) {
    uint64_t want = load_relaxed(&x->s->frames[id].want);
    if (lock_tag(want) == x->own) cas_acq_rel(&x->s->frames[id].want, want, 0);
}

static void forget(txn *x) {
    for (size_t i = 0; i < x->n; i++) x->entry_of[x->entries[i].w.id] = 0;
    x->n = 0;
}

void txn_abort(txn *x) {
    for (size_t i = 0; i < x->n; i++) {
        const ring_writer *w = &x->entries[i].w;
        shmtf_frame_words_t *f = &x->s->frames[w->id];
        /* a write that was refused must not decide the size of a ring that is declared later */
        if (x->entries[i].claimed && load_relaxed(&f->lock) == w->lock) store_relaxed(&f->ring, 0);
        cas_acq_rel(&f->lock, w->lock, lock_released(w->lock)); /* [E5 release] */
        SHMTF_FAILPOINT("half-aborted");
    }
    forget(x);
}

/* Is the frame free, once what is committed has been finished? */
static bool free_after_help(txn *x, uint32_t id) {
    bool helped, recovered;
    if (names_frame_free(x->s, id)) return true;
    uint64_t lock = load_acquire(&x->s->frames[id].lock);
    if (!lock_owned(lock) || recover_resolve(x->s, id, lock, &helped, &recovered) == UNDECIDED) return false;
    x->helps += helped;
    x->recoveries += recovered;
    return names_frame_free(x->s, id);
}

/* Lock the first free frame from the hint on.  Locked ones are passed over; the last of them is remembered. */
static txn_status lock_free_frame(txn *x, txn_entry **entry) {
    const shmtf_segment *s = x->s;
    uint64_t all = s->geo.max_frames, hint = load_relaxed(&s->global->frame_hint);
    bool any_held = false;
    for (uint64_t i = 0; i < all; i++) {
        uint32_t id = (uint32_t)((hint + i) % all) + 1;
        if (x->entry_of[id] || !free_after_help(x, id)) continue;
        raise_to(&s->global->frames_bound, id); /* before the lock, so that who adopts a dead binder's slot looks here */
        txn_status st = txn_lock_try(x, id, entry);
        if (st == TXN_HELD) any_held = true;
        if (st != TXN_OK) continue;
        if (names_frame_free(s, id)) {
            store_relaxed(&s->global->frame_hint, id);
            return TXN_OK;
        }
        return TXN_RETRY; /* taken meanwhile.  Not let go of here: this transaction's lock word must not come a second time */
    }
    return any_held ? TXN_HELD : TXN_FULL_FRAMES;
}

txn_status txn_birth(txn *x, const name_key *key, shmtf_frame *frame, txn_entry **entry) {
    txn_status st = lock_free_frame(x, entry);
    if (st != TXN_OK) return st;
    uint32_t id = (*entry)->w.id;
    uint64_t ring = load_relaxed(&x->s->frames[id].ring);
    bool keep = ring_word_valid(x->s, ring) && ring_word_log2(ring) == x->s->geo.default_log2;
    if (!names_bind_locked(x->s, id, key, keep, frame)) return TXN_FULL_NAMES;
    (*entry)->born = (*entry)->reshapes = x->reshapes = true;
    return TXN_OK;
}

/* Take the rings of free frames away: they are kept only to save a claim. */
static bool reclaim_rings(txn *x) {
    const shmtf_segment *s = x->s;
    uint64_t bound = load_acquire(&s->global->frames_bound), n = 0;
    for (uint32_t id = 1; id <= bound && id <= s->geo.max_frames; id++) {
        shmtf_frame_words_t *f = &s->frames[id];
        if (x->entry_of[id] || !load_relaxed(&f->ring) || !free_after_help(x, id)) continue;
        uint64_t lock = load_acquire(&f->lock);
        if (lock_owned(lock)) continue;
        uint64_t mine = x->own | (lock & LOCK_SEL);
        if (!cas_acq_rel(&f->lock, lock, mine)) continue;
        SHMTF_FAILPOINT("reclaim-locked");
        if (names_frame_free(s, id)) {
            store_relaxed(&f->ring, 0);
            n++;
        }
        cas_acq_rel(&f->lock, mine, lock_released(mine)); /* [E5 release] */
    }
    return n > 0;
}

txn_status txn_need_ring(txn *x, txn_entry *e, unsigned log2) {
    shmtf_frame_words_t *f = &x->s->frames[e->w.id];
    uint64_t ring = load_relaxed(&f->ring);
    if (ring) return ring_word_valid(x->s, ring) ? TXN_OK : TXN_CORRUPT;
    ring = arena_claim_locked(x->s, e->w.id, e->w.lock, log2);
    if (!ring && reclaim_rings(x)) ring = arena_claim_locked(x->s, e->w.id, e->w.lock, log2);
    if (!ring) return TXN_FULL_ARENA;
    SHMTF_FAILPOINT("ring-claimed");
    store_release(&f->ring, ring);
    e->claimed = true;
    SHMTF_FAILPOINT("ring-named");
    return TXN_OK;
}

txn_status txn_put_mark(txn *x, txn_entry *e, record_kind kind, uint64_t flags, uint64_t parent, int64_t arrival,
                        uint16_t writer) {
    ring_record r = {.arrival = (uint64_t)arrival, .stamp = arrival, .parent = parent};
    r.info = info_make(0, kind, flags, writer);
    r.pose.qw = 1;
    if (ring_put_locked(x->s, &e->w, &r, true, false) != PUT_OK) return TXN_CORRUPT;
    e->reshapes = x->reshapes = true;
    x->n_staged++;
    return TXN_OK;
}

txn_status txn_check_cycles(txn *x, uint32_t *cyclic, bool *found) {
    tree_overlay overlay = {x->entry_of, x->parents, true};
    *found = false;
    for (size_t i = 0; i < x->n; i++) overlay.closed &= x->entries[i].born || !x->entries[i].reshapes;
    if (x->climbs > UINT32_MAX - 2 - x->n) { /* the marks' numbers are used up: start over */
        memset(x->mark, 0, (x->s->geo.max_frames + 1) * sizeof *x->mark);
        x->climbs = 0;
    }
    uint32_t first = x->climbs + 1;
    for (size_t i = 0; i < x->n && !*found; i++) {
        if (!x->entries[i].reshapes) continue;
        *cyclic = x->entries[i].w.id;
        cycle_status st = tree_find_cycle(x->s, x->snapshot, &x->clears, &overlay, *cyclic, x->mark, ++x->climbs, first);
        if (st == CYCLE_OLD) return TXN_RETRY;
        if (st == CYCLE_CORRUPT) return TXN_CORRUPT;
        *found = st == CYCLE_FOUND;
    }
    return TXN_OK;
}

/* Tags that are in place before the commit save everybody work after it, but each attempt writes them all. */
static bool tags_early(const txn *x) { return x->n_staged <= TAGS_BEFORE_COMMIT; }

/* The commit word from g to {slot, version + 1}, if nobody commits first. */
static txn_status commit_once(txn *x, uint64_t g, uint64_t shape, uint64_t version) {
    const shmtf_segment *s = x->s;
    shmtf_writer *w = &s->writers[x->slot];
    if (tree_topology_at(s, g) != x->topology) return TXN_RETRY;
    if (version > VERSION_MASK) return TXN_CORRUPT;
    if (commit_slot(g) != x->slot) recover_settle(s, g); /* its state must not depend on g any more once g is gone */
    if (tags_early(x))
        for (size_t i = 0; i < x->n; i++) ring_tag_staged(s, &x->entries[i].w, version);
    SHMTF_FAILPOINT("versioned");
    store_release(&w->state, STATE_PREPARED | shape | version); /* [E4 release] */
    SHMTF_FAILPOINT("prepared");
    return cas_seq_cst(&s->global->commit, g, commit_make(x->slot, version)) ? TXN_OK : TXN_HELD; /* [E2 release] [E9 seq_cst] */
}

txn_status txn_commit_nothing(txn *x, uint64_t *version) {
    uint64_t g = load_acquire(&x->s->global->commit); /* [E2 acquire] */
    /* The records stand still under the locks; that they count was found out at the snapshot, which may be older. */
    txn_status st = tree_topology_at(x->s, g) == x->topology ? TXN_OK : TXN_RETRY;
    *version = commit_version(g);
    txn_abort(x);
    return st;
}

txn_status txn_commit(txn *x, uint64_t *version) {
    const shmtf_segment *s = x->s;
    shmtf_writer *w = &s->writers[x->slot];
    uint64_t shape = x->reshapes ? STATE_TOPOLOGY : 0;
    __builtin_prefetch(&s->global->commit, 1); /* readers have it; it comes back while the heads are stored */
    for (size_t i = 0; i < x->n; i++) {
        ring_writer *e = &x->entries[i].w;
        if (load_relaxed(&s->frames[e->id].lock) != e->lock) return txn_abort(x), TXN_LOST;
        if (!e->copied) ring_copy_newest_locked(s, e);
        store_relaxed(&s->frames[e->id].head[lock_sel(e->lock) ^ 1], e->head);
    }
    SHMTF_FAILPOINT("staged-all");
    txn_status st;
    do {
        uint64_t g = load_acquire(&s->global->commit); /* [E2 acquire] */
        *version = commit_version(g) + 1;
        st = commit_once(x, g, shape, *version);
    } while (st == TXN_HELD);
    if (st != TXN_OK) return txn_abort(x), st;
    SHMTF_FAILPOINT("committed");
    if (shape) raise_to(&s->global->topology, *version); /* [E6 release] */
    SHMTF_FAILPOINT("topology-raised");
    store_release(&w->state, STATE_COMMITTED | shape | *version); /* [E4 release] */
    for (size_t i = 0; i < x->n; i++) {
        SHMTF_FAILPOINT("half-unlocked");
        if (tags_early(x)) ring_unlock(s, &x->entries[i].w);
        else ring_apply(s, x->entries[i].w.id, x->entries[i].w.lock, *version);
    }
    forget(x);
    return TXN_OK;
}
