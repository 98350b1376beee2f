/* SPDX-License-Identifier: Apache-2.0
 *
 * Frames, records, writers: what a store holds.
 */
#include <errno.h>
#include <stdlib.h>

#include "api/store.h"
#include "core/recover.h"

enum { SNAPSHOT_TRIES = 1000, FIRST_ROOM = 512 };

/* A read at one commit, repeated at newer ones until it holds:
 *     for (attempts at = {0}; take_commit(h, snapshot, rs, &at);) rs = read at at.commit; */
typedef struct {
    uint64_t commit;
    int n;
} attempts;

static bool take_commit(shmtf_store *h, const shmtf_snapshot *snapshot, ring_status last, attempts *at) {
    bool holds = last != RING_OLD && last != RING_AGAIN, hopeless = snapshot && last == RING_OLD;
    if (at->n && (holds || hopeless || at->n == SNAPSHOT_TRIES)) return false;
    at->n++;
    at->commit = snapshot ? snapshot->word : load_acquire(&h->s.global->commit); /* [E2 acquire] */
    return true;
}

static shmtf_status expired(shmtf_error *e) {
    return error_set(e, SHMTF_SNAPSHOT_EXPIRED, "the records of that commit were overwritten", "take a new snapshot");
}

static shmtf_status from_ring(ring_status st, shmtf_store *h, const shmtf_ref *ref, shmtf_error *e) {
    if (hint_get(&h->entry) == GUARD_LOST) return store_lost(e);
    if (st == RING_OK) return SHMTF_OK;
    if (st == RING_OLD || st == RING_AGAIN) return expired(e);
    if (st == RING_CORRUPT) return error_set(e, SHMTF_CORRUPT, "a frame's ring", "shmtf check NAME says more");
    error_frame(e, h, NULL, ref);
    return error_set(e, SHMTF_LOOKUP, "the frame does not exist", NULL);
}

static ring_status resolve_at(shmtf_store *h, uint64_t commit, const shmtf_ref *ref, const name_key *key, shmtf_frame *frame) {
    if (!ref->frame.gen) return names_find(&h->s, commit, key, frame);
    *frame = ref->frame;
    return names_alive(&h->s, commit, *frame);
}

static shmtf_status begin(shmtf_store *h, const shmtf_ref *ref, name_key *key, shmtf_error *e) {
    error_clear(e);
    shmtf_status st = store_enter(h, e);
    const char *why = st == SHMTF_OK && !ref->frame.gen ? names_key(key, ref->name) : NULL;
    return why ? error_set(e, SHMTF_INVALID_ARGUMENT, why, "1 to 127 bytes without a leading '/'") : st;
}

shmtf_status shmtf_resolve(shmtf_store *h, const shmtf_snapshot *snapshot, const char *name, shmtf_frame *frame, shmtf_error *error) {
    name_key key;
    ring_status rs = RING_OLD;
    const shmtf_ref ref = {name, {0, 0}};
    shmtf_status st = begin(h, &ref, &key, error);
    if (st != SHMTF_OK) return st;
    for (attempts at = {0}; take_commit(h, snapshot, rs, &at);) rs = names_find(&h->s, at.commit, &key, frame);
    return from_ring(rs, h, &ref, error);
}

shmtf_status shmtf_frame_name(shmtf_store *h, shmtf_frame frame, char name[SHMTF_NAME_SIZE], shmtf_error *error) {
    error_clear(error);
    shmtf_status st = store_enter(h, error);
    if (st != SHMTF_OK) return st;
    if (!names_copy(&h->s, frame, name)) st = error_set(error, SHMTF_LOOKUP, "the handle is stale: its frame was removed", NULL);
    return store_leave(h, st, error);
}

static ring_status list_frames(shmtf_store *h, uint64_t commit, shmtf_frame *out, size_t max, size_t *n) {
    uint64_t bound = load_acquire(&h->s.global->frames_bound);
    *n = 0;
    for (uint32_t id = 1; id <= bound && id <= h->s.geo.max_frames; id++) {
        const shmtf_frame frame = {id, names_gen(&h->s, id) & ~1u};
        ring_status st = names_alive(&h->s, commit, frame);
        if (st == RING_CORRUPT || st == RING_OLD || st == RING_AGAIN) return st;
        if (st != RING_OK) continue;
        if (*n < max) out[*n] = frame;
        (*n)++;
    }
    return RING_OK;
}

