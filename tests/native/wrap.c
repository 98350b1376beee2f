/* SPDX-License-Identifier: Apache-2.0
 * Every counter of a segment is started near the number where it wraps, or where its width ends, and mixed work is run
 * across: answers stay those of a model, beside readers too; what cannot go on is refused.  native/README.md has the table.
 * Tier: test. */
#define _GNU_SOURCE
#include <limits.h>
#include <pthread.h>
#include <stdio.h>
#include <string.h>

#include "segment/wait.h"
#include "support/check.h"
#include "support/world.h"

enum { FRAMES = 6, KEPT = 5, HISTORY = 14 };
static const char *const names[FRAMES] = {"f0", "f1", "f2", "f3", "f4", "f5"};

typedef struct {
    bool exists, fixed;
    int n;
    int64_t stamp[KEPT];
    double x[KEPT];
} expected;

static void note(expected *f, int64_t stamp, double x) {
    int at = f->n;
    if (f->n == KEPT) {
        memmove(f->stamp, f->stamp + 1, sizeof f->stamp - sizeof *f->stamp);
        memmove(f->x, f->x + 1, sizeof f->x - sizeof *f->x);
        at = --f->n;
    }
    for (; at > 0 && f->stamp[at - 1] > stamp; at--) f->stamp[at] = f->stamp[at - 1], f->x[at] = f->x[at - 1];
    f->stamp[at] = stamp;
    f->x[at] = x;
    f->n++;
}

static void check_frame(const world *w, uint64_t snapshot, const char *name, const expected *f, bool is_past) {
    lookup l;
    lookup_status st = look_up(w, snapshot, "root", name, NULL, &l);
    if (is_past && st == LOOKUP_OLD) return;
    if (!f->exists || !f->n) {
        CHECK(st != LOOKUP_OK);
        return;
    }
    CHECK(st == LOOKUP_OK && l.pose.x == f->x[f->n - 1]);
    for (int i = 0; i < f->n && !f->fixed; i++) {
        st = look_up(w, snapshot, "root", name, &f->stamp[i], &l);
        if (!(is_past && st == LOOKUP_OLD)) CHECK(st == LOOKUP_OK && l.pose.x == f->x[i]);
    }
}

/* One random operation, on the store and on the model. */
static stage_status change(writer *wr, expected *all, int64_t now, uint64_t *random) {
    int k = (int)(check_random(random) % FRAMES);
    expected *f = &all[k];
    double x = (double)(check_random(random) % 100000);
    stage_status st;
    switch (check_random(random) % 16) {
    case 0:
        st = remove_named(wr, names[k]);
        if (st == STAGE_OK) *f = (expected){.n = 0};
        return f->exists || st != STAGE_GONE ? st : STAGE_OK;
    case 1:
        st = write_one(wr, static_edge("root", names[k], x));
        if (st == STAGE_OK) *f = (expected){.exists = true, .fixed = true, .n = 1, .x = {x}};
        return st;
    case 2:
        st = clear_all(wr, true);
        for (int i = 0; i < FRAMES && st == STAGE_OK; i++)
            if (!all[i].fixed) all[i].n = 0;
        return st;
    case 3:
    case 4:
    case 5: /* late, not too far, and not a stamp that is there */
        if (f->fixed || f->n < 2 || f->stamp[f->n - 1] - f->stamp[f->n - 2] < 2) break;
        now = f->stamp[f->n - 1] - 1;
        break;
    default: break;
    }
    if (f->fixed) *f = (expected){.n = 0};
    st = write_one(wr, edge_at("root", names[k], now, x));
    f->exists = true;
    if (st == STAGE_OK) note(f, now, x);
    return st;
}

static void work(world *w, writer *wr, expected *all, int64_t *now, int n, const char *what) {
    uint64_t random = 88172645463325252ull;
    for (int i = 0; i < n; i++) {
        expected before[FRAMES];
        uint64_t past = now_of(w);
        memcpy(before, all, sizeof before);
        stage_status st = change(wr, all, *now += 10, &random);
        if (!CHECK(st == STAGE_OK)) fprintf(stderr, "  %s: operation %d: %d\n", what, i, (int)st);
        long failures = check_failures;
        for (int k = 0; k < FRAMES; k++) check_frame(w, now_of(w), names[k], &all[k], false);
        for (int k = 0; k < FRAMES; k++) check_frame(w, past, names[k], &before[k], true);
        if (check_failures != failures) {
            fprintf(stderr, "  %s: after operation %d\n", what, i);
            return;
        }
    }
}

