/* SPDX-License-Identifier: Apache-2.0
 *
 * The names of a batch, to handles.
 */
#include "core/stage.h"

static stage_status from_ring(ring_status st) {
    return st == RING_OK ? STAGE_OK : st == RING_CORRUPT ? STAGE_CORRUPT : STAGE_RETRY;
}

bool stage_utf8(const char *text) {
    const unsigned char *p = (const unsigned char *)text;
    while (*p) {
        unsigned c = *p++, more = c < 0x80 ? 0 : (c & 0xe0) == 0xc0 ? 1 : (c & 0xf0) == 0xe0 ? 2 : (c & 0xf8) == 0xf0 ? 3 : 9;
        uint32_t code = c & (0x7fu >> (more ? more + 1 : 0));
        static const uint32_t least[4] = {0, 0x80, 0x800, 0x10000};
        if (more > 3) return false;
        for (unsigned i = 0; i < more; i++, p++) {
            if ((*p & 0xc0) != 0x80) return false;
            code = code << 6 | (*p & 0x3fu);
        }
        if (code < least[more] || code > 0x10ffff || (code >= 0xd800 && code < 0xe000)) return false;
    }
    return true;
}

static bool is_known(const txn *x, const shmtf_ref *ref) {
    return ref->frame.gen && ref->frame.id && ref->frame.id <= x->s->geo.max_frames;
}
bool stage_same_name(const shmtf_ref *a, const shmtf_ref *b) {
    return a->name && b->name && (a->name == b->name || !strcmp(a->name, b->name));
}

stage_status stage_key(stage *g, const shmtf_ref *ref, name_key *key) {
    if (ref->frame.gen && !ref->name) return STAGE_GONE; /* no frame has such a handle */
    g->what = names_key(key, ref->name);
    return g->what ? STAGE_BAD_NAME : STAGE_OK;
}

/* The frame that most likely has the name.  Under its lock it turns out whether it is alive; if it is not, names are looked
 * up with care. */
static bool seems_alive(const txn *x, const name_key *key, shmtf_frame *frame) {
    ring_place p;
    return names_guess(x->s, key, frame) && ring_newest_place(x->s, frame->id, commit_version(x->snapshot), &p) &&
           info_kind(load_relaxed(&p.newest->info)) != KIND_REMOVED;
}

/* Name to handle, if the frame exists.  A name that nobody has must be a good one. */
static stage_status find(stage *g, shmtf_ref *ref, const name_key *key) {
    const txn *x = g->x;
    if (!g->careful && seems_alive(x, key, &ref->frame)) return STAGE_OK;
    ring_status st = names_find(x->s, x->snapshot, key, &ref->frame);
    if (st == RING_OK) return STAGE_OK;
    ref->frame = (shmtf_frame){0, 0};
    if (st != RING_NONE) return from_ring(st);
    if (stage_utf8(ref->name)) return STAGE_OK;
    g->what = "a frame name is not UTF-8";
    return STAGE_BAD_NAME;
}

stage_status stage_find(stage *g, shmtf_ref *ref) {
    name_key key;
    if (is_known(g->x, ref)) return STAGE_OK;
    stage_status st = stage_key(g, ref, &key);
    return st == STAGE_OK ? find(g, ref, &key) : st;
}

/* The item whose child is the parent of item i, if it is a neighbour: chains are given link by link. */
static const shmtf_ref *neighbour(const stage *g, size_t i) {
    const shmtf_ref *parent = &g->items[i].parent;
    if (i && stage_same_name(&g->items[i - 1].child, parent)) return &g->items[i - 1].child;
    if (i + 1 < g->n && stage_same_name(&g->items[i + 1].child, parent)) return &g->items[i + 1].child;
    return NULL;
}

/* Names that are looked up side by side, so that their cache misses overlap. */
enum { FIND_AT_ONCE = 32 };
typedef struct {
    name_key key[FIND_AT_ONCE];
    shmtf_ref *ref[FIND_AT_ONCE];
    size_t item[FIND_AT_ONCE], n;
} find_batch;

static stage_status find_together(stage *g, find_batch *b) {
    for (size_t i = 0; i < b->n; i++) names_announce(g->x->s, &b->key[i]);
    for (size_t i = 0; i < b->n; i++) {
        g->item = b->item[i];
        stage_status st = find(g, b->ref[i], &b->key[i]);
        if (st != STAGE_OK) return st;
    }
    b->n = 0;
    return STAGE_OK;
}

static stage_status find_later(stage *g, shmtf_ref *ref, find_batch *b) {
    if (is_known(g->x, ref)) return STAGE_OK;
    stage_status st = stage_key(g, ref, &b->key[b->n]);
    if (st != STAGE_OK) return st;
    names_announce_bucket(g->x->s, &b->key[b->n]);
    b->ref[b->n] = ref;
    b->item[b->n++] = g->item;
    return b->n == FIND_AT_ONCE ? find_together(g, b) : STAGE_OK;
}

stage_status stage_find_all(stage *g) {
    find_batch b;
    b.n = 0;
    for (size_t i = 0; i < g->n; i++) {
        g->item = i;
        stage_status st = find_later(g, &g->items[i].child, &b);
        if (st == STAGE_OK && !neighbour(g, i)) {
            g->item = i;
            st = find_later(g, &g->items[i].parent, &b);
        }
        if (st != STAGE_OK) return st;
    }
    stage_status st = find_together(g, &b);
    for (size_t i = 0; i < g->n && st == STAGE_OK; i++) {
        const shmtf_ref *other = is_known(g->x, &g->items[i].parent) ? NULL : neighbour(g, i);
        if (other) g->items[i].parent.frame = other->frame;
    }
    return st;
}
