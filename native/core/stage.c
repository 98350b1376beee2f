/* SPDX-License-Identifier: Apache-2.0 */
#include "core/stage.h"

#include "core/pose.h"

static stage_status from_txn(txn_status st) {
    switch (st) {
    case TXN_OK: return STAGE_OK;
    case TXN_HELD: return STAGE_HELD;
    case TXN_RETRY: return STAGE_RETRY;
    case TXN_FULL_FRAMES: return STAGE_FULL_FRAMES;
    case TXN_FULL_NAMES: return STAGE_FULL_NAMES;
    case TXN_FULL_ARENA: return STAGE_FULL_ARENA;
    default: return STAGE_CORRUPT;
    }
}

static stage_status from_find(stage *g, find_status st) {
    g->what = g->names.what;
    switch (st) {
    case FIND_OK: return STAGE_OK;
    case FIND_RETRY: return STAGE_RETRY;
    case FIND_GONE: return STAGE_GONE;
    case FIND_BAD_NAME: return STAGE_BAD_NAME;
    default: return STAGE_CORRUPT;
    }
}

stage_status stage_check(stage *g) {
    for (g->item = 0; g->item < g->n; g->item++) {
        shmtf_pose *pose = &g->items[g->item].pose;
        if (pose_is_normal(pose)) continue;
        g->what = pose_normalise(pose, &g->value);
        if (g->what) return STAGE_BAD_POSE;
    }
    return STAGE_OK;
}

static void forget_ended(shmtf_ref *ref, shmtf_frame ended) {
    if (ref->name && ref->frame.id == ended.id && ref->frame.gen == ended.gen) ref->frame = (shmtf_frame){0, 0};
}

/* A handle turned out to be of an ended life: look the name up again, in a new transaction, wherever it stands. */
static stage_status stale(stage *g, shmtf_ref *ref) {
    const shmtf_frame ended = ref->frame;
    if (!ref->name) return STAGE_GONE; /* the caller's handle stays as it is */
    g->names.careful = true;
    for (size_t i = 0; i < g->n; i++) {
        forget_ended(&g->items[i].child, ended);
        forget_ended(&g->items[i].parent, ended);
    }
    ref->frame = (shmtf_frame){0, 0};
    return STAGE_RETRY;
}

static void swap(uint32_t *a, uint32_t *b) {
    uint32_t t = *a;
    *a = *b;
    *b = t;
}

static void sift(uint32_t *a, size_t at, size_t n) {
    for (size_t child; (child = 2 * at + 1) < n; at = child) {
        if (child + 1 < n && a[child + 1] > a[child]) child++;
        if (a[at] >= a[child]) return;
        swap(&a[at], &a[child]);
    }
}

static void sort_ids(uint32_t *a, size_t n) {
    size_t sorted = 1;
    while (sorted < n && a[sorted - 1] <= a[sorted]) sorted++;
    if (sorted >= n) return;
    size_t falling = 1; /* chains are often given from the leaf to the root */
    while (falling < n && a[falling - 1] >= a[falling]) falling++;
    if (falling == n) {
        for (size_t i = 0, k = n - 1; i < k; i++, k--) swap(&a[i], &a[k]);
        return;
    }
    if (n <= 32) {
        for (size_t i = 1; i < n; i++) {
            uint32_t v = a[i];
            size_t j = i;
            for (; j && a[j - 1] > v; j--) a[j] = a[j - 1];
            a[j] = v;
        }
        return;
    }
    for (size_t i = n / 2; i-- > 0;) sift(a, i, n);
    for (size_t i = n - 1; i > 0; i--) {
        swap(&a[0], &a[i]);
        sift(a, 0, i);
    }
}

/* Ask for the lines of frames that are about to be written, and for those of their rings' next records: waiting for them
 * one lock at a time is most of the cost of a write that finds its store in no cache. */
static void announce(const txn *x, const uint32_t *id, size_t n) {
    enum { FITS_CACHE = 1 << 20 };
    if (x->s->arena_bytes < FITS_CACHE) return;
    for (size_t i = 0; i < n; i++) {
        const char *line = (const char *)&x->s->frames[id[i]];
        __builtin_prefetch(line, 1);
        __builtin_prefetch(line + 128, 1);
    }
    for (size_t i = 0; i < n; i++) ring_announce_write(x->s, id[i]);
}