/* ---- readers beside a writer across the wrap ---- */

typedef struct {
    const world *w;
    local_flag over;
    local_count reads;
    int torn;
} audience;

static void *watch_pair(void *argument) {
    audience *a = argument;
    world own = *a->w;
    own.depth = calloc(own.s.geo.max_frames + 1, sizeof *own.depth);
    own.above = calloc(own.s.geo.max_frames + 1, sizeof *own.above);
    while (!flag_get(&a->over)) {
        lookup l, m;
        uint64_t snapshot = now_of(a->w);
        lookup_status st = look_up(&own, snapshot, "root", "f0", NULL, &l), su = look_up(&own, snapshot, "root", "f1", NULL, &m);
        if (st == LOOKUP_OK && su == LOOKUP_OK && l.pose.x != m.pose.x) a->torn++;
        int64_t t = st == LOOKUP_OK ? l.newest : 0;
        if (st == LOOKUP_OK && look_up(&own, snapshot, "root", "f1", &t, &m) == LOOKUP_OK && m.pose.x != l.pose.x) a->torn++;
        count_add(&a->reads, 1);
    }
    free(own.depth);
    free(own.above);
    return NULL;
}

static void beside_readers(world *w, writer *wr, int64_t now, const char *what) {
    pthread_t reader;
    audience a = {.w = w};
    now += 1000;
    NEED(!pthread_create(&reader, NULL, watch_pair, &a));
    for (int i = 0; i < 3000 || count_get(&a.reads) < 100; i++) {
        now += 10;
        int64_t stamp = i % 3 == 2 ? now - 15 : now; /* the same displacement in both */
        shmtf_transform pair[2] = {edge_at("root", "f0", stamp, i), edge_at("root", "f1", stamp, i)};
        stage_status st = write_all(wr, pair, 2);
        if (!CHECK(st == STAGE_OK)) {
            fprintf(stderr, "  %s: pair %d: %d\n", what, i, (int)st);
            break;
        }
        if (i % 96 == 95) remove_named(wr, i % 192 == 95 ? "f0" : "f1"); /* what comes next is not late */
    }
    flag_put(&a.over, 1);
    pthread_join(reader, NULL);
    if (!CHECK(a.torn == 0)) fprintf(stderr, "  %s: %d pairs differ\n", what, a.torn);
}

/* ---- where the counters start ---- */

