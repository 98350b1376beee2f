/* SPDX-License-Identifier: Apache-2.0
 * Lookups: every pair of random forests, any depth hints, long chains, wide stars, removals, clears, times. */
#include "core/lookup.h"

#include <math.h>

#include "support/check.h"
#include "support/world.h"

static world w;
static writer wr;
static uint64_t seed = 2463534242ull;

static void begin(uint64_t frames, uint64_t history, int64_t cache) {
    world_make(&w, frames, history, cache, 0, 4);
    writer_make(&wr, &w, 0);
}
static void end(void) {
    writer_free(&wr);
    world_free(&w);
}

static shmtf_transform turned(const char *parent, const char *child, int64_t stamp, double x, double yaw) {
    shmtf_transform t = edge_at(parent, child, stamp, x);
    t.pose.qz = sin(yaw / 2);
    t.pose.qw = cos(yaw / 2);
    return t;
}

static bool close_to(const shmtf_pose *a, const shmtf_pose *b) {
    double dot = a->qx * b->qx + a->qy * b->qy + a->qz * b->qz + a->qw * b->qw;
    return fabs(a->x - b->x) < 1e-9 && fabs(a->y - b->y) < 1e-9 && fabs(a->z - b->z) < 1e-9 && fabs(fabs(dot) - 1) < 1e-9;
}

enum { N = 24 };
static int parent_of[N];
static shmtf_pose pose_of[N];

static shmtf_pose to_root(int i, int *root) {
    shmtf_pose p = pose_of[i];
    if (parent_of[i] < 0) {
        *root = i;
        return (shmtf_pose){0, 0, 0, 0, 0, 0, 1};
    }
    shmtf_pose above = to_root(parent_of[i], root);
    shmtf_pose r;
    double ax = above.qx, ay = above.qy, az = above.qz, aw = above.qw; /* above * p, written out */
    double tx = 2 * (ay * p.z - az * p.y), ty = 2 * (az * p.x - ax * p.z), tz = 2 * (ax * p.y - ay * p.x);
    r = (shmtf_pose){above.x + p.x + aw * tx + (ay * tz - az * ty), above.y + p.y + aw * ty + (az * tx - ax * tz),
                     above.z + p.z + aw * tz + (ax * ty - ay * tx), aw * p.qx + ax * p.qw + ay * p.qz - az * p.qy,
                     aw * p.qy - ax * p.qz + ay * p.qw + az * p.qx, aw * p.qz + ax * p.qy - ay * p.qx + az * p.qw,
                     aw * p.qw - ax * p.qx - ay * p.qy - az * p.qz};
    return r;
}

static void name_of(int i, char out[16]) { snprintf(out, 16, "f%d", i); }

/* All pairs, with the hints that are there or with random ones. */
static void check_pairs(bool at_time, bool spoil) {
    char a[16], b[16];
    const int64_t t = 5;
    for (int i = 0; i < N; i++)
        for (int k = 0; k < N; k++) {
            int ri, rk;
            shmtf_pose T_r_i = to_root(i, &ri), T_r_k = to_root(k, &rk), got;
            if (spoil)
                for (int h = 0; h <= N; h++) atomic_store(&w.depth[h], (uint32_t)(check_random(&seed) % 12));
            lookup l;
            shmtf_edge edges[N];
            name_of(i, a);
            name_of(k, b);
            l = (lookup){0};
            lookup_status st = look_up(&w, now_of(&w), a, b, at_time ? &t : NULL, &l);
            EQUAL(st, ri == rk ? LOOKUP_OK : LOOKUP_DISCONNECTED);
            if (st != LOOKUP_OK) continue;
            l.edges = edges;
            l.max_edges = N;
            EQUAL(lookup_run(&l), LOOKUP_OK);
            shmtf_pose T_i_r = T_r_i; /* got = inv(T_r_i) * T_r_k, so T_r_i * got = T_r_k */
            got = l.pose;
            double ax = T_i_r.qx, ay = T_i_r.qy, az = T_i_r.qz, aw = T_i_r.qw;
            double tx = 2 * (ay * got.z - az * got.y), ty = 2 * (az * got.x - ax * got.z), tz = 2 * (ax * got.y - ay * got.x);
            shmtf_pose back = {T_i_r.x + got.x + aw * tx + (ay * tz - az * ty), T_i_r.y + got.y + aw * ty + (az * tx - ax * tz),
                               T_i_r.z + got.z + aw * tz + (ax * ty - ay * tx), aw * got.qx + ax * got.qw + ay * got.qz - az * got.qy,
                               aw * got.qy - ax * got.qz + ay * got.qw + az * got.qx, aw * got.qz + ax * got.qy - ay * got.qx + az * got.qw,
                               aw * got.qw - ax * got.qx - ay * got.qy - az * got.qz};
            CHECK(close_to(&back, &T_r_k));
            for (uint32_t e = 0; e + 1 < l.n_edges; e++) /* a path: neighbours share a frame */
                CHECK(edges[e].parent.id == edges[e + 1].child.id || edges[e].parent.id == edges[e + 1].parent.id ||
                      edges[e].child.id == edges[e + 1].parent.id);
        }
}

