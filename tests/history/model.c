/* SPDX-License-Identifier: Apache-2.0 */
#include "model.h"

#include <stdlib.h>
#include <string.h>

#include "model_inside.h"

static void *model_memory(void *old, size_t bytes) {
    void *p = realloc(old, bytes);
    if (!p) abort();
    return p;
}

model *model_make(uint64_t live, int64_t cache_time_ns) {
    model *m = model_memory(NULL, sizeof *m);
    memset(m, 0, sizeof *m);
    m->live = (int)live;
    m->cache = cache_time_ns;
    for (int i = 0; i < N_NAMES; i++) m->of_name[i] = NOBODY;
    m->n_buckets = 1024;
    m->buckets = model_memory(NULL, m->n_buckets * sizeof *m->buckets);
    memset(m->buckets, 0, m->n_buckets * sizeof *m->buckets);
    return m;
}

void model_free(model *m) {
    for (int i = 0; i < m->n_lives; i++) free(m->lives[i].r);
    free(m->lives);
    free(m->buckets);
    free(m);
}

const char *model_why(const model *m) { return m->why; }
uint64_t model_unjudged(const model *m) { return m->unjudged; }

/* ---- handles: one life each ---------------------------------------------------------------------------------------- */

static int *bucket_of(model *m, uint64_t handle) {
    uint64_t at = handle * 0x9e3779b97f4a7c15ull >> 20;
    while (m->buckets[at % m->n_buckets] && m->lives[m->buckets[at % m->n_buckets] - 1].handle != handle) at++;
    return &m->buckets[at % m->n_buckets];
}

static void grow_buckets(model *m) {
    uint64_t n = m->n_buckets;
    int *old = m->buckets;
    m->n_buckets *= 4;
    m->buckets = model_memory(NULL, m->n_buckets * sizeof *m->buckets);
    memset(m->buckets, 0, m->n_buckets * sizeof *m->buckets);
    for (uint64_t i = 0; i < n; i++)
        if (old[i]) *bucket_of(m, m->lives[old[i] - 1].handle) = old[i];
    free(old);
}

int model_life_of(model *m, uint64_t handle) { return *bucket_of(m, handle) - 1; }

bool model_is(model *m, int life, uint64_t handle, bool learn) {
    if (life == NOBODY || !handle) return life == NOBODY && !handle;
    int owner = model_life_of(m, handle);
    if (owner >= 0 || m->lives[life].handle) return owner == life;
    if (!learn) return true;
    if (2 * ++m->n_handles > m->n_buckets) grow_buckets(m);
    m->lives[life].handle = handle;
    *bucket_of(m, handle) = life + 1;
    return true;
}

/* ---- what a write does -------------------------------------------------------------------------------------------- */

/* Only tried: remember the life as it was. */
static void save(model *m, int life) {
    for (int i = 0; i < m->n_saved; i++)
        if (!m->trying || m->saved[i].life == life) return;
    if (!m->trying) return;
    saved_life *s = &m->saved[m->n_saved++];
    s->life = life;
    s->was = m->lives[life];
    memcpy(s->r, m->lives[life].r, (size_t)s->was.n * sizeof *s->r);
}

static void undo(model *m, int n_lives) {
    while (m->n_saved) {
        saved_life *s = &m->saved[--m->n_saved];
        if (s->life >= n_lives) continue;
        model_record *r = m->lives[s->life].r;
        m->lives[s->life] = s->was;
        m->lives[s->life].r = r;
        memcpy(r, s->r, (size_t)s->was.n * sizeof *r);
    }
    while (m->n_lives > n_lives) {
        model_life *l = &m->lives[--m->n_lives];
        m->of_name[l->name] = NOBODY;
        free(l->r);
    }
}

static void give_birth(model *m, int name) {
    if (m->of_name[name] != NOBODY) return;
    if (m->n_lives == m->room) {
        m->room = m->room ? 2 * m->room : 256;
        m->lives = model_memory(m->lives, (size_t)m->room * sizeof *m->lives);
    }
    model_life *l = &m->lives[m->n_lives];
    *l = (model_life){.name = name, .alive = true, .kind = A_ROOT, .r = model_memory(NULL, ((size_t)m->live + 1) * sizeof *l->r)};
    m->of_name[name] = m->n_lives++;
    m->changed = true;
}

static bool same_record(const model_record *a, const model_record *b) {
    return a->stamp == b->stamp && a->parent == b->parent && a->x == b->x && a->y == b->y;
}

/* Behind the last record that is not later; a full list loses its oldest. */
static void insert(model *m, model_life *l, const model_record *r) {
    int q = l->n;
    while (q > 0 && l->r[q - 1].stamp > r->stamp) q--;
    if (q == 0 && l->n == m->live) return;
    if (q > 0 && same_record(&l->r[q - 1], r)) return;
    memmove(&l->r[q + 1], &l->r[q], (size_t)(l->n - q) * sizeof *r);
    l->r[q] = *r;
    if (++l->n > m->live) memmove(&l->r[0], &l->r[1], (size_t)--l->n * sizeof *r);
    m->changed = true;
}