static void commits(world *w, writer *wr, uint64_t from) {
    (void)wr;
    store_relaxed(&w->s.global->commit, commit_make(1, from - 40)); /* a slot that never ran */
}
static void transactions(world *w, writer *wr, uint64_t from) {
    shmtf_writer *slot = &w->s.writers[wr->x.slot];
    store_relaxed(&slot->txn, from - 40);
    store_relaxed(&slot->live_from, wr->x.live_from = from - 40);
}
static void generations(world *w, writer *wr, uint64_t from) {
    (void)wr;
    for (uint64_t id = 1; id <= w->s.geo.max_frames; id++)
        if (!load_relaxed(&w->s.frames[id].gen)) store_relaxed(&w->s.frames[id].gen, from - 6);
}
/* Move the positions of all records up by a multiple of the rings' sizes, as if so many had been written. */
static void positions_by(world *w, uint64_t by) {
    for (uint64_t id = 0; id <= w->s.geo.max_frames; id++) {
        shmtf_frame_words_t *f = &w->s.frames[id];
        ring_ref rings[2];
        bool bound[2] = {ring_bind(&w->s, (uint32_t)id, 0, &rings[0]), ring_bind(&w->s, (uint32_t)id, HEAD_BIG, &rings[1])};
        for (int k = 0; k < 2; k++)
            for (uint64_t i = 0; bound[k] && i <= ring_mask(&rings[k]); i++) {
                uint64_t info = load_relaxed(&rings[k].heads[i].info);
                store_relaxed(&rings[k].heads[i].info, (info & ~0xffffffull) | ((info + by) & 0xffffff));
            }
        for (int k = 0; k < 2; k++) {
            uint64_t head = load_relaxed(&f->head[k]), search = load_relaxed(&f->newest_search[k]);
            if (!head_count(head)) continue;
            store_relaxed(&f->head[k], head_make(head_count(head) + by, head_flips(head), head & (HEAD_BIG | HEAD_INDEXED)));
            store_relaxed(&f->newest_search[k], (search & ~0xffffffull) | ((search + by) & 0xffffff));
        }
    }
}
static void positions(world *w, writer *wr, uint64_t from) {
    (void)wr;
    positions_by(w, from - 1024);
}
static void flips(world *w, writer *wr, uint64_t from) {
    (void)wr;
    for (uint64_t id = 0; id <= w->s.geo.max_frames; id++)
        for (int k = 0; k < 2; k++) {
            shmtf_word *word = &w->s.frames[id].head[k];
            uint64_t head = load_relaxed(word);
            if (head_count(head)) store_relaxed(word, head_make(head_count(head), head_flips(head) + from - 20, head & (HEAD_BIG | HEAD_INDEXED)));
        }
}
static void marks(world *w, writer *wr, uint64_t from) {
    (void)w;
    wr->x.climbs = (uint32_t)(from - 30);
    for (uint64_t id = 0; id <= w->s.geo.max_frames; id++) wr->x.mark[id] = (uint32_t)(from - 40);
}

static void start(world *w, writer *wr) {
    world_make(w, 8, HISTORY, -1, 1 << 16, 4);
    writer_make(wr, w, 0);
}
static void end(world *w, writer *wr) {
    writer_free(wr);
    world_free(w);
}

static void across(const char *what, void (*poke)(world *, writer *, uint64_t), uint64_t from) {
    static writer wr;
    world w;
    int64_t now = 0;
    expected all[FRAMES] = {{.n = 0}};
    start(&w, &wr);
    if (poke == generations) poke(&w, &wr, from);
    work(&w, &wr, all, &now, 200, what);
    if (poke && poke != generations) poke(&w, &wr, from);
    work(&w, &wr, all, &now, 600, what);
    end(&w, &wr);
    start(&w, &wr);
    if (poke == generations) poke(&w, &wr, from);
    for (int64_t t = 1; t < 20; t++) write_all(&wr, (shmtf_transform[2]){edge_at("root", "f0", t, 0), edge_at("root", "f1", t, 0)}, 2);
    if (poke && poke != generations) poke(&w, &wr, from);
    beside_readers(&w, &wr, 20, what);
    end(&w, &wr);
}

/* ---- where a width ends ---- */

/* The last ones are written, the next is refused, and what was there stays readable. */
static void refused_at_the_end(const char *what, void (*exhaust)(world *, writer *)) {
    static writer wr;
    world w;
    lookup l;
    start(&w, &wr);
    for (int i = 1; i <= 20; i++) NEED(write_one(&wr, edge_at("root", "f0", i, i)) == STAGE_OK);
    exhaust(&w, &wr);
    int written = 20;
    stage_status st = STAGE_OK;
    for (; written < 60 && st == STAGE_OK; written += st == STAGE_OK) st = write_one(&wr, edge_at("root", "f0", written + 1, written + 1));
    if (!CHECK(st == STAGE_CORRUPT && written > 21 && written < 60)) fprintf(stderr, "  %s: %d after %d\n", what, (int)st, written);
    for (int i = 0; i < 3; i++) CHECK(write_one(&wr, edge_at("root", "f0", 100 + i, 1)) == STAGE_CORRUPT);
    CHECK(look_up(&w, now_of(&w), "root", "f0", NULL, &l) == LOOKUP_OK && l.pose.x == written);
    int64_t t = written - 3;
    CHECK(look_up(&w, now_of(&w), "root", "f0", &t, &l) == LOOKUP_OK && l.pose.x == (double)t);
    end(&w, &wr);
}
static void no_more_commits(world *w, writer *wr) {
    (void)wr;
    store_relaxed(&w->s.global->commit, commit_make(1, VERSION_MASK - 6));
}
static void no_more_transactions(world *w, writer *wr) {
    store_relaxed(&w->s.writers[wr->x.slot].txn, LOCK_TXN_MASK - 6);
}
static void no_more_positions(world *w, writer *wr) {
    (void)wr;
    positions_by(w, HEAD_COUNT_MASK + 1 - 32);
}

