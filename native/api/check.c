/* SPDX-License-Identifier: Apache-2.0
 *
 * Looking at a store from outside: writers, raw words, and whether everything in it can be.
 */
#include <stdio.h>

#include "api/store.h"
#include "core/recover.h"

static bool claimed(shmtf_store *h, unsigned slot) { return peer_alive(h->query_fd, &h->file, slot); }

shmtf_status shmtf_writers(shmtf_store *h, shmtf_writer_info *writers, size_t max, size_t *n, shmtf_error *error) {
    error_clear(error);
    shmtf_status st = store_enter(h, error);
    *n = 0;
    for (unsigned slot = 0; st == SHMTF_OK && slot < h->s.geo.max_writers; slot++) {
        const shmtf_writer *w = &h->s.writers[slot];
        bool alive = claimed(h, slot);
        if (!alive && !load_relaxed(&w->pid)) continue;
        if (*n < max) {
            uint64_t state = load_acquire(&w->state);
            writers[*n] = (shmtf_writer_info){.slot = (int)slot, .alive = alive, .pid = (int64_t)load_relaxed(&w->pid),
                                              .start_ns = (int64_t)load_relaxed(&w->start_ns), .transaction = load_relaxed(&w->txn),
                                              .state = (int)(state >> 62), .version = state_version(state)};
            store_text(w->text, writers[*n].name);
        }
        (*n)++;
    }
    return store_leave(h, st, error);
}

shmtf_status shmtf_get_frame_words(shmtf_store *h, shmtf_ref ref, shmtf_frame_words *words, shmtf_error *error) {
    shmtf_frame frame = ref.frame;
    memset(words, 0, sizeof *words);
    words->owner_slot = -1;
    shmtf_status st = SHMTF_OK;
    if (!frame.gen) st = shmtf_resolve(h, NULL, ref.name, &frame, error);
    else error_clear(error), st = store_enter(h, error);
    if (st != SHMTF_OK) return st;
    if (frame.id > h->s.geo.max_frames) return error_set(error, SHMTF_LOOKUP, "the handle is no frame's", NULL);
    const shmtf_frame_words_t *f = &h->s.frames[frame.id];
    ring_ref r;
    words->lock = load_acquire(&f->lock);
    words->head = load_acquire(&f->head[lock_sel(words->lock)]);
    words->pending = load_acquire(&f->head[lock_sel(words->lock) ^ 1]);
    words->commit = load_acquire(&h->s.global->commit); /* [E2 acquire] */
    if (head_count(words->head) && ring_bind(&h->s, frame.id, words->head, &r))
        words->newest_tag = load_acquire(&r.heads[ring_slot(&r, words->head, head_count(words->head))].tag);
    words->locked = lock_owned(words->lock);
    if (!words->locked) return store_leave(h, SHMTF_OK, error);
    words->owner_slot = (int)lock_slot(words->lock);
    words->owner_transaction = lock_txn(words->lock);
    words->owner_alive = lock_txn(words->lock) >= load_acquire(&h->s.writers[lock_slot(words->lock) % h->s.geo.max_writers].live_from) &&
                         claimed(h, lock_slot(words->lock));
    return store_leave(h, SHMTF_OK, error);
}

static void problem(shmtf_check_report *r, const char *what, uint64_t id, uint64_t value) {
    if (!r->bad_words++)
        snprintf(r->first_problem, sizeof r->first_problem, "%s %llu: %#llx", what, (unsigned long long)id, (unsigned long long)value);
}

/* Every record that a head reaches: an impossible tag, order or parent is a bad word. */
static void check_ring(shmtf_store *h, uint32_t id, uint64_t head, uint64_t commit, shmtf_check_report *rep) {
    ring_ref r;
    if (!ring_bind(&h->s, id, head, &r)) return problem(rep, "ring of frame", id, load_relaxed(&h->s.frames[id].ring));
    uint64_t count = head_count(head), live = shmtf_ring_live(r.log2), first = count > live ? count - live + 1 : 1;
    for (uint64_t p = count; p >= first; p--) {
        const shmtf_record_head *head_of = &r.heads[ring_slot(&r, head, p)];
        uint64_t tag = load_acquire(&head_of->tag), info = load_relaxed(&head_of->info);
        if (!tag) return; /* the ring came into force above here */
        rep->records++;
        if (!lock_owned(tag) && tag > commit_version(commit)) problem(rep, "version of a record of frame", id, tag);
        record_kind kind = info_kind(info);
        if (kind == KIND_NONE || kind > KIND_CLEAR) problem(rep, "kind of a record of frame", id, info);
        uint64_t parent = load_relaxed(&r.bodies[ring_slot(&r, head, p)].parent);
        if ((kind == KIND_DYNAMIC || kind == KIND_STATIC) && (!parent_frame(parent).id || parent_frame(parent).id > h->s.geo.max_frames))
            problem(rep, "parent in a record of frame", id, parent);
    }
}

