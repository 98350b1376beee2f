/* SPDX-License-Identifier: Apache-2.0
 *
 * What the records of all frames together mean: a forest, as of one commit.
 */
#ifndef SHMTF_CORE_TREE_H
#define SHMTF_CORE_TREE_H

#include "core/names.h"

/* The series of clears is frame 0: one line read per lookup instead of a lock per frame per clear. */
enum { TREE_CLEARS_ID = 0, CLEAR_KEEPS_STATIC = 1 };

/* Records with a version at or below these are invisible. */
typedef struct {
    uint64_t dynamic_upto, static_upto;
} tree_clears;
ring_status tree_clears_at(const shmtf_segment *s, uint64_t snapshot, tree_clears *out);

static inline bool tree_record_counts(const tree_clears *c, const ring_record *r) {
    record_kind kind = info_kind(r->info);
    if (kind == KIND_DYNAMIC) return r->version > c->dynamic_upto;
    return kind == KIND_STATIC && r->version > c->static_upto;
}

/* Version of the last commit that changed the tree's shape, as of the commit word `commit`.  If it is the same at
 * two commits, then no frame was born, removed, cleared, reparented or changed its kind between them.
 * Loads in this order: commit (the caller), that slot's state, topology. */
uint64_t tree_topology_at(const shmtf_segment *s, uint64_t commit);

/* A step up from a frame at S. */
typedef enum {
    STEP_EDGE, /* the record counts and has a parent */
    STEP_ROOT, /* the frame exists, without an edge */
    STEP_GONE, /* the frame does not exist */
    STEP_OLD,  /* take a newer S */
    STEP_CORRUPT
} tree_step;

static inline tree_step tree_classify(const shmtf_segment *s, uint64_t snapshot, const tree_clears *c, shmtf_frame frame,
                                      ring_status st, const ring_record *r) {
    const shmtf_frame_words_t *f = &s->frames[frame.id];
    /* After the copy: an unchanged gen means that the record is this life's. [E7 acquire] */
    uint32_t gen = (uint32_t)load_acquire(&f->gen);
    if (load_relaxed(&f->floor) > commit_version(snapshot))
        return names_unborn_at(f, snapshot) ? STEP_GONE : STEP_OLD;
    if (gen != frame.gen || st == RING_NONE) return STEP_GONE;
    if (st == RING_OLD || st == RING_AGAIN) return STEP_OLD;
    if (st == RING_CORRUPT) return STEP_CORRUPT;
    if (tree_record_counts(c, r)) return STEP_EDGE;
    return info_kind(r->info) == KIND_REMOVED ? STEP_GONE : STEP_ROOT;
}

/* The newest edge of a frame. */
static inline tree_step tree_step_latest(const shmtf_segment *s, uint64_t snapshot, const tree_clears *c, shmtf_frame frame,
                                         ring_record *r) {
    if (!frame.id || frame.id > s->geo.max_frames) return STEP_GONE;
    ring_status st = ring_latest(s, frame.id, snapshot, r);
    fence_acquire();
    return tree_classify(s, snapshot, c, frame, st, r);
}

/* A frame whose parent an uncommitted transaction changes. */
typedef struct {
    const uint32_t *entry;      /* per frame id: 0, or 1 + index of the transaction's entry for it */
    const uint64_t *parent;     /* per entry: its newest parent once this commits, as in a record; 0: none */
    bool closed; /* no frame that existed before gets another parent: a cycle would lie within the transaction's frames */
} tree_overlay;

/* Would the tree have a cycle above the frame `start`, with the overlay in force over the newest records at `commit`?
 * mark: one word per frame id.  climb: a number never used in it before; first_climb: the first of this check, so that
 * what an earlier climb found good is not climbed again. */
typedef enum { CYCLE_NONE, CYCLE_FOUND, CYCLE_OLD, CYCLE_CORRUPT } cycle_status;
cycle_status tree_find_cycle(const shmtf_segment *s, uint64_t commit, const tree_clears *c, const tree_overlay *overlay,
                             uint32_t start, uint32_t *mark, uint32_t climb, uint32_t first_climb);

#endif