/* ---- the rest ---- */

/* A handle of gen 0 would be none: the number is left out. */
static void check_no_handle_is_none(void) {
    static writer wr;
    world w;
    start(&w, &wr);
    generations(&w, &wr, 1ull << 32);
    for (int i = 0; i < 60; i++) {
        shmtf_frame f;
        NEED(write_one(&wr, edge_at("root", "f0", i + 1, i)) == STAGE_OK);
        CHECK(find_frame(&w, now_of(&w), "f0", &f) == RING_OK && f.gen != 0 && !(f.gen & 1));
        NEED(remove_named(&wr, "f0") == STAGE_OK);
    }
    end(&w, &wr);
}

static void check_extreme_stamps(void) {
    static writer wr;
    static const int64_t stamps[] = {INT64_MIN, INT64_MIN + 1, -1, 0, 1, INT64_MAX - 1, INT64_MAX};
    world w;
    lookup l;
    start(&w, &wr);
    for (int i = 0; i < 7; i++) CHECK(write_one(&wr, edge_at("root", "f0", stamps[i], i)) == STAGE_OK);
    for (int i = 0; i < 7; i++) CHECK(look_up(&w, now_of(&w), "root", "f0", &stamps[i], &l) == LOOKUP_OK && l.pose.x == i);
    int64_t between = INT64_MAX / 2;
    CHECK(look_up(&w, now_of(&w), "root", "f0", &between, &l) == LOOKUP_OK && l.pose.x > 4 && l.pose.x < 5);
    end(&w, &wr);
}

/* A futex word before its wrap: who is armed is woken, and sleeps no second time on what has been rung. */
static void check_bell(void) {
    bell *b = aligned_alloc(4096, 4096);
    NEED(b);
    memset(b, 0, 4096);
    for (int i = 0; i < BELL_BUCKETS; i++) store32_relaxed(&b->word[i], UINT32_MAX - 2);
    for (int round = 0; round < 6; round++) {
        unsigned buckets[2] = {3, 200};
        uint32_t seen[2];
        bell_set touched = {{0}};
        bell_add(&touched, 200);
        bell_arm(b, buckets, 2, seen);
        CHECK(bell_is_armed(b));
        bell_ring(b, &touched);
        EQUAL(load32_relaxed(&b->word[200]), seen[1] + 1);
        EQUAL(load32_relaxed(&b->word[3]), seen[0]);
        EQUAL(bell_sleep(b, &buckets[1], 1, &seen[1], INT64_MAX), 0); /* returns at once, or this takes its slice */
    }
    free(b);
}

int main(void) {
    across("nothing", NULL, 0);
    for (int bits = 31; bits < 54; bits += bits < 33 ? 1 : 7) across("versions", commits, 1ull << bits);
    for (int bits = 30; bits < 52; bits += bits < 33 ? 1 : 6) across("transactions", transactions, 1ull << bits);
    static const int gen_bits[] = {24, 25, 31, 32, 33};
    for (int i = 0; i < 5; i++) across("generations", generations, 1ull << gen_bits[i]);
    static const int position_bits[] = {24, 25, 31, 32, 47};
    for (int i = 0; i < 5; i++) across("positions", positions, 1ull << position_bits[i]);
    across("flips", flips, HEAD_FLIP_MASK + 1);
    across("flips", flips, 1ull << 13);
    across("marks", marks, 1ull << 32);
    refused_at_the_end("versions", no_more_commits);
    refused_at_the_end("transactions", no_more_transactions);
    refused_at_the_end("positions", no_more_positions);
    check_no_handle_is_none();
    check_extreme_stamps();
    check_bell();
    return check_result("wrap");
}