static void check_forests(void) {
    char a[16], b[16];
    for (int round = 0; round < 60; round++) {
        begin(N + 1, 8, -1);
        for (int i = 0; i < N; i++) parent_of[i] = -1;
        for (int i = 1; i < N; i++) {
            if (round % 3 && check_random(&seed) % 8 == 0) continue; /* several trees */
            parent_of[i] = round % 4 == 1 ? i - 1 : (int)(check_random(&seed) % (uint64_t)i);
        }
        for (int i = N - 1; i >= 0; i--) {
            name_of(i, a);
            if (parent_of[i] < 0) {
                EQUAL(declare_named(&wr, a, 3), STAGE_OK);
                continue;
            }
            name_of(parent_of[i], b);
            shmtf_transform t = turned(b, a, 5, check_uniform(&seed), check_uniform(&seed) * 6);
            t.pose.y = check_uniform(&seed);
            if (i % 5 == 0) t.flags = SHMTF_STATIC;
            EQUAL(write_one(&wr, t), STAGE_OK);
            pose_of[i] = t.pose;
        }
        check_pairs(false, false);
        check_pairs(true, false);
        check_pairs(false, true);
        check_pairs(true, true);
        end();
    }
}

static void check_long(void) {
    enum { DEEP = 1500, WIDE = 5000 };
    char a[16], b[16];
    lookup l;
    begin(DEEP + WIDE + 2, 4, -1);
    for (int i = 1; i <= DEEP; i++) {
        snprintf(a, sizeof a, "d%d", i);
        snprintf(b, sizeof b, "d%d", i - 1);
        NEED(write_one(&wr, edge_at(b, a, i, 1)) == STAGE_OK);
    }
    for (int i = 0; i < WIDE; i++) {
        snprintf(a, sizeof a, "w%d", i);
        NEED(write_one(&wr, edge_at("d0", a, 1, i)) == STAGE_OK);
    }
    for (int round = 0; round < 2; round++) {
        EQUAL(look_up(&w, now_of(&w), "d0", "d1500", NULL, &l), LOOKUP_OK);
        CHECK(fabs(l.pose.x - DEEP) < 1e-9 && l.n_edges == DEEP && l.oldest == 1 && l.newest == DEEP && l.n_dynamic == DEEP);
        EQUAL(look_up(&w, now_of(&w), "d1500", "d0", NULL, &l), LOOKUP_OK);
        CHECK(fabs(l.pose.x + DEEP) < 1e-9 && l.n_edges == DEEP);
        EQUAL(look_up(&w, now_of(&w), "w4999", "d1500", NULL, &l), LOOKUP_OK);
        CHECK(fabs(l.pose.x - (DEEP - 4999.0)) < 1e-9 && l.n_edges == DEEP + 1);
        EQUAL(look_up(&w, now_of(&w), "w17", "w4000", NULL, &l), LOOKUP_OK);
        CHECK(fabs(l.pose.x - 3983) < 1e-9 && l.n_edges == 2);
        for (int i = 0; i <= DEEP + WIDE; i++) atomic_store(&w.depth[i], 1 + (uint32_t)(check_random(&seed) % 3000));
    }
    end();
}

