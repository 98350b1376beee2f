/* SPDX-License-Identifier: Apache-2.0
 *
 * What reads should find in the state that model.c keeps.
 */
#include <math.h>
#include <stdio.h>

#include "model_inside.h"

typedef struct {
    int child, parent;
    int64_t stamp;
    double x, y;
    bool is_static;
} edge;

/* A way up: its edges, where it ends, and why. */
typedef struct {
    edge e[N_NAMES + 1];
    int n;
    shmtf_status end;
    bool loops;
} way;

typedef struct {
    shmtf_status status;
    edge e[2 * N_NAMES];
    int n;
    double x, y;
    bool loops;
} found;

/* The edge above a life at a time; NOBODY as its parent: there is none. */
static shmtf_status edge_at(const model *m, int life, int64_t t, edge *out) {
    const model_life *l = &m->lives[life];
    const model_record *newest = &l->r[l->n - 1];
    int i = l->n - 1;
    while (i >= 0 && l->r[i].stamp > t) i--;
    bool expired = i >= 0 && m->cache >= 0 && l->r[i].stamp < newest->stamp - m->cache;
    if (t > newest->stamp) return l->n == 1 ? SHMTF_NO_DATA : SHMTF_FORWARD;
    if (i < 0 || expired) return l->n == 1 ? SHMTF_NO_DATA : SHMTF_BACKWARD;
    const model_record *before = &l->r[i];
    *out = (edge){life, before->parent, before->stamp, before->x, before->y, false};
    if (before->stamp == t || i == l->n - 1) return SHMTF_OK;
    const model_record *after = &l->r[i + 1];
    while (after < newest && after[1].stamp == after->stamp) after++;
    if (after->parent != before->parent) return SHMTF_OK;
    double u = (double)(t - before->stamp) / (double)(after->stamp - before->stamp);
    out->x = (1 - u) * before->x + u * after->x;
    out->y = (1 - u) * before->y + u * after->y;
    return SHMTF_OK;
}

static void climb(const model *m, int life, const int64_t *t, way *w) {
    w->n = 0;
    w->end = SHMTF_OK;
    w->loops = false;
    for (;;) {
        const model_life *l = &m->lives[life];
        edge *e = &w->e[w->n];
        if (l->kind == A_ROOT) return;
        if (t && l->kind == A_MOVING) {
            w->end = edge_at(m, life, *t, e);
            if (w->end != SHMTF_OK) return;
        } else {
            const model_record *r = &l->r[l->n - 1];
            *e = (edge){life, r->parent, r->stamp, r->x, r->y, l->kind == A_STATIC};
        }
        if (!m->lives[e->parent].alive) return;
        life = e->parent;
        if (++w->n > N_NAMES - 1) {
            w->loops = true;
            return;
        }
    }
}

/* The i-th life of a way, the start being the 0th. */
static int at(const way *w, int start, int i) { return i ? w->e[i - 1].parent : start; }

static void look(const model *m, int target, int source, const int64_t *t, found *f) {
    static way a, b;
    f->n = 0;
    f->x = f->y = 0;
    climb(m, source, t, &a);
    climb(m, target, t, &b);
    f->loops = a.loops || b.loops;
    for (int i = 0; i <= a.n; i++)
        for (int j = 0; j <= b.n; j++) {
            if (at(&a, source, i) != at(&b, target, j)) continue;
            for (int k = 0; k < i; k++) f->e[f->n++] = a.e[k], f->x += a.e[k].x, f->y += a.e[k].y;
            for (int k = j - 1; k >= 0; k--) f->e[f->n++] = b.e[k], f->x -= b.e[k].x, f->y -= b.e[k].y;
            f->status = SHMTF_OK;
            return;
        }
    f->status = a.end != SHMTF_OK ? a.end : b.end != SHMTF_OK ? b.end : SHMTF_CONNECTIVITY;
    if (!t || f->status == SHMTF_CONNECTIVITY) return;
    static found newest; /* is there a way at all? */
    look(m, target, source, NULL, &newest);
    if (newest.status != SHMTF_OK) f->status = newest.status;
}

static void look_up(model *m, const history_entry *e, found *f) {
    int target = m->of_name[e->target], source = m->of_name[e->source];
    f->loops = false;
    f->status = SHMTF_LOOKUP;
    if (target == NOBODY || source == NOBODY) return;
    look(m, target, source, e->kind == OP_AT ? &e->time : NULL, f);
    if (e->kind != OP_COMMON || f->status != SHMTF_OK) return;
    int64_t oldest = INT64_MAX, newest = INT64_MIN;
    for (int i = 0; i < f->n; i++) {
        if (f->e[i].is_static) continue;
        if (f->e[i].stamp < oldest) oldest = f->e[i].stamp;
        if (f->e[i].stamp > newest) newest = f->e[i].stamp;
    }
    if (oldest < newest) look(m, target, source, &oldest, f);
}

static bool wrong(model *m, const char *why) {
    m->why = why;
    return false;
}

