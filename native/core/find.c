/* SPDX-License-Identifier: Apache-2.0 */
#include "core/find.h"

bool find_utf8(const char *text) {
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
bool find_same_name(const shmtf_ref *a, const shmtf_ref *b) {
    return a->name && b->name && (a->name == b->name || !strcmp(a->name, b->name));
}

find_status find_key(finder *f, const shmtf_ref *ref, name_key *key) {
    if (ref->frame.gen && !ref->name) return FIND_GONE; /* no frame has such a handle */
    f->what = names_key(key, ref->name);
    return f->what ? FIND_BAD_NAME : FIND_OK;
}

static bool seems_alive(const txn *x, shmtf_frame frame) {
    ring_place p;
    return ring_newest_place(x->s, frame.id, x->snapshot, &p) && edge_kind(place_edge(&p)) != KIND_REMOVED;
}

/* Name to handle, if the frame exists.  A name that nobody has must be a good one. */
static find_status find(finder *f, shmtf_ref *ref, const name_key *key, uint64_t hint) {
    const txn *x = f->x;
    if (!f->careful && names_leads(x->s, hint, key, &ref->frame) && seems_alive(x, ref->frame)) return FIND_OK;
    ring_status st = names_find(x->s, x->snapshot, key, &ref->frame);
    if (st == RING_OK) return FIND_OK;
    ref->frame = (shmtf_frame){0, 0};
    if (st != RING_NONE) return st == RING_CORRUPT ? FIND_CORRUPT : FIND_RETRY;
    if (find_utf8(ref->name)) return FIND_OK;
    f->what = "a frame name is not UTF-8";
    return FIND_BAD_NAME;
}

find_status find_name(finder *f, shmtf_ref *ref) {
    name_key key;
    if (is_known(f->x, ref)) return FIND_OK;
    find_status st = find_key(f, ref, &key);
    return st == FIND_OK ? find(f, ref, &key, names_hint(f->x->s, &key)) : st;
}

/* A parent that is the child of the item before or behind: chains are given link by link.  It is marked, and gets that
 * child's handle in the end.  Where the child came with a handle, the handle counts, and its name says nothing. */
static const uint32_t AS_BEFORE = UINT32_MAX, AS_BEHIND = UINT32_MAX - 1;
static bool is_marked(const shmtf_frame *parent) { return !parent->gen && parent->id >= AS_BEHIND; }

static bool mark_neighbour(const txn *x, shmtf_transform *items, size_t n, size_t i) {
    shmtf_ref *parent = &items[i].parent;
    const shmtf_ref *before = i ? &items[i - 1].child : NULL, *behind = i + 1 < n ? &items[i + 1].child : NULL;
    if (is_known(x, parent)) return false;
    if (is_marked(&parent->frame)) parent->frame = (shmtf_frame){0, 0}; /* the caller's */
    if (before && !is_known(x, before) && find_same_name(before, parent)) parent->frame = (shmtf_frame){AS_BEFORE, 0};
    else if (behind && !is_known(x, behind) && find_same_name(behind, parent)) parent->frame = (shmtf_frame){AS_BEHIND, 0};
    return is_marked(&parent->frame);
}

/* Names that are looked up side by side, so that their cache misses overlap. */
enum { AT_ONCE = 32 };
typedef struct {
    name_key key[AT_ONCE];
    uint64_t hint[AT_ONCE];
    shmtf_ref *ref[AT_ONCE];
    size_t item[AT_ONCE], n;
} find_batch;

static find_status find_together(finder *f, find_batch *b) {
    for (size_t i = 0; i < b->n; i++) b->hint[i] = names_hint(f->x->s, &b->key[i]);
    for (size_t i = 0; i < b->n; i++) {
        f->item = b->item[i];
        find_status st = find(f, b->ref[i], &b->key[i], b->hint[i]);
        if (st != FIND_OK) return st;
    }
    b->n = 0;
    return FIND_OK;
}

static find_status find_later(finder *f, shmtf_ref *ref, find_batch *b) {
    if (is_known(f->x, ref)) return FIND_OK;
    find_status st = find_key(f, ref, &b->key[b->n]);
    if (st != FIND_OK) return st;
    names_ask(f->x->s, &b->key[b->n]);
    b->ref[b->n] = ref;
    b->item[b->n++] = f->item;
    return b->n == AT_ONCE ? find_together(f, b) : FIND_OK;
}

find_status find_names(finder *f, shmtf_transform *items, size_t n) {
    find_batch b;
    find_status st = FIND_OK;
    b.n = 0;
    for (size_t i = 0; i < n && st == FIND_OK; i++) {
        bool marked = mark_neighbour(f->x, items, n, i);
        f->item = i;
        st = find_later(f, &items[i].child, &b);
        if (st != FIND_OK || marked) continue;
        f->item = i;
        st = find_later(f, &items[i].parent, &b);
    }
    if (st == FIND_OK) st = find_together(f, &b);
    for (size_t i = 0; i < n; i++) {
        shmtf_frame *parent = &items[i].parent.frame;
        if (is_marked(parent)) *parent = st == FIND_OK ? items[parent->id == AS_BEFORE ? i - 1 : i + 1].child.frame : (shmtf_frame){0, 0};
    }
    return st;
}
