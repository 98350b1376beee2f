/* SPDX-License-Identifier: Apache-2.0 */
#include "core/lookup.h"

#include "core/pose.h"

/* One of the two chains on its way up. */
typedef struct {
    shmtf_frame cur, last; /* last: the frame below cur on this chain */
    uint32_t depth;        /* estimated edges from cur to the end */
    uint32_t n;            /* edges climbed */
    bool ended;
    lookup_status end;     /* why it ended: LOOKUP_OK at a root */
    shmtf_pose pose;       /* T_cur_start */
} chain;

static void interpolate(int64_t t, const ring_around_result *a, ring_record *r) {
    *r = a->before;
    if (a->before.stamp == t || !a->has_after || a->after.parent != a->before.parent) return;
    r->pose = pose_interpolate(&a->before.pose, &a->after.pose, ring_ratio(t, a->before.stamp, a->after.stamp));
}

static lookup_status edge_failed(lookup *l, shmtf_frame frame, const ring_around_result *a) {
    l->failed = frame;
    l->failed_parent = parent_frame(a->newest.parent);
    l->edge_oldest = a->oldest_stamp;
    l->edge_newest = a->newest.stamp;
    if (a->alone) return LOOKUP_SINGLE;
    return l->time > a->newest.stamp ? LOOKUP_FORWARD : LOOKUP_BACKWARD;
}

lookup_status lookup_step_at(lookup *l, shmtf_frame frame, ring_record *r, tree_step *step) {
    ring_around_result a;
    *step = STEP_GONE;
    if (!frame.id || frame.id > l->s->geo.max_frames) return LOOKUP_OK;
    ring_status st = ring_around(l->s, frame.id, l->snapshot, l->time, &a);
    fence_acquire();
    *step = tree_classify(l->s, l->snapshot, &l->clears, frame, st, &a.newest);
    if (*step != STEP_EDGE) return LOOKUP_OK;
    *r = a.newest;
    if (info_kind(a.newest.info) == KIND_STATIC) return LOOKUP_OK;
    if (!a.has_before || l->time > a.newest.stamp) return edge_failed(l, frame, &a);
    interpolate(l->time, &a, r);
    return LOOKUP_OK;
}

static inline lookup_status step_up(lookup *l, shmtf_frame frame, ring_record *r, tree_step *step) {
    if (l->at_time) return lookup_step_at(l, frame, r, step);
    *step = tree_step_latest(l->s, l->snapshot, &l->clears, frame, r);
    return LOOKUP_OK;
}

static inline void use_edge(lookup *l, chain *c, bool from_source, const ring_record *r) {
    bool is_static = info_kind(r->info) == KIND_STATIC;
    shmtf_frame parent = parent_frame(r->parent);
    if (!is_static) {
        if (r->stamp < l->oldest) l->oldest = r->stamp;
        if (r->stamp > l->newest) l->newest = r->stamp;
        l->n_dynamic++;
    }
    if (l->edges && c->n < l->max_edges) /* source's from the front, target's from the back */
        l->edges[from_source ? c->n : l->max_edges - 1 - c->n] = (shmtf_edge){parent, c->cur, r->stamp, is_static};
    c->pose = c->n ? pose_compose(&r->pose, &c->pose) : r->pose;
    c->last = c->cur;
    c->cur = parent;
    c->n++;
    if (c->depth) c->depth--;
}

/* Up to `steps` edges in a row; false: the next edge needs the general way. */
static bool run_up(lookup *l, chain *c, const chain *other, bool from_source, uint32_t steps) {
    edge_run run; /* not zeroed: most of it is written as the run goes */
    uint32_t most = steps < RUN_MOST ? steps : RUN_MOST;
    uint32_t used = c->n + other->n, room = l->edges && used < l->max_edges ? l->max_edges - used : 0;
    run.s = l->s;
    run.snapshot = l->snapshot;
    run.clears = &l->clears;
    run.above = l->above;
    run.at_time = l->at_time;
    run.poseless = l->poseless;
    run.time = l->time;
    run.chain = (edge_chain){.cur = c->cur, .last = c->last, .pose = c->pose, .has_pose = c->n != 0,
                             .oldest = l->oldest, .newest = l->newest, .n_dynamic = l->n_dynamic,
                             .edge = room ? l->edges + (from_source ? c->n : l->max_edges - 1 - c->n) : NULL,
                             .room = room, .stride = from_source ? 1 : -1};
    uint32_t n = run_edges(&run, most);
    if (!n) return false;
    c->pose = run.chain.pose;
    c->last = run.chain.last;
    c->cur = run.chain.cur;
    c->n += n;
    c->depth = c->depth > n ? c->depth - n : 0;
    l->oldest = run.chain.oldest;
    l->newest = run.chain.newest;
    l->n_dynamic = run.chain.n_dynamic;
    return true;
}

