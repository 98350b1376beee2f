/* SPDX-License-Identifier: Apache-2.0
 * usage: xsim [SCENARIO|all [PREEMPTIONS [CRASHES [STRIDE [SALT [SECONDS]]]]]] */
#include "xsim.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { LIVE = 6, LATE_TIME = 47 };

world xs;
static writer writers[XSIM_SLOTS], writers_before[XSIM_SLOTS];
static int owner_of[XSIM_SLOTS]; /* slot: thread */
static ghost_intent intents[XSIM_SLOTS];
static uint64_t committed_by_slot[XSIM_SLOTS];
static const scenario *scene;
static unsigned char *image;
static size_t image_from, image_size, skip_from, skip_to;
static uint64_t setup_top;
static ghost_state setup_ghost;
static long n_reads, n_old, n_conflicts, n_commits;

void xsim_fail(const char *what, uint64_t got, uint64_t want) {
    char text[256];
    snprintf(text, sizeof text, "%s: got %llu, want %llu", what, (unsigned long long)got, (unsigned long long)want);
    sched_fail(text);
}
static void expect(uint64_t got, uint64_t want, const char *what) { xsim_expect(got, want, what); }

static void stepped(int thread);

/* ---- transactions -------------------------------------------------------------------------------------------- */

static bool owner_dead(unsigned slot) { return slot < XSIM_SETUP && sched_is_dead(owner_of[slot]); }

static stage_status stage_intent(writer *wr, const ghost_intent *in) {
    switch (in->op) {
    case OP_SET: return stage_transforms(&wr->g);
    case OP_REMOVE: return stage_remove(&wr->g, in->ref);
    default: return stage_clear(&wr->g, in->keep_static);
    }
}

/* What is in the way is a dead writer's, or worth waiting for: try again. */
static bool negotiate(txn *x) {
    if (owner_dead(lock_slot(x->blocked_by))) {
        shmtf_word *want = &xs.s.frames[x->blocked_id].want;
        if (load_acquire(want) == x->blocked_by) cas_acq_rel(want, x->blocked_by, 0);
        recover_dead(&xs.s, x->blocked_id, x->blocked_by);
        return true;
    }
    if (!x->pushing || x->n_staged || x->wished) return false;
    txn_want(x, x->blocked_id);
    sched_wait();
    return true;
}

static stage_status perform(int slot, ghost_intent in, int tries) {
    writer *wr = &writers[slot];
    stage_status st = STAGE_RETRY;
    while (tries-- > 0) {
        intents[slot] = in;
        uint64_t before = committed_by_slot[slot];
        wr->version = 0;
        st = stage_begin(wr, in.items, in.n);
        if (st == STAGE_OK) st = stage_intent(wr, &in);
        while (st == STAGE_HELD && negotiate(&wr->x)) st = stage_intent(wr, &in);
        for (uint32_t id = 0; wr->x.pushing && id <= xs.s.geo.max_frames; id++) txn_unwant(&wr->x, id);
        st = stage_end(wr, st);
        if (sched_current() < 0) stepped(-1); /* the setup and the end are not scheduled */
        if (st == STAGE_OK && wr->version) expect(wr->version, committed_by_slot[slot], "the version a commit reports");
        else expect(committed_by_slot[slot], before, "a transaction that failed has committed");
        if (st != STAGE_RETRY && st != STAGE_HELD) return st;
        n_conflicts++;
    }
    return st;
}

stage_status xsim_set(int slot, shmtf_transform *items, size_t n, int tries) {
    return perform(slot, (ghost_intent){OP_SET, items, n, NULL, false}, tries);
}
stage_status xsim_remove(int slot, shmtf_ref ref, int tries) { return perform(slot, (ghost_intent){OP_REMOVE, NULL, 0, &ref, false}, tries); }
stage_status xsim_clear(int slot, bool keep_static, int tries) {
    return perform(slot, (ghost_intent){OP_CLEAR, NULL, 0, NULL, keep_static}, tries);
}

void xsim_manners(int slot, xsim_manner m) {
    txn *x = &writers[slot].x;
    x->yields = x->defers = m == POLITE;
    x->pushing = m == WAITS || m == WAITS_FIRST;
    x->priority = m == WAITS_FIRST;
}