static bool another_outcome(model *m, const history_entry *e, shmtf_status expected) {
    snprintf(m->text, sizeof m->text, "status %d where %d was right", e->status, (int)expected);
    return wrong(m, m->text);
}

/* Interpolated numbers are rounded otherwise; values differ by 1 at least. */
static bool near(double a, double b) { return fabs(a - b) < 0.05; }

static bool lookup_answers(model *m, const history_entry *e, bool learn) {
    static found f;
    const history_item *item = history_items((history_entry *)(uintptr_t)e);
    look_up(m, e, &f);
    if (f.loops) return m->unjudged++, true;
    if (f.status != (shmtf_status)e->status) return another_outcome(m, e, f.status);
    if (f.status != SHMTF_OK) return true;
    if (f.n != e->n) return wrong(m, "another path");
    for (int i = 0; i < f.n; i++) {
        if (f.e[i].is_static != !!(item[i].flags & F_STATIC)) return wrong(m, "static or not");
        if (f.e[i].stamp != item[i].stamp) return wrong(m, "another record's stamp");
        if (!model_is(m, f.e[i].child, item[i].child_handle, learn)) return wrong(m, "another frame on the path");
        if (!model_is(m, f.e[i].parent, item[i].parent_handle, learn)) return wrong(m, "another parent");
    }
    return near(f.x, e->x) && near(f.y, e->y) ? true : wrong(m, "another value");
}

/* Newest first.  What a ring has lost since is not listed, but no gap. */
static bool records_answer(model *m, const history_entry *e, bool learn) {
    const history_item *item = history_items((history_entry *)(uintptr_t)e);
    int life = m->of_name[e->source], n = 0;
    if (life == NOBODY || e->status != SHMTF_OK)
        return (life == NOBODY) == (e->status == SHMTF_LOOKUP) ? true : wrong(m, "exists or not");
    const model_life *l = &m->lives[life];
    for (int i = l->n - 1; i >= 0 && n < e->n; i--) {
        const model_record *r = &l->r[i];
        if (i < l->n - 1 && r->stamp == l->r[i + 1].stamp) continue;
        if (l->kind == A_MOVING && m->cache >= 0 && r->stamp < l->r[l->n - 1].stamp - m->cache) break;
        const history_item *got = &item[n++];
        if (got->stamp != r->stamp || got->version != r->version || got->x != r->x || got->y != r->y) return wrong(m, "another record");
        if (!model_is(m, r->parent, got->parent_handle, learn)) return wrong(m, "a record with another parent");
        if ((l->kind == A_STATIC) != !!(got->flags & F_STATIC)) return wrong(m, "static or not");
    }
    return n == e->n && (n > 0 || l->n == 0) ? true : wrong(m, "more records, or fewer");
}

static bool frames_answer(model *m, const history_entry *e) {
    const history_item *item = history_items((history_entry *)(uintptr_t)e);
    int alive = 0, unknown = 0, strange = 0;
    for (int name = 0; name < N_NAMES; name++) {
        int life = m->of_name[name];
        alive += life != NOBODY;
        unknown += life != NOBODY && !m->lives[life].handle;
    }
    for (int i = 0; i < e->n; i++) {
        int life = model_life_of(m, item[i].child_handle);
        if (life == NOBODY) strange++;
        else if (!m->lives[life].alive) return wrong(m, "a frame that was removed");
    }
    return e->n == alive && strange == unknown ? true : wrong(m, "more frames, or fewer");
}

static bool frame_answers(model *m, const history_entry *e, bool learn) {
    int life = m->of_name[e->source];
    if ((life == NOBODY) != (e->status == SHMTF_LOOKUP)) return wrong(m, "exists or not");
    if (life == NOBODY) return true;
    if (e->kind == OP_PARENT) life = model_parent(m, life);
    return model_is(m, life, history_items((history_entry *)(uintptr_t)e)[0].child_handle, learn) ? true : wrong(m, "another frame");
}

/* A write that was refused, or that found everything there. */
static bool write_answers(model *m, const history_entry *e) {
    bool changed;
    shmtf_status st = model_try(m, e, &changed);
    if (st != (shmtf_status)e->status) return another_outcome(m, e, st);
    return st != SHMTF_OK || !changed ? true : wrong(m, "a write that had something to write and did not");
}

bool model_answers(model *m, const history_entry *e, bool learn) {
    m->why = "";
    switch (e->kind) {
    case OP_SET:
    case OP_REMOVE: return write_answers(m, e);
    case OP_LATEST:
    case OP_AT:
    case OP_COMMON: return lookup_answers(m, e, learn);
    case OP_RECORDS: return records_answer(m, e, learn);
    case OP_FRAMES: return frames_answer(m, e);
    case OP_EXISTS:
    case OP_PARENT: return frame_answers(m, e, learn);
    case OP_SNAPSHOT: return true;
    default: return wrong(m, "an operation that cannot fail like this");
    }
}