/* The frames to lock, for what has a handle.  named: what has none now has no frame. */
static stage_status list_children(stage *g, bool named, size_t *n, bool *all) {
    const uint64_t max_frames = g->x->s->geo.max_frames;
    *n = 0;
    *all = true;
    for (g->item = 0; g->item < g->n; g->item++) {
        const shmtf_ref *child = &g->items[g->item].child, *parent = &g->items[g->item].parent;
        if (child->frame.gen && child->frame.id == parent->frame.id && child->frame.gen == parent->frame.gen) return STAGE_SELF;
        if (named && !child->frame.gen && find_same_name(child, parent)) return STAGE_SELF;
        *all &= child->frame.gen && parent->frame.gen && child->frame.id - 1ull < max_frames && parent->frame.id - 1ull < max_frames;
        if (child->frame.gen) g->order[(*n)++] = child->frame.id;
    }
    return STAGE_OK;
}

/* All locks before any write, in id order. */
static stage_status lock_children(stage *g) {
    size_t n;
    bool all;
    stage_status st = list_children(g, false, &n, &all);
    if (st != STAGE_OK) return st;
    if (!all) {
        g->names.x = g->x;
        find_status found = find_names(&g->names, g->items, g->n);
        g->item = g->names.item;
        st = from_find(g, found);
        if (st == STAGE_OK) st = list_children(g, true, &n, &all);
        if (st != STAGE_OK) return st;
    }
    g->has_unborn = !all;
    sort_ids(g->order, n);
    announce(g->x, g->order, n);
    return from_txn(txn_lock_all(g->x, g->order, n));
}

static stage_status give_birth(stage *g, shmtf_ref *ref) {
    name_key key;
    txn_entry *e;
    if (ref->frame.gen) return STAGE_OK;
    stage_status st = from_find(g, find_key(&g->names, ref, &key));
    if (st != STAGE_OK) return st;
    if (names_find_bound_by(g->x->s, &key, g->x->own, &ref->frame)) return STAGE_OK; /* by an earlier item */
    return from_txn(txn_birth(g->x, &key, &ref->frame, &e));
}

/* Does the parent exist, at every commit until this one?  Cheap where it was seen alive under the same shape. */
static stage_status check_parent(stage *g, shmtf_transform *t, bool same_edge) {
    txn *x = g->x;
    local_hint64 *checked = &x->checked[t->child.frame.id];
    if (same_edge && hint64_get(checked) == x->topology + 1) return STAGE_OK;
    txn_entry *e = txn_entry_for(x, t->parent.frame.id);
    if (e && e->born) return names_gen(x->s, e->w.id) == t->parent.frame.gen ? STAGE_OK : stale(g, &t->parent);
    ring_record r;
    switch (tree_step_latest(x->s, x->snapshot, &x->clears, t->parent.frame, &r)) {
    case STEP_OLD: return STAGE_RETRY;
    case STEP_CORRUPT: return STAGE_CORRUPT;
    case STEP_GONE: return stale(g, &t->parent);
    default: break;
    }
    if (same_edge) hint64_set(checked, x->topology + 1);
    return STAGE_OK;
}

static stage_status from_put(stage *g, put_status st) {
    switch (st) {
    case PUT_OK: g->x->n_staged++; return STAGE_OK;
    case PUT_REPEAT: g->x->repeats++; return STAGE_OK;
    case PUT_DROPPED: g->x->late_dropped++; return STAGE_OK;
    case PUT_TOO_MANY: return STAGE_TOO_MANY;
    default: return STAGE_CORRUPT;
    }
}

