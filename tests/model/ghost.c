/* SPDX-License-Identifier: Apache-2.0 */
#include "ghost.h"

#include <string.h>

ghost_state ghost[GHOST_VERSIONS];
uint64_t ghost_top;

int ghost_by_handle(const ghost_state *g, uint64_t parent) {
    for (int i = 0; i < GHOST_NAMES; i++)
        if (g->f[i].handle.gen && parent_make(g->f[i].handle) == parent) return i;
    return -1;
}

bool ghost_wrote(int thread) {
    for (uint64_t v = 1; v <= ghost_top; v++)
        if (ghost[v].writer == thread) return true;
    return false;
}

bool ghost_climb(const ghost_state *g, int frame, double *sum, int *root) {
    *sum = 0;
    for (int steps = 0; steps <= GHOST_NAMES; steps++) {
        const ghost_frame *f = &g->f[frame];
        *root = frame;
        if (!f->n) return true;
        int parent = ghost_by_handle(g, f->r[f->n - 1].parent);
        if (parent < 0) return true;
        *sum += f->r[f->n - 1].value;
        frame = parent;
    }
    return false;
}

/* The frame that an item names: there already under this handle, or born. */
static const char *meet(ghost_state *g, const shmtf_ref *ref, int *index, bool *reshapes) {
    *index = ghost_index(ref->name);
    ghost_frame *f = &g->f[*index];
    if (!ref->frame.gen) return "a committed item has no handle";
    if (!f->handle.gen) {
        if (ghost_by_handle(g, parent_make(ref->frame)) >= 0) return "one frame was given two names";
        *f = (ghost_frame){.handle = ref->frame, .kind = KIND_ROOT};
        *reshapes = true;
        return NULL;
    }
    return f->handle.id == ref->frame.id && f->handle.gen == ref->frame.gen ? NULL : "a commit used a frame that this name does not have";
}

static void put(ghost_frame *f, const shmtf_transform *t, uint64_t version, uint64_t parent, int live, bool *reshapes) {
    record_kind kind = t->flags & SHMTF_STATIC ? KIND_STATIC : KIND_DYNAMIC;
    ghost_record r = {t->stamp_ns, t->pose.x, version, parent};
    uint64_t newest_parent = f->n ? f->r[f->n - 1].parent : 0;
    bool same_kind = f->kind == kind && f->n;
    if (same_kind && kind == KIND_STATIC && newest_parent == parent && f->r[0].value == r.value) return;
    if (!same_kind || newest_parent != parent) *reshapes = true;
    if (!same_kind || kind == KIND_STATIC) f->n = 0;
    f->kind = kind;
    int at = f->n;
    while (at > 0 && f->r[at - 1].stamp > r.stamp) at--;
    if (f->n == live && at == 0) return;
    if (at > 0 && f->r[at - 1].stamp == r.stamp && f->r[at - 1].value == r.value && f->r[at - 1].parent == parent) return;
    memmove(&f->r[at + 1], &f->r[at], (size_t)(f->n - at) * sizeof r);
    f->r[at] = r;
    if (++f->n > live) memmove(&f->r[0], &f->r[1], (size_t)(--f->n) * sizeof r);
}

static const char *set(ghost_state *g, const ghost_intent *intent, int live, bool *reshapes) {
    const char *wrong = NULL;
    int index;
    for (size_t i = 0; i < intent->n && !wrong; i++) {
        wrong = meet(g, &intent->items[i].child, &index, reshapes);
        if (!wrong) wrong = meet(g, &intent->items[i].parent, &index, reshapes);
    }
    for (size_t i = 0; i < intent->n && !wrong; i++) {
        const shmtf_transform *t = &intent->items[i];
        put(&g->f[ghost_index(t->child.name)], t, ghost_top, parent_make(t->parent.frame), live, reshapes);
    }
    return wrong;
}

const char *ghost_commit(int thread, const ghost_intent *intent, int live) {
    const char *wrong = NULL;
    bool reshapes = intent->op != OP_SET;
    if (++ghost_top == GHOST_VERSIONS) return "the ghost has no room for more commits";
    ghost_state *g = &ghost[ghost_top];
    *g = ghost[ghost_top - 1];
    g->writer = thread;
    if (intent->op == OP_SET) {
        wrong = set(g, intent, live, &reshapes);
    } else if (intent->op == OP_REMOVE) {
        ghost_frame *f = &g->f[ghost_index(intent->ref->name)];
        if (!f->handle.gen || f->handle.id != intent->ref->frame.id || f->handle.gen != intent->ref->frame.gen) wrong = "a frame was removed that is not there";
        *f = (ghost_frame){.kind = KIND_NONE};
    } else {
        for (int i = 0; i < GHOST_NAMES; i++) {
            ghost_frame *f = &g->f[i];
            if (f->handle.gen && (f->kind == KIND_DYNAMIC || !intent->keep_static)) f->n = 0, f->kind = KIND_ROOT;
        }
    }
    if (reshapes) g->shape = ghost_top;
    for (int i = 0; i < GHOST_NAMES && !wrong; i++) {
        double sum;
        int root;
        if (!ghost_climb(g, i, &sum, &root)) wrong = "a commit made a cycle";
    }
    return wrong;
}