/* How far the deeper chain is above the other, or how far both are below where they should meet. */
static uint32_t steps_up(const lookup *l, const chain *c, const chain *other, bool measured) {
    if (c->depth > other->depth) return c->depth - other->depth;
    return !measured && c->depth == other->depth && !other->ended ? run_meeting(l->s, l->above, c->cur.id, other->cur.id) : 1;
}

static inline bool same(shmtf_frame a, shmtf_frame b) { return a.id == b.id && a.gen == b.gen; }

/* Does a frame exist at S?  STEP_EDGE or STEP_ROOT: yes. */
static tree_step existence(const lookup *l, shmtf_frame frame) {
    const shmtf_segment *s = l->s;
    ring_record r;
    ring_place p;
    if (frame.id - 1ull < s->geo.max_frames && ring_newest_place(s, frame.id, l->snapshot, &p)) {
        record_kind kind = edge_kind(place_edge(&p));
        bool life = (uint32_t)load_relaxed(&p.f->gen) == frame.gen && load_relaxed(&p.f->floor) <= commit_version(l->snapshot);
        fence_acquire(); /* [E3 acquire] [E7 acquire] */
        if (life && load_relaxed(&p.f->lock) == p.lock) return kind == KIND_REMOVED ? STEP_GONE : STEP_ROOT;
    }
    return tree_step_latest(s, l->snapshot, &l->clears, frame, &r);
}

/* Climb both chains, the deeper first, until they meet or both end. */
static lookup_status climb(lookup *l, chain *a, chain *b, bool measured) {
    uint64_t limit = 2 * l->s->geo.max_frames + 2;
    l->n_dynamic = 0;
    l->oldest = INT64_MAX;
    l->newest = INT64_MIN;
    while (!same(a->cur, b->cur)) {
        bool up_a = b->ended || (!a->ended && a->depth >= b->depth);
        chain *c = up_a ? a : b;
        if (c->ended) return LOOKUP_DISCONNECTED;
        if (a->n + b->n > limit) return LOOKUP_LOOP;
        const chain *other = up_a ? b : a;
        if (run_up(l, c, other, up_a, steps_up(l, c, other, measured))) continue;
        ring_record r;
        tree_step step;
        lookup_status st = step_up(l, c->cur, &r, &step);
        if (step == STEP_EDGE && st == LOOKUP_OK) {
            use_edge(l, c, up_a, &r);
            continue;
        }
        if (step == STEP_OLD) return LOOKUP_OLD;
        if (step == STEP_CORRUPT) return LOOKUP_CORRUPT;
        if (step == STEP_GONE) return c->n ? LOOKUP_DISCONNECTED : up_a ? LOOKUP_NO_SOURCE : LOOKUP_NO_TARGET;
        c->ended = true;
    }
    /* The meeting point was reached from below, or is one of the two ends asked for: it must exist. */
    tree_step step = existence(l, a->cur);
    if (step == STEP_OLD) return LOOKUP_OLD;
    if (step == STEP_CORRUPT) return LOOKUP_CORRUPT;
    if (step == STEP_GONE) return !a->n ? LOOKUP_NO_SOURCE : !b->n ? LOOKUP_NO_TARGET : LOOKUP_DISCONNECTED;
    bool overshot = a->n && b->n && same(a->last, b->last);
    return overshot ? LOOKUP_DISCONNECTED : LOOKUP_OK;
}

/* The end of a chain, its length, and why it ends there.  c->cur becomes the end. */
static lookup_status measure(lookup *l, chain *c, uint32_t *length) {
    for (*length = 0; *length <= l->s->geo.max_frames; (*length)++) {
        ring_record r;
        tree_step step;
        lookup_status st = step_up(l, c->cur, &r, &step);
        if (step == STEP_EDGE && st == LOOKUP_OK) {
            c->last = c->cur;
            c->cur = parent_frame(r.parent);
            continue;
        }
        if (step == STEP_OLD) return LOOKUP_OLD;
        if (step == STEP_CORRUPT) return LOOKUP_CORRUPT;
        c->end = step == STEP_EDGE ? st : LOOKUP_OK;
        if (step == STEP_GONE) {
            if (!*length) return LOOKUP_NO_SOURCE;
            c->cur = c->last; /* the parent was removed: its child is a root */
            (*length)--;
        }
        return LOOKUP_OK;
    }
    return LOOKUP_LOOP;
}

/* Leave depth hints along a measured chain, up to where they are right already.  At a time the chain may be another
 * than the newest; a hint may be wrong. */
static void hint_depths(lookup *l, shmtf_frame frame, uint32_t length) {
    for (uint32_t left = length + 1; left && frame.id && frame.id <= l->s->geo.max_frames; left--) {
        if (hint_get(&l->depth[frame.id]) == left) return;
        hint_set(&l->depth[frame.id], left);
        ring_record r;
        if (tree_step_latest(l->s, l->snapshot, &l->clears, frame, &r) != STEP_EDGE) return;
        frame = parent_frame(r.parent);
    }
}