static void check_removal(void) {
    lookup l;
    begin(8, 8, -1);
    NEED(write_one(&wr, edge_at("a", "b", 1, 1)) == STAGE_OK);
    NEED(write_one(&wr, edge_at("b", "c", 1, 2)) == STAGE_OK);
    NEED(write_one(&wr, edge_at("c", "d", 1, 4)) == STAGE_OK);
    NEED(write_one(&wr, edge_at("c", "e", 1, 8)) == STAGE_OK);
    uint64_t before = now_of(&w);
    EQUAL(look_up(&w, before, "a", "d", NULL, &l), LOOKUP_OK);
    EQUAL(remove_named(&wr, "b"), STAGE_OK);
    EQUAL(remove_named(&wr, "b"), STAGE_GONE);
    EQUAL(look_up(&w, now_of(&w), "a", "b", NULL, &l), LOOKUP_NO_SOURCE);
    EQUAL(look_up(&w, now_of(&w), "b", "a", NULL, &l), LOOKUP_NO_TARGET);
    EQUAL(look_up(&w, now_of(&w), "a", "d", NULL, &l), LOOKUP_DISCONNECTED);
    EQUAL(look_up(&w, now_of(&w), "e", "d", NULL, &l), LOOKUP_OK);
    CHECK(l.pose.x == -4);
    EQUAL(look_up(&w, now_of(&w), "c", "d", NULL, &l), LOOKUP_OK);
    lookup_status st = look_up(&w, before, "a", "d", NULL, &l);
    CHECK(st == LOOKUP_OLD || (st == LOOKUP_OK && l.pose.x == 7));
    EQUAL(write_one(&wr, edge_at("a", "b", 2, 100)), STAGE_OK); /* another life: c stays a root */
    EQUAL(look_up(&w, now_of(&w), "a", "d", NULL, &l), LOOKUP_DISCONNECTED);
    EQUAL(write_one(&wr, edge_at("b", "c", 2, 2)), STAGE_OK);
    EQUAL(look_up(&w, now_of(&w), "a", "d", NULL, &l), LOOKUP_OK);
    CHECK(l.pose.x == 106);
    end();
}

/* A handle of an ended life finds nothing in the records of the next one. */
static void check_ended_life(void) {
    shmtf_frame old, other;
    begin(2, 8, -1);
    for (int t = 1; t <= 4; t++) NEED(write_one(&wr, edge_at("a", "b", t, t)) == STAGE_OK);
    NEED(find_frame(&w, now_of(&w), "b", &old) == RING_OK);
    NEED(remove_named(&wr, "b") == STAGE_OK);
    for (int t = 1; t <= 4; t++) NEED(write_one(&wr, edge_at("a", "c", t, t)) == STAGE_OK);
    NEED(find_frame(&w, now_of(&w), "c", &other) == RING_OK);
    EQUAL(other.id, old.id);
    const tree_clears clears = {0, 0};
    for (int at_time = 0; at_time < 2; at_time++) {
        edge_run run = {.s = &w.s, .snapshot = now_of(&w), .clears = &clears, .above = w.above, .at_time = at_time, .time = 2};
        run.chain = (edge_chain){.cur = old};
        EQUAL(run_edges(&run, 1), 0);
        run.chain = (edge_chain){.cur = other};
        EQUAL(run_edges(&run, 1), 1);
        CHECK(run.chain.pose.x == (at_time ? 2 : 4));
    }
    end();
}

/* Hints of another time cost a second walk, never the answer. */
static void check_stale_hints(void) {
    lookup l;
    begin(8, 8, -1);
    NEED(write_one(&wr, edge_at("r", "x", 1, 1)) == STAGE_OK);
    NEED(write_one(&wr, edge_at("r", "y", 1, 1)) == STAGE_OK);
    NEED(write_one(&wr, edge_at("x", "a", 1, 4)) == STAGE_OK);
    NEED(write_one(&wr, edge_at("x", "b", 1, 6)) == STAGE_OK);
    uint64_t before = now_of(&w);
    const int64_t t = 1;
    EQUAL(look_up(&w, before, "b", "a", NULL, &l), LOOKUP_OK);
    NEED(write_one(&wr, edge_at("y", "b", 2, 7)) == STAGE_OK);
    EQUAL(look_up(&w, now_of(&w), "b", "a", NULL, &l), LOOKUP_OK);
    for (int i = 0; i < 3; i++) {
        EQUAL(look_up(&w, before, "b", "a", NULL, &l), LOOKUP_OK);
        CHECK(l.pose.x == -2);
        EQUAL(look_up(&w, before, "b", "a", &t, &l), LOOKUP_OK);
        EQUAL(look_up(&w, now_of(&w), "b", "a", NULL, &l), LOOKUP_OK);
        CHECK(l.pose.x == -3);
    }
    end();
}