void xsim_declare(int slot, const char *name, unsigned log2) { expect(declare_named(&writers[slot], name, log2), STAGE_OK, "a ring"); }

bool xsim_adopt(int slot) {
    if (!sched_is_dead(owner_of[slot])) return false;
    owner_of[slot] = sched_current();
    writers[slot].x.live_from = recover_adopt(&xs.s, (unsigned)slot);
    memset(writers[slot].x.entry_of, 0, (xs.s.geo.max_frames + 1) * sizeof(uint32_t));
    for (uint32_t id = 0; id <= xs.s.geo.max_frames; id++) {
        uint64_t lock = atomic_load(&xs.s.frames[id].lock);
        if (lock_owned(lock) && lock_slot(lock) == (unsigned)slot) xsim_fail("adoption left a lock of the slot", id, 0);
    }
    return true;
}

/* ---- reads ----------------------------------------------------------------------------------------------------- */

uint64_t xsim_snapshot(void) { return load_acquire(&xs.s.global->commit); }

static const ghost_state *at(uint64_t snapshot) { return &ghost[commit_version(snapshot)]; }

static void check_record(const ring_record *r, const ghost_record *g, const char *what) {
    n_reads++;
    expect(r->version, g->version, what);
    expect((uint64_t)r->stamp, (uint64_t)g->stamp, what);
    expect(r->parent, g->parent, what);
    expect((uint64_t)r->pose.x, (uint64_t)g->value, what);
}

/* The frame's newest record as it was, whoever has the handle's id by now. */
static void check_latest(uint64_t snapshot, shmtf_frame handle, const ghost_frame *g) {
    tree_clears clears;
    ring_record r;
    bool alive = g->handle.gen && g->handle.id == handle.id && g->handle.gen == handle.gen;
    ring_status st = tree_clears_at(&xs.s, snapshot, &clears);
    tree_step step = st == RING_OK ? tree_step_latest(&xs.s, snapshot, &clears, handle, &r) : STEP_OLD;
    if (st == RING_CORRUPT || step == STEP_CORRUPT) sched_fail("a reader saw an impossible word");
    if (step == STEP_OLD) return (void)n_old++;
    expect(step, !alive ? STEP_GONE : g->n ? STEP_EDGE : STEP_ROOT, "whether the frame has an edge");
    if (step == STEP_EDGE) check_record(&r, &g->r[g->n - 1], "the newest record");
}

void xsim_read_latest(uint64_t snapshot, const char *names) {
    for (; *names; names++) {
        int k = *names - 'a';
        if (setup_ghost.f[k].handle.gen) check_latest(snapshot, setup_ghost.f[k].handle, &at(snapshot)->f[k]);
    }
}

void xsim_read_names(uint64_t snapshot, const char *names) {
    for (; *names; names++) {
        const ghost_frame *g = &at(snapshot)->f[*names - 'a'];
        const char name[2] = {*names, 0};
        shmtf_frame f;
        ring_status st = find_frame(&xs, snapshot, name, &f);
        if (st == RING_CORRUPT) sched_fail("a name led to an impossible word");
        if (st == RING_OLD || st == RING_AGAIN) {
            n_old++;
            continue;
        }
        expect(st == RING_OK, g->handle.gen != 0, "whether the name exists");
        if (st == RING_OK) expect(parent_make(f), parent_make(g->handle), "the handle of a name");
        if (st == RING_OK) check_latest(snapshot, f, g);
    }
}

/* Which records surround a time; -1: none. */
static void around(const ghost_frame *g, int64_t t, int *before, int *after) {
    *before = *after = -1;
    for (int i = 0; i < g->n && g->r[i].stamp <= t; i++) *before = i;
    for (int i = *before + 1; i < g->n && (*after < 0 || g->r[i].stamp == g->r[*after].stamp); i++) *after = i;
    if (t >= g->r[g->n - 1].stamp || (*before >= 0 && g->r[*before].stamp == t)) *after = -1;
}

