/* SPDX-License-Identifier: Apache-2.0 */
#include "core/tree.h"

ring_status tree_clears_at(const shmtf_segment *s, uint64_t snapshot, tree_clears *out) {
    ring_record r;
    *out = (tree_clears){0, 0};
    const shmtf_frame_words_t *f = &s->frames[TREE_CLEARS_ID];
    uint64_t lock = load_acquire(&f->lock);
    if (!lock_owned(lock) && !head_count(load_acquire(&f->head[lock_sel(lock)]))) return RING_OK; /* never cleared */
    ring_status st = ring_latest(s, TREE_CLEARS_ID, snapshot, &r);
    if (st == RING_NONE) return RING_OK;
    if (st != RING_OK) return st;
    out->dynamic_upto = r.version;
    out->static_upto = info_flags(r.info) & CLEAR_KEEPS_STATIC ? r.parent : r.version;
    return RING_OK;
}

uint64_t tree_topology_at(const shmtf_segment *s, uint64_t commit) {
    unsigned slot = commit_slot(commit);
    uint64_t version = commit_version(commit);
    if (slot < s->geo.max_writers) {
        uint64_t state = load_acquire(&s->writers[slot].state); /* [E4 acquire] */
        bool that = state_kind(state) != STATE_ACTIVE && state_version(state) == version;
        if (that && version && (state & STATE_TOPOLOGY)) return version;
    }
    return load_acquire(&s->global->topology); /* [E6 acquire] */
}

static uint64_t parent_above(const shmtf_segment *s, uint64_t commit, const tree_clears *c, const tree_overlay *overlay,
                             uint64_t parent, tree_step *step) {
    shmtf_frame frame = parent_frame(parent);
    *step = STEP_ROOT;
    if (frame.id > s->geo.max_frames) return 0;
    if (overlay->entry[frame.id]) {
        *step = STEP_EDGE;
        return overlay->parent[overlay->entry[frame.id] - 1];
    }
    if (overlay->closed) return 0;
    ring_record r;
    *step = tree_step_latest(s, commit, c, frame, &r);
    return *step == STEP_EDGE ? r.parent : 0;
}

cycle_status tree_find_cycle(const shmtf_segment *s, uint64_t commit, const tree_clears *c, const tree_overlay *overlay,
                             uint32_t start, uint32_t *mark, uint32_t climb, uint32_t first_climb) {
    uint64_t parent = overlay->parent[overlay->entry[start] - 1];
    mark[start] = climb;
    while (parent) {
        uint32_t id = parent_frame(parent).id;
        if (id > s->geo.max_frames) return CYCLE_CORRUPT;
        if (names_gen(s, id) != parent_frame(parent).gen) return CYCLE_NONE; /* the parent's life ended: a root */
        if (mark[id] == climb) return CYCLE_FOUND;
        if (mark[id] >= first_climb) return CYCLE_NONE; /* an earlier climb of this check found its way to a root */
        mark[id] = climb;
        tree_step step;
        parent = parent_above(s, commit, c, overlay, parent, &step);
        if (step == STEP_OLD) return CYCLE_OLD;
        if (step == STEP_CORRUPT) return CYCLE_CORRUPT;
    }
    return CYCLE_NONE;
}