/* A frame that hangs far higher than its hints say: every edge of the answer is told, if there is room for it. */
static void check_edges_after_move(void) {
    char above[16] = "map", below[16];
    begin(64, 8, -1);
    for (int i = 0; i < 40; i++) {
        snprintf(below, sizeof below, "f%d", i);
        NEED(write_one(&wr, edge_at(above, below, 1, 1)) == STAGE_OK);
        memcpy(above, below, sizeof above);
    }
    lookup l;
    EQUAL(look_up(&w, now_of(&w), "map", "f39", NULL, &l), LOOKUP_OK);
    EQUAL(l.n_edges, 40);
    NEED(write_one(&wr, edge_at("map", "f39", 2, 7)) == STAGE_OK);
    for (uint32_t room = 0; room <= 4; room++) {
        shmtf_edge edges[4];
        memset(edges, 0xee, sizeof edges);
        l = (lookup){.s = &w.s, .depth = w.depth, .above = w.above, .snapshot = now_of(&w), .edges = room ? edges : NULL, .max_edges = room};
        NEED(find_frame(&w, now_of(&w), "map", &l.target) == RING_OK && find_frame(&w, now_of(&w), "f39", &l.source) == RING_OK);
        hint_set(&w.depth[l.source.id], 41);
        EQUAL(lookup_run(&l), LOOKUP_OK);
        EQUAL(l.n_edges, 1);
        if (room) CHECK(edges[0].child.id == l.source.id && edges[0].parent.id == l.target.id && edges[0].stamp_ns == 2);
    }
    end();
}

static void check_clear(void) {
    lookup l;
    for (int keep = 0; keep < 2; keep++) {
        begin(8, 8, -1);
        NEED(write_one(&wr, static_edge("a", "b", 1)) == STAGE_OK);
        NEED(write_one(&wr, edge_at("b", "c", 1000, 2)) == STAGE_OK);
        uint64_t before = now_of(&w);
        EQUAL(clear_all(&wr, keep), STAGE_OK);
        uint64_t cleared = now_of(&w);
        EQUAL(look_up(&w, cleared, "a", "b", NULL, &l), keep ? LOOKUP_OK : LOOKUP_DISCONNECTED);
        EQUAL(look_up(&w, cleared, "b", "c", NULL, &l), LOOKUP_DISCONNECTED);
        EQUAL(look_up(&w, cleared, "c", "c", NULL, &l), LOOKUP_OK);
        EQUAL(look_up(&w, before, "a", "c", NULL, &l), LOOKUP_OK);
        EQUAL(write_one(&wr, edge_at("b", "c", 5, 4)), STAGE_OK); /* long before what was cleared */
        EQUAL(look_up(&w, now_of(&w), "b", "c", NULL, &l), LOOKUP_OK);
        CHECK(l.pose.x == 4 && l.oldest == 5);
        const int64_t t = 1000;
        EQUAL(look_up(&w, now_of(&w), "b", "c", &t, &l), LOOKUP_SINGLE);
        EQUAL(look_up(&w, before, "b", "c", &t, &l), LOOKUP_OK);
        EQUAL(clear_all(&wr, true), STAGE_OK);
        EQUAL(look_up(&w, now_of(&w), "a", "b", NULL, &l), keep ? LOOKUP_OK : LOOKUP_DISCONNECTED);
        EQUAL(write_one(&wr, static_edge("a", "b", 1)), STAGE_OK); /* the same pose again, though cleared: not a repeat */
        EQUAL(look_up(&w, now_of(&w), "a", "b", NULL, &l), LOOKUP_OK);
        end();
    }
}