/* The record itself, the frame being ours and the parent alive. */
static stage_status put(stage *g, const shmtf_transform *t, txn_entry *e, const ring_record *newest, bool counts) {
    txn *x = g->x;
    bool is_static = (t->flags & SHMTF_STATIC) != 0;
    record_kind kind = is_static ? KIND_STATIC : KIND_DYNAMIC, old_kind = info_kind(newest->info);
    ring_record r = {.stamp = t->stamp_ns, .arrival = (uint64_t)g->arrival_ns, .pose = t->pose};
    r.parent = parent_make(t->parent.frame);
    r.info = info_make(0, kind, 0, g->writer);
    bool staged = newest->version == x->own;
    if (staged && counts && old_kind != kind) return STAGE_MIXED;
    bool same_shape = counts && old_kind == kind && newest->parent == r.parent;
    if (counts && kind == KIND_DYNAMIC && old_kind == kind && r.stamp < ring_horizon(x->s, newest->stamp)) {
        g->newest = newest->stamp;
        return STAGE_OLD_DATA;
    }
    if (is_static && same_shape && !memcmp(&newest->pose, &r.pose, sizeof r.pose)) return x->repeats++, STAGE_OK;
    if (!is_static) {
        txn_status st = txn_need_ring(x, e, x->s->geo.default_log2);
        if (st != TXN_OK) return from_txn(st);
    }
    g->limit = shmtf_ring_spare(is_static ? SHMTF_INLINE_LOG2 : ring_word_log2(load_relaxed(&x->s->frames[e->w.id].ring)));
    stage_status st = from_put(g, ring_put_locked(x->s, &e->w, &r, !(counts && old_kind == kind) || is_static, !is_static));
    if (st == STAGE_OK && !same_shape && e->w.used) e->reshapes = x->reshapes = true;
    return st;
}

static stage_status stage_one(stage *g, shmtf_transform *t) {
    txn *x = g->x;
    ring_record newest;
    txn_entry *e = txn_entry_for(x, t->child.frame.id);
    if (!e || names_gen(x->s, t->child.frame.id) != t->child.frame.gen) return stale(g, &t->child);
    if (!(t->flags & SHMTF_STATIC) && hint64_get(&x->checked[t->child.frame.id]) == x->topology + 1 && !e->reshapes &&
        ring_append_locked(x->s, &e->w, x->clears.dynamic_upto, t->stamp_ns, g->arrival_ns, parent_make(t->parent.frame), &t->pose, g->writer))
        return x->n_staged++, STAGE_OK;
    ring_newest_locked(x->s, &e->w, &newest);
    record_kind kind = info_kind(newest.info);
    if (!e->born && (kind == KIND_NONE || kind == KIND_REMOVED)) return stale(g, &t->child);
    bool counts = newest.position && tree_record_counts(&x->clears, &newest) && kind != KIND_REMOVED;
    bool same_edge = counts && newest.version != x->own && newest.parent == parent_make(t->parent.frame);
    stage_status st = check_parent(g, t, same_edge);
    if (st == STAGE_OK) st = put(g, t, e, &newest, counts);
    return st;
}

/* Births that got no record of their own are roots; then the shape as it will be must be a forest. */
static stage_status finish_shape(stage *g) {
    txn *x = g->x;
    if (!x->reshapes) return STAGE_OK;
    for (size_t i = 0; i < x->n; i++) {
        txn_entry *e = &x->entries[i];
        if (e->born && !e->w.used) {
            txn_status st = txn_put_mark(x, e, KIND_ROOT, 0, 0, g->arrival_ns, g->writer);
            if (st != TXN_OK) return from_txn(st);
        }
        ring_record newest;
        ring_newest_locked(x->s, &e->w, &newest);
        *txn_parent_of(x, e) = tree_record_counts(&x->clears, &newest) ? newest.parent : 0;
    }
    uint32_t cyclic;
    bool found;
    txn_status st = txn_check_cycles(x, &cyclic, &found);
    if (st != TXN_OK) return from_txn(st);
    if (!found) return STAGE_OK;
    /* Locked frames were read now, those above them at the snapshot: a cycle of both is one if the shape has stood still. */
    if (tree_topology_at(x->s, load_acquire(&x->s->global->commit)) != x->topology) return STAGE_RETRY; /* [E2 acquire] */
    for (g->item = 0; g->item + 1 < g->n && g->items[g->item].child.frame.id != cyclic;) g->item++;
    return STAGE_CYCLE;
}

