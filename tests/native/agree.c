/* SPDX-License-Identifier: Apache-2.0
 * The fast part of the walk and the general one give the same answers: random histories of births, late stamps, changes
 * of parent, static records, removals and clears; lookups at old commits and old times, with any hints, beside the same
 * lookups in a copy of the segment whose frames have no copy of their newest record, so that nothing in it is fast. */
#include "core/lookup.h"

#include <math.h>

#include "support/check.h"
#include "support/world.h"

enum { NAMES = 14, SNAPSHOTS = 24, HISTORIES = 24, STEPS = 600, ROOM = 8 };
static world w, slow;
static writer wr;
static uint64_t seed, snapshots[SNAPSHOTS];
static int64_t now_ns;
static char names[NAMES][8];
static unsigned long compared, found;

static uint64_t below(uint64_t n) { return check_random(&seed) % n; }

static shmtf_transform random_edge(void) {
    uint64_t child = below(NAMES), parent = below(8) ? child / 2 : below(NAMES);
    int64_t stamp = below(5) ? now_ns + (int64_t)below(3) : now_ns - (int64_t)below(40);
    shmtf_transform t = edge_at(names[parent], names[child], stamp, (double)below(1000));
    double yaw = 0.2 * (double)below(7);
    t.pose.qz = sin(yaw / 2);
    t.pose.qw = cos(yaw / 2);
    if (!below(12)) t.flags = SHMTF_STATIC;
    return t;
}

static void change(void) {
    uint64_t what = below(100);
    if (what < 3) {
        remove_named(&wr, names[below(NAMES)]);
    } else if (what < 4) {
        clear_all(&wr, below(2) != 0);
    } else {
        shmtf_transform t[6];
        size_t n = 1 + below(below(4) ? 2 : 6);
        now_ns += (int64_t)below(3);
        for (size_t i = 0; i < n; i++) t[i] = random_edge();
        write_all(&wr, t, n);
    }
    if (!below(4)) snapshots[below(SNAPSHOTS)] = now_of(&w);
}

/* The same bytes; no frame says what its newest record is, and no hint is right. */
static void copy_slow(void) {
    memcpy(slow.memory, w.memory, w.s.geo.size_bytes);
    for (uint64_t id = 0; id <= w.s.geo.max_frames; id++) {
        for (int sel = 0; sel < 2; sel++) atomic_store(&slow.s.frames[id].newest_tag[sel], 0);
        hint_set(&slow.depth[id], 0);
        hint_set(&slow.above[id], 0);
    }
}

static lookup_status look(const world *in, uint64_t snapshot, const char *target, const char *source, const int64_t *time,
                          shmtf_edge *edges, uint32_t room, lookup *l) {
    *l = (lookup){.s = &in->s, .depth = in->depth, .above = in->above, .snapshot = snapshot, .at_time = time != NULL,
                  .time = time ? *time : 0, .edges = room ? edges : NULL, .max_edges = room};
    ring_status a = find_frame(in, snapshot, target, &l->target), b = find_frame(in, snapshot, source, &l->source);
    if (a == RING_NONE) return LOOKUP_NO_TARGET;
    if (b == RING_NONE) return LOOKUP_NO_SOURCE;
    if (a != RING_OK || b != RING_OK) return LOOKUP_OLD;
    return lookup_run(l);
}

static bool close_to(const shmtf_pose *a, const shmtf_pose *b) {
    const double *p = &a->x, *q = &b->x;
    double worst = 0;
    for (int i = 0; i < 7; i++) worst = fmax(worst, fabs(p[i] - q[i]));
    return worst < 1e-9;
}

/* Late stamps can make a loop in the past above either frame; then any way round it is as good as any other. */
static bool loops(const lookup *l) {
    const shmtf_frame ends[2] = {l->source, l->target};
    for (int i = 0; i < 2 && l->at_time; i++) {
        lookup up = *l;
        ring_record r;
        tree_step step = STEP_EDGE;
        shmtf_frame f = ends[i];
        for (int n = 0; n <= NAMES && step == STEP_EDGE; n++) {
            if (lookup_step_at(&up, f, &r, &step) != LOOKUP_OK) step = STEP_ROOT;
            f = parent_frame(r.parent);
        }
        if (step == STEP_EDGE) return true;
    }
    return false;
}

static void compare(void) {
    shmtf_edge e[2][ROOM];
    lookup l[2];
    uint64_t snapshot = below(3) ? now_of(&w) : snapshots[below(SNAPSHOTS)];
    const char *target = names[below(NAMES)], *source = names[below(NAMES)];
    int64_t time = now_ns - (int64_t)below(below(2) ? 8 : 60);
    const int64_t *at = below(3) ? &time : NULL;
    uint32_t room = (uint32_t)below(ROOM + 1);
    memset(e, 0xee, sizeof e);
    lookup_status st = look(&w, snapshot, target, source, at, e[0], room, &l[0]);
    lookup_status want = look(&slow, snapshot, target, source, at, e[1], room, &l[1]);
    if (st == LOOKUP_OLD || want == LOOKUP_OLD) return; /* which records are still there is a matter of luck */
    if (want != LOOKUP_NO_SOURCE && want != LOOKUP_NO_TARGET && loops(&l[1])) return;
    compared++;
    EQUAL(st, want);
    if (st != LOOKUP_OK || want != LOOKUP_OK) return;
    found++;
    CHECK(close_to(&l[0].pose, &l[1].pose));
    EQUAL(l[0].n_edges, l[1].n_edges);
    EQUAL(l[0].n_dynamic, l[1].n_dynamic);
    if (l[1].n_dynamic) CHECK(l[0].oldest == l[1].oldest && l[0].newest == l[1].newest);
    for (uint32_t i = 0; i < l[1].n_edges && l[1].n_edges <= room; i++) {
        EQUAL(parent_make(e[0][i].parent), parent_make(e[1][i].parent));
        EQUAL(parent_make(e[0][i].child), parent_make(e[1][i].child));
        CHECK(e[0][i].is_static == e[1][i].is_static && (e[1][i].is_static || e[0][i].stamp_ns == e[1][i].stamp_ns));
    }
}

static void history(uint64_t number) {
    static const uint64_t records[] = {6, 14, 60};
    static const int64_t cache_ns[] = {-1, 30, 200};
    seed = number * 0x9e3779b97f4a7c15ull + 1;
    now_ns = 100;
    uint64_t r = records[below(3)];
    int64_t c = cache_ns[below(3)];
    world_make(&w, NAMES + 1, r, c, 0, 4);
    world_make(&slow, NAMES + 1, r, c, 0, 4);
    writer_make(&wr, &w, 0);
    memset(snapshots, 0, sizeof snapshots);
    for (int step = 0; step < STEPS && check_failures < 20; step++) {
        change();
        copy_slow();
        for (int i = 0; i < 6; i++) compare();
    }
    writer_free(&wr);
    world_free(&w);
    world_free(&slow);
}

int main(void) {
    for (int i = 0; i < NAMES; i++) snprintf(names[i], sizeof names[i], "n%d", i);
    for (uint64_t n = 1; n <= HISTORIES; n++) history(n);
    CHECK(compared > 20000 && found > 5000);
    return check_result("agree");
}
