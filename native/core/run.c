/* SPDX-License-Identifier: Apache-2.0 */
#include "core/run.h"

#include "core/pose.h"

static inline bool is_frame(const shmtf_segment *s, uint32_t id) { return id - 1ull < s->geo.max_frames; }

/* Ask for the lines of the frames above.  Two of a frame's four: processors fetch lines in pairs. */
static inline void announce(const edge_run *run, uint32_t id, uint32_t most) {
    for (uint32_t i = 0; i < most && is_frame(run->s, id); i++) {
        const char *line = (const char *)&run->s->frames[id];
        __builtin_prefetch(line);
        __builtin_prefetch(line + 128);
        id = hint_get(&run->above[id]);
    }
}

/* Per kind of record: versions that are no edges.  Kinds that never are: all. */
typedef struct {
    uint64_t upto[16];
} edge_rule;

static inline edge_rule rule_of(const tree_clears *c) {
    edge_rule r;
    for (int i = 0; i < 16; i++) r.upto[i] = UINT64_MAX;
    r.upto[KIND_DYNAMIC] = c->dynamic_upto;
    r.upto[KIND_STATIC] = c->static_upto;
    return r;
}

HOT_INLINE void use_stamp(edge_chain *c, int64_t stamp) {
    c->oldest = stamp < c->oldest ? stamp : c->oldest;
    c->newest = stamp > c->newest ? stamp : c->newest;
    c->n_dynamic++;
}

/* The edge above c->cur, and on to its parent.  `next` is what the hint says of it: the frames to come are found without
 * waiting for the record. */
HOT_INLINE void use_edge(edge_chain *c, local_hint *above, uint64_t parent, int64_t stamp, bool is_static,
                         const shmtf_pose *T_parent_child, bool poseless, uint32_t next) {
    if (c->room) {
        c->room--;
        *c->edge = (shmtf_edge){parent_frame(parent), c->cur, stamp, is_static};
        c->edge += c->stride;
    }
    if (parent_frame(parent).id != next) {
        next = parent_frame(parent).id;
        hint_set(&above[c->cur.id], next);
    }
    c->last = c->cur;
    c->cur = (shmtf_frame){next, parent_frame(parent).gen};
    if (poseless) return;
    c->pose = c->has_pose ? pose_compose(T_parent_child, &c->pose) : *T_parent_child;
    c->has_pose = true;
}

static uint32_t gather_latest(edge_run *run, uint32_t most) {
    const shmtf_segment *s = run->s;
    const edge_rule rule = rule_of(run->clears);
    edge_chain c = run->chain; /* in registers */
    uint32_t n = 0;
    for (; n < most && is_frame(s, c.cur.id); n++) {
        uint32_t next = opaque32(hint_get(&run->above[c.cur.id]));
        ring_place p;
        if (!ring_newest_place(s, c.cur.id, run->snapshot, &p)) break;
        uint64_t edge = place_edge(&p);
        int64_t stamp = place_stamp(&p);
        if (p.tag <= rule.upto[edge_kind(edge)] || (uint32_t)load_relaxed(&p.f->gen) != c.cur.gen) break;
        if (edge_kind(edge) == KIND_DYNAMIC) use_stamp(&c, stamp);
        run->frame[n] = p.f;
        run->lock[n] = p.lock;
        shmtf_pose T_parent_child = ring_pose(p.f->newest[p.sel].pose);
        use_edge(&c, run->above, edge_parent(edge), stamp, edge_kind(edge) == KIND_STATIC, &T_parent_child, run->poseless, next);
    }
    run->chain = c;
    return n;
}

/* Where a frame's records around a time should be. */
typedef struct {
    ring_place p;
    uint32_t id, next; /* next: by the hint */
    bool is_static;
    bool from_newest; /* static, or the newest is the one: no ring is needed */
    const shmtf_record_head *before_head, *after_head;
    const shmtf_record_body *before, *after;
    int64_t newest_ns;
    ring_ref ring;
    uint64_t head, first, count, at;
} bracket;

static inline void bracket_set(bracket *b, uint64_t at) {
    uint64_t slot = ring_slot(&b->ring, b->head, at), after = ring_slot(&b->ring, b->head, at + 1);
    b->at = at;
    b->before_head = &b->ring.heads[slot];
    b->after_head = &b->ring.heads[after];
    b->before = &b->ring.bodies[slot];
    b->after = &b->ring.bodies[after];
}