/* The copy beside the lock must say what the ring says. */
static void check_copy(shmtf_store *h, uint32_t id, unsigned sel, uint64_t head, shmtf_check_report *rep) {
    const shmtf_frame_words_t *f = &h->s.frames[id];
    uint64_t tag = load_acquire(&f->newest_tag[sel]);
    ring_ref r;
    if (!head_count(head)) {
        if (tag) problem(rep, "copy of no record of frame", id, tag);
        return;
    }
    if (!ring_bind(&h->s, id, head, &r)) return; /* said by check_ring */
    uint64_t slot = ring_slot(&r, head, head_count(head)), info = load_relaxed(&r.heads[slot].info);
    uint64_t edge = edge_make(load_relaxed(&r.bodies[slot].parent), info_kind(info), info_flags(info));
    uint64_t differs = (tag ^ load_acquire(&r.heads[slot].tag)) | (load_relaxed(&f->newest_stamp[sel]) ^ load_relaxed(&r.heads[slot].stamp)) |
                       (load_relaxed(&f->newest_edge[sel]) ^ edge) | search_base(load_relaxed(&f->newest_search[sel]) ^ info);
    for (int i = 0; i < SHMTF_POSE_WORDS; i++) differs |= load_relaxed(&f->newest[sel].pose[i]) ^ load_relaxed(&r.bodies[slot].pose[i]);
    if (differs) problem(rep, "copy of the newest record of frame", id, tag);
}

/* Look at a frame while nothing moves under the look; a frame that is always moving is in use, hence fine. */
static void check_frame(shmtf_store *h, uint32_t id, shmtf_check_report *rep) {
    const shmtf_frame_words_t *f = &h->s.frames[id];
    for (int tries = 0; tries < 64; tries++) {
        shmtf_check_report before = *rep;
        uint64_t lock = load_acquire(&f->lock), head = load_acquire(&f->head[lock_sel(lock)]);
        if (lock_owned(lock)) {
            if (lock_slot(lock) >= h->s.geo.max_writers) return problem(rep, "lock of frame", id, lock);
            bool dead = lock_txn(lock) < load_acquire(&h->s.writers[lock_slot(lock)].live_from) || !claimed(h, lock_slot(lock));
            if (load_acquire(&f->lock) != lock) continue;
            rep->locks_held++;
            rep->locks_dead += dead;
        }
        if (head_count(head)) check_ring(h, id, head, load_seq_cst(&h->s.global->commit), rep);
        check_copy(h, id, lock_sel(lock), head, rep);
        fence_acquire();
        if (load_relaxed(&f->lock) == lock) return;
        *rep = before;
    }
}

static void repair_frame(shmtf_store *h, uint32_t id, shmtf_check_report *rep) {
    uint64_t lock = load_acquire(&h->s.frames[id].lock);
    bool helped, recovered;
    if (!lock_owned(lock)) return;
    resolve_status st = recover_resolve(&h->s, id, lock, &helped, &recovered);
    if (st == UNDECIDED && !claimed(h, lock_slot(lock))) {
        recover_dead(&h->s, id, lock);
        recovered = true;
    }
    rep->locks_repaired += helped || recovered;
}

static shmtf_status check_lost(shmtf_check_report *report, shmtf_error *error) {
    *report = (shmtf_check_report){.bad_words = 1, .first_problem = "its file was cut short"};
    return store_lost(error);
}

shmtf_status shmtf_check(shmtf_store *h, int repair, shmtf_check_report *report, shmtf_error *error) {
    error_clear(error);
    memset(report, 0, sizeof *report);
    shmtf_status st = store_enter(h, error);
    if (st != SHMTF_OK) return st == SHMTF_CORRUPT ? check_lost(report, error) : st;
    if (repair && h->readonly) return error_set(error, SHMTF_READ_ONLY, "the store is attached read-only", NULL);
    uint64_t bound = load_acquire(&h->s.global->frames_bound);
    if (bound > h->s.geo.max_frames) {
        problem(report, "frames_bound", 0, bound);
        bound = h->s.geo.max_frames;
    }
    if (commit_slot(load_acquire(&h->s.global->commit)) >= h->s.geo.max_writers) problem(report, "commit word", 0, load_acquire(&h->s.global->commit));
    for (uint32_t id = 0; id <= bound; id++) check_frame(h, id, report);
    report->frames = bound;
    if (hint_get(&h->entry) == GUARD_LOST) return check_lost(report, error);
    if (report->bad_words) return error_set(error, SHMTF_CORRUPT, "a word in the segment is impossible", "copy what is needed, then create the store again");
    for (uint32_t id = 0; repair && id <= bound; id++) repair_frame(h, id, report);
    return hint_get(&h->entry) == GUARD_LOST ? check_lost(report, error) : SHMTF_OK;
}