shmtf_status shmtf_frames(shmtf_store *h, const shmtf_snapshot *snapshot, shmtf_frame *frames, size_t max, size_t *n, shmtf_error *error) {
    ring_status rs = RING_OLD;
    error_clear(error);
    shmtf_status st = store_enter(h, error);
    if (st != SHMTF_OK) return st;
    for (attempts at = {0}; take_commit(h, snapshot, rs, &at);) rs = list_frames(h, at.commit, frames, max, n);
    return from_ring(rs, h, &(shmtf_ref){NULL, {0, 0}}, error);
}

/* The records that count at a commit, newest first; the frame must exist then. */
static ring_status list_records(shmtf_store *h, uint64_t commit, const shmtf_ref *ref, const name_key *key, shmtf_frame *frame,
                                ring_record *out, size_t max, size_t *n) {
    tree_clears clears;
    ring_status st = resolve_at(h, commit, ref, key, frame);
    if (st == RING_OK) st = tree_clears_at(&h->s, commit, &clears);
    if (st == RING_OK) st = ring_list(&h->s, frame->id, commit, out, max, n);
    if (st != RING_OK) return st;
    fence_acquire();
    if (names_gen(&h->s, frame->id) != frame->gen) return RING_OLD;
    while (*n && !tree_record_counts(&clears, &out[*n - 1])) (*n)--;
    return RING_OK;
}

/* All of them, in memory to be freed. */
static shmtf_status all_records(shmtf_store *h, const shmtf_snapshot *snapshot, const shmtf_ref *ref, shmtf_frame *frame,
                                ring_record **out, size_t *n, size_t max, shmtf_error *e) {
    name_key key;
    ring_status rs = RING_OLD;
    shmtf_status st = begin(h, ref, &key, e);
    if (st != SHMTF_OK) return st;
    for (size_t room = FIRST_ROOM;; room *= 4) {
        if (room > max) room = max;
        ring_record *r = realloc(*out, room * sizeof **out);
        if (!r) return error_system(e, SHMTF_SYSTEM, ENOMEM, "process memory", NULL);
        *out = r;
        for (attempts at = {0}; take_commit(h, snapshot, rs, &at);) rs = list_records(h, at.commit, ref, &key, frame, r, room, n);
        if (rs != RING_OK || *n < room || room == max) return from_ring(rs, h, ref, e);
    }
}

static shmtf_record to_record(const ring_record *r) {
    return (shmtf_record){r->stamp, (int64_t)r->arrival, r->version, parent_frame(r->parent), r->pose, info_writer(r->info),
                          info_epoch(r->info), info_kind(r->info) == KIND_STATIC};
}

shmtf_status shmtf_records(shmtf_store *h, const shmtf_snapshot *snapshot, shmtf_ref frame, shmtf_record *records, size_t max,
                           size_t *n, shmtf_error *error) {
    ring_record *all = NULL;
    shmtf_frame found;
    *n = 0;
    if (!max) return error_clear(error), SHMTF_OK;
    shmtf_status st = all_records(h, snapshot, &frame, &found, &all, n, max, error);
    if (st != SHMTF_OK) *n = 0;
    for (size_t i = 0; i < *n; i++) records[i] = to_record(&all[i]);
    free(all);
    return st;
}