static inline bool bracket_find(const edge_run *run, const edge_rule *rule, uint32_t id, bracket *b) {
    const shmtf_segment *s = run->s;
    if (!ring_newest_place(s, id, run->snapshot, &b->p)) return false;
    uint64_t edge = place_edge(&b->p);
    if (b->p.tag <= rule->upto[edge_kind(edge)]) return false;
    b->id = id;
    b->next = opaque32(hint_get(&run->above[id]));
    b->newest_ns = place_stamp(&b->p);
    b->is_static = edge_kind(edge) == KIND_STATIC;
    b->from_newest = b->is_static || b->newest_ns == run->time;
    if (b->from_newest) return true;
    b->head = load_acquire(&b->p.f->head[b->p.sel]);
    uint64_t search = load_relaxed(&b->p.f->newest_search[b->p.sel]);
    if (run->time > b->newest_ns || !(b->head & HEAD_BIG) || !ring_bind(s, id, b->head, &b->ring)) return false;
    uint64_t count = head_count(b->head), live = shmtf_ring_live(b->ring.log2), first = info_base(search_base(search), count);
    if (count - first >= live) first = count - live + 1;
    if (first >= count) return false;
    b->first = first;
    b->count = count;
    bracket_set(b, ring_guess(first, count, b->newest_ns, search_period(search), run->time));
    __builtin_prefetch(b->before_head);
    __builtin_prefetch(b->before_head + 2); /* the record after, and the one behind that */
    __builtin_prefetch(b->before);
    __builtin_prefetch(b->after);
    return true;
}

/* Without late stamps positions follow commits, so what is older than the newest is not newer than S.  With them it may be. */
static inline bool in_order_at(const bracket *b, uint64_t version) {
    if (!(b->head & HEAD_INDEXED)) return true;
    return load_acquire(&b->before_head->tag) - 1 < version && load_acquire(&b->after_head->tag) - 1 < version; /* [E3 acquire] */
}

static inline int64_t stamp_of(const shmtf_record_head *h) { return (int64_t)load_relaxed(&h->stamp); }

/* The pose and parent at the run's time.  False: the general way. */
static inline bool bracket_read(const edge_run *run, bracket *b, shmtf_pose *pose, uint64_t *parent, int64_t *stamp) {
    const int64_t t = run->time;
    int64_t before_ns = stamp_of(b->before_head), after_ns = stamp_of(b->after_head);
    if (before_ns > t || after_ns <= t) {
        uint64_t at = ring_last_not_after(&b->ring, b->head, b->first, b->count, b->at, t);
        if (at < b->first) return false;
        bracket_set(b, at);
        before_ns = stamp_of(b->before_head);
        after_ns = stamp_of(b->after_head);
        if (before_ns > t || after_ns <= t) return false;
    }
    *parent = load_relaxed(&b->before->parent);
    *stamp = before_ns;
    *pose = ring_pose(b->before->pose);
    if (before_ns < ring_horizon(run->s, b->newest_ns) || !in_order_at(b, commit_version(run->snapshot))) return false;
    if (before_ns == t) return true;
    bool more = b->at + 1 < b->count; /* of records with one stamp the last counts */
    if (more && stamp_of(&b->ring.heads[ring_slot(&b->ring, b->head, b->at + 2)]) == after_ns) return false;
    if (run->poseless || load_relaxed(&b->after->parent) != *parent) return true;
    shmtf_pose T_parent_child = ring_pose(b->after->pose);
    *pose = pose_interpolate(pose, &T_parent_child, ring_ratio(t, before_ns, after_ns));
    return true;
}

static uint32_t gather_at(edge_run *run, uint32_t most) {
    bracket b[RUN_MOST];
    const edge_rule rule = rule_of(run->clears);
    edge_chain c = run->chain;
    uint32_t found = 0, n = 0;
    for (uint32_t id = c.cur.id; found < most && is_frame(run->s, id) && bracket_find(run, &rule, id, &b[found]); found++) id = b[found].next;
    for (; n < found && b[n].id == c.cur.id; n++) {
        const ring_place *p = &b[n].p;
        uint64_t parent;
        int64_t stamp = b[n].newest_ns;
        shmtf_pose T_parent_child;
        if ((uint32_t)load_relaxed(&p->f->gen) != c.cur.gen) break;
        if (b[n].from_newest) {
            parent = edge_parent(place_edge(p));
            T_parent_child = ring_pose(p->f->newest[p->sel].pose);
        } else if (!bracket_read(run, &b[n], &T_parent_child, &parent, &stamp)) {
            break;
        }
        if (!b[n].is_static) use_stamp(&c, stamp);
        run->frame[n] = p->f;
        run->lock[n] = p->lock;
        use_edge(&c, run->above, parent, stamp, b[n].is_static, &T_parent_child, run->poseless, b[n].next);
    }
    run->chain = c;
    return n;
}

static bool run_holds(const edge_run *run, uint32_t n) {
    uint64_t moved = 0;
    fence_acquire(); /* [E3 acquire] [E7 acquire] */
    for (uint32_t i = 0; i < n; i++) moved |= load_relaxed(&run->frame[i]->lock) ^ run->lock[i];
    return !moved;
}

uint32_t run_edges(edge_run *run, uint32_t most) {
    announce(run, run->chain.cur.id, most);
    uint32_t n = run->at_time ? gather_at(run, most) : gather_latest(run, most);
    return n && run_holds(run, n) ? n : 0;
}

uint32_t run_meeting(const shmtf_segment *s, const local_hint *above, uint32_t a, uint32_t b) {
    for (uint32_t n = 1; n <= RUN_MOST && is_frame(s, a) && is_frame(s, b); n++) {
        a = hint_get(&above[a]);
        b = hint_get(&above[b]);
        if (a == b) return a ? n : 1;
    }
    return 1;
}