static void check_around(const ring_around_result *a, const ghost_frame *g, int64_t t) {
    int before, after;
    check_record(&a->newest, &g->r[g->n - 1], "the newest record around a time");
    if (g->kind != KIND_DYNAMIC) return;
    around(g, t, &before, &after);
    expect(a->has_before, before >= 0, "whether there is a record before");
    expect(a->has_after, after >= 0, "whether there is a record after");
    if (before >= 0) check_record(&a->before, &g->r[before], "the record before");
    if (after >= 0) check_record(&a->after, &g->r[after], "the record after");
}

/* What a run of one edge says, if it says anything. */
static void check_run(uint64_t snapshot, const tree_clears *clears, shmtf_frame handle, const ghost_frame *g, int64_t t) {
    edge_run run = {.s = &xs.s, .snapshot = snapshot, .clears = clears, .above = xs.above, .at_time = true, .time = t};
    run.chain = (edge_chain){.cur = handle, .oldest = INT64_MAX, .newest = INT64_MIN};
    if (!run_edges(&run, 1)) return;
    n_reads++;
    int before = g->n - 1, after = -1;
    bool alive = g->handle.gen && parent_make(g->handle) == parent_make(handle);
    expect(alive && g->n, true, "whether a run finds an edge");
    if (g->kind == KIND_DYNAMIC) around(g, t, &before, &after);
    if (before < 0 || (g->kind == KIND_DYNAMIC && t > g->r[g->n - 1].stamp))
        return sched_fail("a run found an edge outside its records");
    const ghost_record *b = &g->r[before], *a = &g->r[after < 0 ? before : after];
    double want = b->value;
    if (a != b && a->parent == b->parent) want += (a->value - want) * (double)(t - b->stamp) / (double)(a->stamp - b->stamp);
    expect(parent_make(run.chain.cur), b->parent, "the parent in a run");
    expect((uint64_t)(int64_t)(run.chain.pose.x * 1e6 + 0.5), (uint64_t)(int64_t)(want * 1e6 + 0.5), "the value of a run");
}

void xsim_read_around(uint64_t snapshot, const char *names, int64_t time) {
    for (; *names; names++) {
        int k = *names - 'a';
        shmtf_frame handle = setup_ghost.f[k].handle;
        const ghost_frame *g = &at(snapshot)->f[k];
        lookup l = {.s = &xs.s, .snapshot = snapshot, .at_time = true, .time = time};
        ring_around_result a;
        if (tree_clears_at(&xs.s, snapshot, &l.clears) != RING_OK) continue;
        ring_status st = ring_around(&xs.s, handle.id, snapshot, time, &a);
        tree_step step = tree_classify(&xs.s, snapshot, &l.clears, handle, st, &a.newest);
        if (step == STEP_OLD) {
            n_old++;
            continue;
        }
        bool alive = g->handle.gen && parent_make(g->handle) == parent_make(handle);
        expect(step, !alive ? STEP_GONE : g->n ? STEP_EDGE : STEP_ROOT, "whether the frame has an edge at that time");
        if (step == STEP_EDGE) check_around(&a, g, time);
        check_run(snapshot, &l.clears, handle, g, time);
    }
}

void xsim_read_path(uint64_t snapshot, const char *target, const char *source) {
    lookup l;
    const ghost_state *g = at(snapshot);
    int it = ghost_index(target), is = ghost_index(source), rt, rs;
    double t = 0, s = 0;
    lookup_status st = look_up(&xs, snapshot, target, source, NULL, &l);
    if (st == LOOKUP_OLD) return (void)n_old++;
    n_reads++;
    if (!g->f[it].handle.gen) return expect(st, LOOKUP_NO_TARGET, "a lookup without target");
    if (!g->f[is].handle.gen) return expect(st, LOOKUP_NO_SOURCE, "a lookup without source");
    ghost_climb(g, it, &t, &rt);
    ghost_climb(g, is, &s, &rs);
    expect(st, rt == rs ? LOOKUP_OK : LOOKUP_DISCONNECTED, "a lookup");
    if (st == LOOKUP_OK) expect((uint64_t)(int64_t)l.pose.x, (uint64_t)(int64_t)(s - t), "the value of a path");
}

/* ---- executions ------------------------------------------------------------------------------------------------ */