static void fill_info(shmtf_store *h, const ring_record *r, size_t n, shmtf_frame_info *info) {
    const shmtf_frame_words_t *f = &h->s.frames[info->frame.id];
    uint64_t ring = load_relaxed(&f->ring), lock = load_acquire(&f->lock);
    info->n_written = head_count(load_acquire(&f->head[lock_sel(lock)]));
    info->generation = load_acquire(&f->gen) / 2;
    info->capacity = (uint32_t)shmtf_ring_live(ring_word_valid(&h->s, ring) ? ring_word_log2(ring) : SHMTF_INLINE_LOG2);
    info->n_records = (uint32_t)n;
    info->is_root = n == 0;
    names_copy(&h->s, info->frame, info->name);
    if (!n) return;
    info->is_static = info_kind(r[0].info) == KIND_STATIC;
    info->parent = parent_frame(r[0].parent);
    if (!names_copy(&h->s, info->parent, info->parent_name)) info->parent = (shmtf_frame){0, 0}, info->is_root = 1;
    info->newest_ns = r[0].stamp;
    info->oldest_ns = r[n - 1].stamp;
    info->arrival_ns = (int64_t)r[0].arrival;
    info->version = r[0].version;
    info->writer = info_writer(r[0].info);
}

shmtf_status shmtf_get_frame_info(shmtf_store *h, const shmtf_snapshot *snapshot, shmtf_ref frame, shmtf_frame_info *info,
                                  shmtf_error *error) {
    ring_record *all = NULL;
    size_t n = 0;
    memset(info, 0, sizeof *info);
    shmtf_status st = all_records(h, snapshot, &frame, &info->frame, &all, &n, (size_t)1 << SHMTF_MAX_RING_LOG2, error);
    if (st == SHMTF_OK) fill_info(h, all, n, info);
    free(all);
    return store_leave(h, st, error);
}

static ring_status parent_at(shmtf_store *h, uint64_t commit, const shmtf_ref *ref, const name_key *key, const int64_t *time,
                             lookup *l, lookup_status *why, shmtf_frame *parent) {
    ring_record r;
    tree_step step = STEP_GONE;
    shmtf_frame frame;
    *parent = (shmtf_frame){0, 0};
    *why = LOOKUP_OK;
    ring_status st = resolve_at(h, commit, ref, key, &frame);
    *l = (lookup){.s = &h->s, .snapshot = commit, .time = time ? *time : 0};
    if (st == RING_OK) st = tree_clears_at(&h->s, commit, &l->clears);
    if (st != RING_OK) return st;
    if (time) *why = lookup_step_at(l, frame, &r, &step);
    else step = tree_step_latest(&h->s, commit, &l->clears, frame, &r);
    if (step == STEP_OLD) return RING_OLD;
    if (step == STEP_CORRUPT) return RING_CORRUPT;
    if (step == STEP_GONE) return RING_NONE;
    if (*why != LOOKUP_OK || step != STEP_EDGE) return RING_OK;
    *parent = parent_frame(r.parent);
    st = names_alive(&h->s, commit, *parent);
    if (st == RING_NONE) *parent = (shmtf_frame){0, 0}; /* it was removed: this frame is a root */
    return st == RING_NONE ? RING_OK : st;
}

shmtf_status shmtf_parent(shmtf_store *h, const shmtf_snapshot *snapshot, shmtf_ref frame, const int64_t *time_ns,
                          shmtf_frame *parent, shmtf_error *error) {
    name_key key;
    ring_status rs = RING_OLD;
    lookup l;
    lookup_status why = LOOKUP_OK;
    shmtf_status st = begin(h, &frame, &key, error);
    if (st != SHMTF_OK) return st;
    for (attempts at = {0}; take_commit(h, snapshot, rs, &at);) rs = parent_at(h, at.commit, &frame, &key, time_ns, &l, &why, parent);
    if (rs != RING_OK || why == LOOKUP_OK) return from_ring(rs, h, &frame, error);
    const shmtf_ref above = {NULL, l.failed_parent};
    error_frame(error, h, &above, &frame);
    if (error_open(error)) {
        error->requested_ns = l.time;
        error->oldest_ns = l.edge_oldest;
        error->newest_ns = l.edge_newest;
        error->has_times = 7;
    }
    st = why == LOOKUP_SINGLE ? SHMTF_NO_DATA : why == LOOKUP_FORWARD ? SHMTF_FORWARD : SHMTF_BACKWARD;
    return store_leave(h, error_set(error, st, "edge", NULL), error);
}
