/* SPDX-License-Identifier: Apache-2.0
 *
 * A store on the heap: the core without mappings, kernel locks or waiting.
 */
#ifndef SHMTF_TESTS_WORLD_H
#define SHMTF_TESTS_WORLD_H

#include <stdlib.h>

#include "core/lookup.h"
#include "core/recover.h"
#include "core/stage.h"

typedef struct {
    shmtf_segment s;
    void *memory;
    local_hint *depth, *above;
} world;

typedef struct {
    txn x;
    uint32_t order[4096];
    int64_t arrival_ns;
    stage g; /* of the last batch */
    uint64_t version; /* of the last commit */
    uint64_t as_of;   /* of the last batch that found everything there */
} writer;

static inline void world_make(world *w, uint64_t frames, uint64_t history, int64_t cache_ns, uint64_t bytes, uint64_t writers) {
    shmtf_geometry geo;
    const uint64_t uuid[2] = {1, 2};
    memset(w, 0, sizeof *w);
    if (shmtf_layout_compute(&geo, frames, history, cache_ns, bytes, writers)) abort();
    w->memory = aligned_alloc(4096, geo.size_bytes);
    w->depth = calloc(frames + 1, sizeof *w->depth);
    w->above = calloc(frames + 1, sizeof *w->above);
    if (!w->memory || !w->depth || !w->above) abort();
    memset(w->memory, 0, geo.size_bytes);
    shmtf_layout_bind(&w->s, &geo, w->memory);
    shmtf_layout_format(&w->s, uuid, 0, 1);
    shmtf_layout_publish(&w->s);
}

static inline void world_free(world *w) {
    free(w->memory);
    free(w->depth);
    free(w->above);
}

/* Take over a slot; its last owner is dead. */
static inline void writer_make(writer *wr, const world *w, unsigned slot) {
    size_t n = w->s.geo.max_frames + 1;
    memset(wr, 0, sizeof *wr);
    wr->x.s = &w->s;
    wr->x.slot = slot;
    wr->x.entries = calloc(n, sizeof *wr->x.entries);
    wr->x.parents = calloc(n, sizeof *wr->x.parents);
    wr->x.entry_of = calloc(n, sizeof *wr->x.entry_of);
    wr->x.mark = calloc(n, sizeof *wr->x.mark);
    wr->x.checked = calloc(n, sizeof *wr->x.checked);
    if (!wr->x.entries || !wr->x.parents || !wr->x.entry_of || !wr->x.mark || !wr->x.checked) abort();
    wr->x.live_from = recover_adopt(&w->s, slot);
}

static inline void writer_free(writer *wr) {
    free(wr->x.entries);
    free(wr->x.parents);
    free(wr->x.entry_of);
    free(wr->x.mark);
    free(wr->x.checked);
}

/* T_parent_child with its value in x. */
static inline shmtf_transform edge_at(const char *parent, const char *child, int64_t stamp, double x) {
    shmtf_transform t = {shmtf_by_name(parent), shmtf_by_name(child), stamp, {x, 0, 0, 0, 0, 0, 1}, 0};
    return t;
}
static inline shmtf_transform static_edge(const char *parent, const char *child, double x) {
    shmtf_transform t = edge_at(parent, child, 0, x);
    t.flags = SHMTF_STATIC;
    return t;
}

static inline stage_status stage_begin(writer *wr, shmtf_transform *items, size_t n) {
    wr->g = (stage){.x = &wr->x, .items = items, .n = n, .order = wr->order, .arrival_ns = ++wr->arrival_ns, .writer = 7};
    stage_status st = items ? stage_check(&wr->g) : STAGE_OK;
    if (st != STAGE_OK) return st;
    switch (txn_begin(&wr->x)) {
    case TXN_OK: return STAGE_OK;
    case TXN_RETRY: return STAGE_RETRY;
    default: return STAGE_CORRUPT;
    }
}

/* Commit what was staged, or release it. */
static inline stage_status stage_end(writer *wr, stage_status st) {
    if (st != STAGE_OK) {
        txn_abort(&wr->x);
        stage_forget_unborn(&wr->g);
        return st;
    }
    if (!wr->x.n_staged && !wr->x.reshapes) return txn_commit_nothing(&wr->x, &wr->as_of) == TXN_OK ? STAGE_OK : STAGE_RETRY;
    txn_status done = txn_commit(&wr->x, &wr->version);
    if (done == TXN_OK) return STAGE_OK;
    stage_forget_unborn(&wr->g);
    return done == TXN_RETRY ? STAGE_RETRY : STAGE_CORRUPT;
}

static inline stage_status write_once(writer *wr, shmtf_transform *items, size_t n) {
    stage_status st = stage_begin(wr, items, n);
    if (st == STAGE_OK) st = stage_end(wr, stage_transforms(&wr->g));
    return st;
}

/* Until it is through or refused for a reason that does not pass by itself. */
static inline stage_status write_all(writer *wr, shmtf_transform *items, size_t n) {
    stage_status st = STAGE_RETRY;
    for (int tries = 0; st == STAGE_RETRY && tries < 16; tries++) st = write_once(wr, items, n);
    return st;
}
static inline stage_status write_one(writer *wr, shmtf_transform t) { return write_all(wr, &t, 1); }

static inline stage_status remove_named(writer *wr, const char *name) {
    shmtf_ref ref = shmtf_by_name(name);
    stage_status st = stage_begin(wr, NULL, 0);
    return st == STAGE_OK ? stage_end(wr, stage_remove(&wr->g, &ref)) : st;
}
static inline stage_status clear_all(writer *wr, bool keep_static) {
    stage_status st = stage_begin(wr, NULL, 0);
    return st == STAGE_OK ? stage_end(wr, stage_clear(&wr->g, keep_static)) : st;
}
static inline stage_status declare_named(writer *wr, const char *name, unsigned log2) {
    stage_status st = stage_begin(wr, NULL, 0);
    return st == STAGE_OK ? stage_end(wr, stage_declare(&wr->g, name, log2)) : st;
}

static inline uint64_t now_of(const world *w) { return atomic_load(&w->s.global->commit); }

static inline ring_status find_frame(const world *w, uint64_t snapshot, const char *name, shmtf_frame *out) {
    name_key key;
    *out = (shmtf_frame){0, 0};
    return names_key(&key, name) ? RING_CORRUPT : names_find(&w->s, snapshot, &key, out);
}

static inline uint32_t id_of(const world *w, const char *name) {
    shmtf_frame f;
    return find_frame(w, now_of(w), name, &f) == RING_OK ? f.id : 0;
}

/* T_target_source; time NULL: newest of every edge. */
static inline lookup_status look_up(const world *w, uint64_t snapshot, const char *target, const char *source, const int64_t *time,
                                    lookup *l) {
    *l = (lookup){.s = &w->s, .depth = w->depth, .above = w->above, .snapshot = snapshot, .at_time = time != NULL, .time = time ? *time : 0};
    ring_status a = find_frame(w, snapshot, target, &l->target), b = find_frame(w, snapshot, source, &l->source);
    if (a == RING_NONE) return LOOKUP_NO_TARGET;
    if (b == RING_NONE) return LOOKUP_NO_SOURCE;
    if (a != RING_OK || b != RING_OK) return LOOKUP_OLD;
    return lookup_run(l);
}

#endif