/* The hint for a frame's depth; where there is none, from the first frame above that has one, or from the root.  0: the
 * frame cannot be climbed from. */
static uint32_t depth_of(lookup *l, shmtf_frame frame) {
    const uint64_t max_frames = l->s->geo.max_frames;
    uint32_t known = 0, length = 0;
    for (shmtf_frame f = frame; length <= max_frames; length++) {
        ring_record r;
        if (f.id && f.id <= max_frames && (known = hint_get(&l->depth[f.id]))) break;
        tree_step step = tree_step_latest(l->s, l->snapshot, &l->clears, f, &r);
        if (step == STEP_ROOT) known = 1;
        if (step != STEP_EDGE) break;
        f = parent_frame(r.parent);
    }
    if (!known || length + (uint64_t)known > UINT32_MAX) return 0;
    if (length) hint_depths(l, frame, length + known - 1);
    return length + known;
}

static chain chain_from(shmtf_frame frame, uint32_t depth) {
    chain c = {.cur = frame, .depth = depth, .end = LOOKUP_OK};
    c.pose = pose_identity();
    return c;
}

static lookup_status finish(lookup *l, const chain *source, const chain *target) {
    l->n_edges = source->n + target->n;
    if (l->edges && target->n && l->n_edges <= l->max_edges)
        memmove(l->edges + source->n, l->edges + l->max_edges - target->n, target->n * sizeof *l->edges);
    if (!target->n) {
        l->pose = source->pose;
    } else {
        shmtf_pose T_target_top = pose_inverse(&target->pose);
        l->pose = source->n ? pose_compose(&T_target_top, &source->pose) : T_target_top;
    }
    if (l->n_edges > 1) pose_renormalise(&l->pose); /* one edge comes back as it was stored */
    return LOOKUP_OK;
}

/* The exact walk, after hints failed: measure, then climb with true depths. */
static lookup_status run_measured(lookup *l) {
    chain a = chain_from(l->source, 0), b = chain_from(l->target, 0);
    uint32_t na, nb;
    lookup_status st = measure(l, &a, &na);
    shmtf_frame failed = l->failed, failed_parent = l->failed_parent;
    int64_t oldest = l->edge_oldest, newest = l->edge_newest;
    if (st == LOOKUP_OK) {
        st = measure(l, &b, &nb);
        if (st == LOOKUP_NO_SOURCE) st = LOOKUP_NO_TARGET;
    }
    if (st != LOOKUP_OK) return st;
    if (!same(a.cur, b.cur)) {
        if (a.end != LOOKUP_OK) { /* both may have failed: the source's edge is named */
            l->failed = failed;
            l->failed_parent = failed_parent;
            l->edge_oldest = oldest;
            l->edge_newest = newest;
            return a.end;
        }
        return b.end != LOOKUP_OK ? b.end : LOOKUP_DISCONNECTED;
    }
    hint_depths(l, l->source, na);
    hint_depths(l, l->target, nb);
    a = chain_from(l->source, na);
    b = chain_from(l->target, nb);
    st = climb(l, &a, &b, true);
    return st == LOOKUP_OK ? finish(l, &a, &b) : st;
}

/* At a time, an edge may fail although no path exists at all, or above the common ancestor of today. */
static lookup_status explain_failure(lookup *l, lookup_status st) {
    lookup latest = *l;
    latest.at_time = false;
    latest.edges = NULL;
    lookup_status newest = run_measured(&latest);
    if (newest == LOOKUP_OK) return st;
    return newest == LOOKUP_LOOP ? LOOKUP_CORRUPT : newest;
}

lookup_status lookup_run(lookup *l) {
    ring_status cleared = tree_clears_at(l->s, l->snapshot, &l->clears);
    if (cleared != RING_OK) return cleared == RING_CORRUPT ? LOOKUP_CORRUPT : LOOKUP_OLD;
    if (l->source.id > l->s->geo.max_frames) return LOOKUP_NO_SOURCE;
    if (l->target.id > l->s->geo.max_frames) return LOOKUP_NO_TARGET;
    /* Frames above are reached through records of S, so their life began before S; the ends came from outside. */
    if (load_relaxed(&l->s->frames[l->source.id].floor) > commit_version(l->snapshot))
        return names_unborn_at(&l->s->frames[l->source.id], l->snapshot) ? LOOKUP_NO_SOURCE : LOOKUP_OLD;
    uint32_t da = depth_of(l, l->source), db = depth_of(l, l->target);
    if (da && db) {
        chain a = chain_from(l->source, da), b = chain_from(l->target, db);
        lookup_status st = climb(l, &a, &b, false);
        if (st == LOOKUP_OK) return finish(l, &a, &b);
        if (st == LOOKUP_OLD || st == LOOKUP_CORRUPT) return st;
    }
    lookup_status st = run_measured(l);
    if (l->at_time && (st == LOOKUP_BACKWARD || st == LOOKUP_FORWARD || st == LOOKUP_SINGLE)) return explain_failure(l, st);
    return st;
}