static void check_times(void) {
    lookup l;
    begin(8, 8, 100);
    int64_t t = 10;
    NEED(write_one(&wr, edge_at("a", "b", 10, 0)) == STAGE_OK);
    EQUAL(look_up(&w, now_of(&w), "a", "b", &t, &l), LOOKUP_OK);
    t = 11;
    EQUAL(look_up(&w, now_of(&w), "a", "b", &t, &l), LOOKUP_SINGLE);
    NEED(write_one(&wr, edge_at("a", "b", 20, 10)) == STAGE_OK);
    for (t = 8; t <= 22; t++) {
        lookup_status st = look_up(&w, now_of(&w), "a", "b", &t, &l), want = t < 10 ? LOOKUP_BACKWARD : t > 20 ? LOOKUP_FORWARD : LOOKUP_OK;
        EQUAL(st, want);
        if (st == LOOKUP_OK) CHECK(fabs(l.pose.x - (double)(t - 10)) < 1e-12);
        else CHECK(l.edge_oldest == 10 && l.edge_newest == 20 && l.failed.id == id_of(&w, "b"));
    }
    NEED(write_one(&wr, edge_at("a", "b", 115, 105)) == STAGE_OK);
    t = 14;
    EQUAL(look_up(&w, now_of(&w), "a", "b", &t, &l), LOOKUP_BACKWARD); /* 10 has expired, 20 has not */
    CHECK(l.edge_oldest == 20);
    t = 20;
    EQUAL(look_up(&w, now_of(&w), "a", "b", &t, &l), LOOKUP_OK);
    EQUAL(write_one(&wr, edge_at("a", "b", 15, 5)), STAGE_OK);
    EQUAL(write_one(&wr, edge_at("a", "b", 14, 5)), STAGE_OLD_DATA);
    end();
    static const int64_t extremes[] = {INT64_MIN, INT64_MIN + 1, -1, 0, 1, INT64_MAX - 1, INT64_MAX};
    for (int64_t cache = -1; cache < 2; cache++)
        for (int i = 0; i < 7; i++)
            for (int k = 0; k < 7; k++) {
                begin(8, 8, cache < 0 ? -1 : cache ? INT64_MAX : 0);
                NEED(write_one(&wr, edge_at("a", "b", extremes[i], 0)) == STAGE_OK);
                stage_status st = write_one(&wr, edge_at("a", "b", extremes[k], 1));
                bool far = cache >= 0 && extremes[k] < extremes[i] && (cache == 0 || (uint64_t)extremes[i] - (uint64_t)extremes[k] > INT64_MAX);
                EQUAL(st, far ? STAGE_OLD_DATA : STAGE_OK);
                for (int n = 0; n < 7; n++) {
                    lookup_status got = look_up(&w, now_of(&w), "a", "b", &extremes[n], &l);
                    CHECK(got == LOOKUP_OK || got == LOOKUP_SINGLE || got == LOOKUP_FORWARD || got == LOOKUP_BACKWARD);
                    if (got == LOOKUP_OK) CHECK(l.pose.x >= 0 && l.pose.x <= 1);
                }
                end();
            }
}

/* Why a time cannot be had is an answer about S, too: a late stamp that came since makes one record two. */
static void check_failures_at_a_commit(void) {
    lookup l;
    begin(8, 8, -1);
    NEED(write_one(&wr, edge_at("p", "f", 10, 1)) == STAGE_OK);
    uint64_t one = now_of(&w);
    NEED(write_one(&wr, edge_at("p", "f", 5, 2)) == STAGE_OK);
    for (int64_t t = 3; t <= 12; t += 9) {
        EQUAL(look_up(&w, one, "p", "f", &t, &l), LOOKUP_SINGLE);
        EQUAL(look_up(&w, now_of(&w), "p", "f", &t, &l), t < 5 ? LOOKUP_BACKWARD : LOOKUP_FORWARD);
    }
    /* the late one is gone again, and with it the knowledge whether S had it */
    for (int64_t t = 11; t < 11 + (int64_t)shmtf_ring_live(w.s.geo.default_log2) - 1; t++) NEED(write_one(&wr, edge_at("p", "f", t, 3)) == STAGE_OK);
    int64_t t = 40;
    EQUAL(look_up(&w, one, "p", "f", &t, &l), LOOKUP_OLD);
    EQUAL(look_up(&w, now_of(&w), "p", "f", &t, &l), LOOKUP_FORWARD);
    end();
}

/* Late stamps make a loop at a time that the newest records do not have. */
static void check_loop(void) {
    lookup l;
    begin(8, 8, -1);
    NEED(write_one(&wr, edge_at("r", "a", 10, 1)) == STAGE_OK);
    NEED(write_one(&wr, edge_at("r", "b", 10, 1)) == STAGE_OK);
    NEED(write_one(&wr, edge_at("b", "a", 5, 1)) == STAGE_OK);
    NEED(write_one(&wr, edge_at("a", "b", 5, 1)) == STAGE_OK);
    int64_t t = 5;
    lookup_status st = look_up(&w, now_of(&w), "r", "a", &t, &l);
    EQUAL(st, LOOKUP_LOOP);
    st = look_up(&w, now_of(&w), "a", "b", &t, &l); /* one edge apart, but above both there is no end */
    CHECK(st == LOOKUP_OK || st == LOOKUP_LOOP);
    EQUAL(look_up(&w, now_of(&w), "r", "a", NULL, &l), LOOKUP_OK);
    end();
}

int main(void) {
    check_forests();
    check_long();
    check_removal();
    check_ended_life();
    check_stale_hints();
    check_edges_after_move();
    check_clear();
    check_times();
    check_failures_at_a_commit();
    check_loop();
    return check_result("lookup");
}