static shmtf_status put(model *m, int life, const model_record *r, bool is_static) {
    model_life *l = &m->lives[life];
    save(m, life);
    if (is_static && l->kind == A_STATIC && l->r[0].parent == r->parent && l->r[0].x == r->x && l->r[0].y == r->y) return SHMTF_OK;
    if (!is_static && l->kind == A_MOVING) {
        if (m->cache >= 0 && r->stamp < l->r[l->n - 1].stamp - m->cache) return SHMTF_OLD_DATA;
        insert(m, l, r);
        return SHMTF_OK;
    }
    l->kind = is_static ? A_STATIC : A_MOVING;
    l->n = 1;
    l->r[0] = *r;
    m->changed = true;
    return SHMTF_OK;
}

int model_parent(const model *m, int life) {
    const model_life *l = &m->lives[life];
    if (l->kind == A_ROOT) return NOBODY;
    int parent = l->r[l->n - 1].parent;
    return m->lives[parent].alive ? parent : NOBODY;
}

static bool in_cycle(const model *m, int life) {
    int up = life;
    for (int n = 0; n <= N_NAMES && up != NOBODY; n++) up = model_parent(m, up);
    return up != NOBODY;
}

static shmtf_status set(model *m, const history_entry *e, uint64_t version) {
    const history_item *item = history_items((history_entry *)(uintptr_t)e);
    for (int i = 0; i < e->n; i++) {
        give_birth(m, item[i].child);
        give_birth(m, item[i].parent);
    }
    for (int i = 0; i < e->n; i++) {
        model_record r = {item[i].stamp, item[i].x, item[i].y, version, m->of_name[item[i].parent]};
        shmtf_status st = put(m, m->of_name[item[i].child], &r, item[i].flags & F_STATIC);
        if (st != SHMTF_OK) return st;
    }
    for (int i = 0; i < e->n; i++)
        if (in_cycle(m, m->of_name[item[i].child])) return SHMTF_CYCLE;
    return SHMTF_OK;
}

static bool learn_handles(model *m, const history_entry *e) {
    const history_item *item = history_items((history_entry *)(uintptr_t)e);
    for (int i = 0; i < e->n && e->status == SHMTF_OK; i++) {
        if (item[i].child_handle && !model_is(m, m->of_name[item[i].child], item[i].child_handle, true)) return false;
        if (item[i].parent_handle && !model_is(m, m->of_name[item[i].parent], item[i].parent_handle, true)) return false;
    }
    return true;
}

/* What it read, under its locks, must be the newest there is. */
static bool transfer(model *m, const history_entry *e, uint64_t version) {
    const history_item *item = history_items((history_entry *)(uintptr_t)e);
    for (int i = 0; i < e->n; i++) {
        int life = m->of_name[item[i].child];
        if (life == NOBODY || m->lives[life].kind != A_MOVING) return m->why = "it wrote what does not exist", false;
        const model_record newest = m->lives[life].r[m->lives[life].n - 1];
        if (newest.x != item[i].seen_x || newest.y != item[i].seen_y) return m->why = "it read what had been overwritten: a lost update", false;
        insert(m, &m->lives[life], &(model_record){item[i].stamp, item[i].x, item[i].y, version, newest.parent});
    }
    return true;
}

static void end_life(model *m, int life) {
    model_life *l = &m->lives[life];
    m->of_name[l->name] = NOBODY;
    l->alive = false;
    free(l->r);
    l->r = NULL;
    l->n = 0;
    l->kind = A_ROOT;
}

bool model_commit(model *m, const history_entry *e, uint64_t version) {
    m->changed = false;
    m->why = "";
    switch (e->kind) {
    case OP_SET: {
        shmtf_status st = set(m, e, version);
        if (st != SHMTF_OK) return m->why = st == SHMTF_CYCLE ? "it made a cycle" : "it should have been refused", false;
        if (!m->changed) return m->why = "it changed nothing, and yet it was a commit", false;
        if (!learn_handles(m, e)) return m->why = "a handle of another frame", false;
        return true;
    }
    case OP_TRANSFER: return transfer(m, e, version);
    case OP_REMOVE:
        if (m->of_name[e->target] == NOBODY) return m->why = "it removed what does not exist", false;
        end_life(m, m->of_name[e->target]);
        return true;
    case OP_CLEAR:
        for (int i = 0; i < N_NAMES; i++) {
            model_life *l = m->of_name[i] == NOBODY ? NULL : &m->lives[m->of_name[i]];
            if (l && (l->kind == A_MOVING || !(e->flags & F_KEEP_STATIC))) l->kind = A_ROOT, l->n = 0;
        }
        return true;
    default: return m->why = "a read that committed", false;
    }
}

shmtf_status model_try(model *m, const history_entry *e, bool *changed) {
    int n_lives = m->n_lives;
    if (e->kind == OP_REMOVE) return *changed = true, m->of_name[e->target] == NOBODY ? SHMTF_LOOKUP : SHMTF_OK;
    m->trying = true;
    m->changed = false;
    shmtf_status st = set(m, e, 0);
    *changed = m->changed;
    undo(m, n_lives);
    m->trying = false;
    return st;
}