static void copy_workspace(writer *to, const writer *from) {
    size_t n = xs.s.geo.max_frames + 1;
    memset(to->x.entry_of, 0, n * sizeof *to->x.entry_of);
    memset(to->x.mark, 0, n * sizeof *to->x.mark);
    memcpy((void *)to->x.checked, (const void *)from->x.checked, n * sizeof *to->x.checked);
    to->x.climbs = 0;
    to->x.n = 0;
    to->x.yields = to->x.defers = to->x.pushing = to->x.priority = false;
    to->x.deferred_to = 0;
    to->x.live_from = from->x.live_from;
    to->arrival_ns = from->arrival_ns;
}

static void reset(void) {
    unsigned char *memory = xs.memory;
    memcpy(memory + image_from, image + image_from, skip_from - image_from);
    memcpy(memory + skip_to, image + skip_to, image_size - skip_to);
    memset((void *)xs.depth, 0, (xs.s.geo.max_frames + 1) * sizeof *xs.depth);
    memset((void *)xs.above, 0, (xs.s.geo.max_frames + 1) * sizeof *xs.above);
    for (int i = 0; i < XSIM_SLOTS; i++) {
        copy_workspace(&writers[i], &writers_before[i]);
        owner_of[i] = i < XSIM_SETUP ? i : -1;
        committed_by_slot[i] = 0;
    }
    ghost_top = setup_top;
}

static void stepped(int thread) {
    uint64_t commit = atomic_load(&xs.s.global->commit);
    if (commit_version(commit) == ghost_top) return;
    expect(commit_version(commit), ghost_top + 1, "the version of a commit");
    unsigned slot = commit_slot(commit);
    if (slot >= XSIM_SLOTS || owner_of[slot] != thread) xsim_fail("the slot of a commit", slot, (uint64_t)thread);
    const char *wrong = ghost_commit(thread, &intents[slot], LIVE);
    if (wrong) sched_fail(wrong);
    committed_by_slot[slot] = ghost_top;
    n_commits++;
}

static void finish(void) {
    for (int i = 0; i < XSIM_SETUP; i++)
        if (owner_dead((unsigned)i)) xsim_adopt(i);
    for (uint32_t id = 0; id <= xs.s.geo.max_frames; id++) xsim_check_ring(id);
    uint64_t now = xsim_snapshot();
    expect(commit_version(now), ghost_top, "the last version");
    long old = n_old;
    xsim_read_names(now, "abcdef");
    xsim_read_around(now, scene->names, LATE_TIME);
    expect((uint64_t)n_old, (uint64_t)old, "a read at rest that was refused");
    uint64_t topology = tree_topology_at(&xs.s, now);
    if (topology < ghost[ghost_top].shape || topology > ghost_top) xsim_fail("the topology word", topology, ghost[ghost_top].shape);
    xsim_manners(XSIM_SETUP, POLITE);
    for (const char *n = scene->names; *n; n++) { /* a fresh writer goes on, and gives way to no wish of the dead */
        const char child[2] = {*n, 0};
        shmtf_transform t = edge_at("f", child, 1000, 99);
        stage_status st = xsim_set(XSIM_SETUP, &t, 1, 1);
        if (st != STAGE_OK) xsim_fail("a fresh writer", st, STAGE_OK);
        expect(atomic_load(&xs.s.frames[id_of(&xs, child)].want), 0, "a wish that is left");
    }
    xsim_check_rings_apart();
    if (scene->after) scene->after(now);
}