void stage_forget_unborn(stage *g) {
    for (size_t i = 0; i < g->n; i++) {
        shmtf_ref *refs[2] = {&g->items[i].child, &g->items[i].parent};
        for (int k = 0; k < 2; k++) {
            uint32_t id = refs[k]->frame.id;
            if (refs[k]->name && refs[k]->frame.gen && id <= g->x->s->geo.max_frames && names_frame_free(g->x->s, id))
                refs[k]->frame = (shmtf_frame){0, 0};
        }
    }
}

stage_status stage_transforms(stage *g) {
    stage_status st = lock_children(g);
    if (st != STAGE_OK) return st;
    for (g->item = 0; g->item < g->n && g->has_unborn; g->item++) {
        st = give_birth(g, &g->items[g->item].child);
        if (st == STAGE_OK) st = give_birth(g, &g->items[g->item].parent);
        if (st != STAGE_OK) return st;
    }
    for (g->item = 0; g->item < g->n; g->item++) {
        st = stage_one(g, &g->items[g->item]);
        if (st != STAGE_OK) return st;
    }
    return finish_shape(g);
}

stage_status stage_declare(stage *g, const char *name, unsigned ring_log2) {
    txn *x = g->x;
    shmtf_ref ref = {name, {0, 0}};
    txn_entry *e;
    name_key key;
    g->names.careful = true;
    g->names.x = x;
    stage_status st = from_find(g, find_name(&g->names, &ref));
    if (st == STAGE_OK) st = from_find(g, find_key(&g->names, &ref, &key));
    if (st != STAGE_OK) return st;
    bool born = !ref.frame.gen;
    st = from_txn(born ? txn_birth(x, &key, &ref.frame, &e) : txn_lock_try(x, ref.frame.id, &e));
    if (st != STAGE_OK) return st;
    shmtf_frame_words_t *f = &x->s->frames[ref.frame.id];
    if (names_gen(x->s, ref.frame.id) != ref.frame.gen || (!born && names_frame_free(x->s, ref.frame.id))) return STAGE_RETRY;
    uint64_t ring = load_relaxed(&f->ring);
    if (ring && ring_word_log2(ring) != ring_log2) {
        if (!born) {
            g->limit = shmtf_ring_live(ring_word_log2(ring));
            return STAGE_DECLARED;
        }
        store_relaxed(&f->ring, 0); /* of an earlier life */
    }
    st = from_txn(txn_need_ring(x, e, ring_log2));
    e->claimed = e->claimed && born; /* the ring is all that a root that exists already gets */
    if (st == STAGE_OK && born) st = from_txn(txn_put_mark(x, e, KIND_ROOT, 0, 0, g->arrival_ns, g->writer));
    return st;
}

stage_status stage_remove(stage *g, shmtf_ref *ref) {
    txn *x = g->x;
    txn_entry *e;
    g->names.x = x;
    stage_status st = from_find(g, find_name(&g->names, ref));
    if (st != STAGE_OK) return st;
    if (!ref->frame.gen) return STAGE_GONE;
    st = from_txn(txn_lock_try(x, ref->frame.id, &e));
    if (st != STAGE_OK) return st;
    if (names_gen(x->s, ref->frame.id) != ref->frame.gen || names_frame_free(x->s, ref->frame.id)) return stale(g, ref);
    return from_txn(txn_put_mark(x, e, KIND_REMOVED, 0, 0, g->arrival_ns, g->writer));
}

stage_status stage_clear(stage *g, bool keep_static) {
    txn_entry *e;
    stage_status st = from_txn(txn_lock_try(g->x, TREE_CLEARS_ID, &e));
    if (st != STAGE_OK) return st;
    /* The last clear that ended static records too; its version is not known before it commits, hence the chain. */
    uint64_t full = g->x->clears.static_upto;
    return from_txn(txn_put_mark(g->x, e, KIND_CLEAR, keep_static ? CLEAR_KEEPS_STATIC : 0, full, g->arrival_ns, g->writer));
}