static bool is_point(const void *word) {
    const unsigned char *p = word, *base = xs.memory;
    size_t at_byte = (size_t)(p - base);
    const shmtf_geometry *g = &xs.s.geo;
    if (at_byte >= g->off_frames && at_byte < g->off_names) {
        size_t in = (at_byte - g->off_frames) % sizeof(shmtf_frame_words_t);
        return in < offsetof(shmtf_frame_words_t, newest) || in >= offsetof(shmtf_frame_words_t, head) || in % 64 == 0; /* pose: x */
    }
    if (at_byte >= g->off_inline && at_byte < g->off_chunks) {
        size_t in = (at_byte - g->off_inline) % sizeof(shmtf_inline_ring);
        if (in < offsetof(shmtf_inline_ring, body)) return true;
        in = (in - offsetof(shmtf_inline_ring, body)) % sizeof(shmtf_record_body);
        return in == 0 || in == offsetof(shmtf_record_body, parent);
    }
    if (at_byte >= g->off_names && at_byte < g->off_inline) return (at_byte - g->off_names) % sizeof(shmtf_name_t) == 0;
    if (at_byte < g->off_arena || scene->odd_rings) return true;
    size_t in = (at_byte - g->off_arena) % 1024, bodies = sizeof(shmtf_record_head) << 3, index = bodies + (sizeof(shmtf_record_body) << 3);
    if (in < bodies) return in % sizeof(shmtf_record_head) != offsetof(shmtf_record_head, arrival);
    if (in >= index) return in % 16 == 0; /* every fourth entry */
    in = (in - bodies) % sizeof(shmtf_record_body);
    return in == 0 || in == offsetof(shmtf_record_body, parent);
}

static void prepare(const scenario *sc) {
    scene = sc;
    world_make(&xs, sc->max_frames, LIVE, -1, 0, XSIM_SLOTS);
    if (xs.s.geo.default_log2 != 3) abort();
    memset(ghost, 0, sizeof ghost);
    ghost_top = 0;
    for (int i = 0; i < XSIM_SLOTS; i++) {
        writer_make(&writers[i], &xs, (unsigned)i);
        writer_make(&writers_before[i], &xs, (unsigned)i);
        owner_of[i] = i < XSIM_SETUP ? i : -1;
    }
    sc->setup();
    setup_top = ghost_top;
    setup_ghost = ghost[ghost_top];
    for (int i = 0; i < XSIM_SLOTS; i++) {
        copy_workspace(&writers_before[i], &writers[XSIM_SETUP]); /* as if each had written before */
        writers_before[i].x.live_from = writers[i].x.live_from;
    }
    image_from = SHMTF_PAGE;
    skip_from = xs.s.geo.off_authorities;
    skip_to = xs.s.geo.off_buckets;
    image_size = xs.s.geo.size_bytes;
    image = malloc(image_size);
    if (!image) abort();
    memcpy(image, xs.memory, image_size);
}

static long explore(int k, sched_bounds b) {
    const scenario *sc = &scenarios[k];
    prepare(sc);
    sched_program p = {.n_threads = sc->n_threads, .reset = reset, .stepped = stepped, .finish = finish, .is_point = is_point};
    for (int i = 0; i < sc->n_threads; i++) {
        p.body[i] = sc->body[i];
        p.may_crash[i] = !(sc->readers >> i & 1);
    }
    n_reads = n_old = n_conflicts = n_commits = 0;
    sched_result r = sched_explore(&p, &b);
    printf("%2d %-28s preemptions %d crashes %d stride %u: %ld executions%s, %ld crashes, %ld reads, %ld too old, %ld conflicts, %ld commits\n",
           k, sc->name, b.preemptions, b.crashes, b.stride, r.executions, r.complete ? "" : " (stopped)", r.crashes, n_reads, n_old,
           n_conflicts, n_commits);
    fflush(stdout);
    for (int i = 0; i < XSIM_SLOTS; i++) writer_free(&writers[i]), writer_free(&writers_before[i]);
    world_free(&xs);
    free(image);
    return r.executions;
}

int main(int argc, char **argv) {
    const char *which = argc > 1 ? argv[1] : "all";
    sched_bounds b = {argc > 2 ? atoi(argv[2]) : 2, argc > 3 ? atoi(argv[3]) : 1, argc > 4 ? (unsigned)atoi(argv[4]) : 7,
                      argc > 5 ? strtoull(argv[5], NULL, 0) : 1, argc > 6 ? atof(argv[6]) : 0};
    long total = 0;
    for (int k = 0; k < n_scenarios; k++)
        if (!strcmp(which, "all") || !strcmp(which, scenarios[k].name) || (which[0] >= '0' && which[0] <= '9' && atoi(which) == k))
            total += explore(k, b);
    printf("%ld executions, no violation\n", total);
    return total == 0;
}
