/* SPDX-License-Identifier: Apache-2.0
 *
 * One store serves the reads and then the writes: at 10^6 frames a second one would need gigabytes more, and the times
 * that reads ask for must not be overwritten.
 */
#define _GNU_SOURCE
#include "scale.h"

#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "segment/layout.h"
#include "snake.h"

enum { BATCH = 64 };

typedef struct {
    snake k;
    uint32_t depth;
    int64_t oldest_ns, newest_ns; /* of the times that every chain can answer */
    bench_random random;
    shmtf_transform *items;
    shmtf_pose sink;
    shmtf_error e;
    bool failed;
} bench;

static uint32_t start(bench *b, uint32_t length) { return bench_random_below(&b->random, b->k.n_frames - length); }

static void check(bench *b, shmtf_status st) {
    if (st != SHMTF_OK) b->failed = true;
}

static void latest_from(bench *b, uint32_t first, bool by_name) {
    shmtf_result r;
    r.edges = NULL;
    check(b, shmtf_lookup_latest_transform(b->k.store, NULL, snake_ref(&b->k, first, by_name),
                                           snake_ref(&b->k, first + b->depth, by_name), 0, &r, &b->e));
    b->sink = r.pose;
}
static void latest_handle(bench *b) { latest_from(b, start(b, b->depth), false); }
static void latest_name(bench *b) { latest_from(b, start(b, b->depth), true); }
static void latest_at_leaf(bench *b) { latest_from(b, b->k.n_frames - 1 - b->depth, false); }

static void any_time(bench *b) {
    shmtf_result r;
    uint32_t first = start(b, b->depth);
    int64_t t = b->oldest_ns + (int64_t)(bench_random_next(&b->random) % (uint64_t)(b->newest_ns - b->oldest_ns));
    r.edges = NULL;
    check(b, shmtf_lookup_transform(b->k.store, NULL, snake_ref(&b->k, first, false), snake_ref(&b->k, first + b->depth, false), &t, 0,
                                    &r, &b->e));
    b->sink = r.pose;
}

static void write_n(bench *b, uint32_t n) {
    uint32_t first = start(b, n);
    for (uint32_t i = 0; i < n; i++) {
        shmtf_transform *t = &b->items[i];
        t->parent = snake_ref(&b->k, first + i, false);
        t->child = snake_ref(&b->k, first + i + 1, false);
        t->stamp_ns = b->k.newest_ns[first + i + 1] += b->k.period_ns;
    }
    check(b, shmtf_set_transforms(b->k.store, b->items, n, NULL, NULL, &b->e));
}
static void write_depth(bench *b) { write_n(b, b->depth); }
static void write_1(bench *b) { write_n(b, 1); }

static const struct {
    const char *name, *what;
    void (*call)(bench *b);
} ROWS[] = {
    {"first", "the first lookup of a process, at the leaf: it learns how deep each frame is", latest_at_leaf},
    {"latest handle", "lookup of the newest, by handle", latest_handle},
    {"latest name", "the same by name", latest_name},
    {"any time handle", "lookup anywhere in the history, by handle", any_time},
    {"write 1", "update of one frame, by handle", write_1},
    {"write depth", "update of as many frames as a lookup has edges", write_depth},
};
enum { N_ROWS = sizeof ROWS / sizeof *ROWS, FIRST = 0, READS = 1, WRITES = 4 };
_Static_assert((int)N_ROWS == (int)SCALE_N_ROWS, "all rows");

/* By this thread's processor time: what other processes do meanwhile does not count, except to the caches. */
static double measure(bench *b, size_t row, int64_t round_ns) {
    uint64_t n = 0;
    for (int i = 0; i < BATCH; i++) ROWS[row].call(b); /* warm up after the row before */
    int64_t begin = bench_clock_ns(CLOCK_THREAD_CPUTIME_ID), now = begin;
    while (now - begin < round_ns && !b->failed) {
        for (int i = 0; i < BATCH; i++) ROWS[row].call(b);
        n += BATCH;
        now = bench_clock_ns(CLOCK_THREAD_CPUTIME_ID);
    }
    return n ? (double)(now - begin) / (double)n : 0;
}

/* A full store.  Its name goes at once, so that nothing is left however this process ends; not before the first write,
 * which opens the store's bell. */
static shmtf_status prepare(bench *b, const scale_options *o, shmtf_error *e) {
    char name[64];
    uint32_t live = (uint32_t)shmtf_ring_live(shmtf_ring_log2_for(o->history)), fill = live + 3;
    snprintf(name, sizeof name, "shmtf-bench-%ld-scale", (long)getpid());
    shmtf_status st = snake_make(&b->k, name, o->n_frames, o->history, -1, e);
    if (st != SHMTF_OK) return st;
    st = snake_fill(&b->k, fill, bench_clock_ns(CLOCK_REALTIME), e);
    shmtf_unlink(name, NULL);
    b->items = calloc(o->depth, sizeof *b->items);
    if (!b->items) return SHMTF_FULL;
    for (uint32_t i = 0; i < o->depth; i++) b->items[i].pose = bench_pose(i, b->k.start_ns);
    b->depth = o->depth;
    b->random.state = 88172645463325252ull;
    /* One period is lost at each end to the frames' phases. */
    b->newest_ns = b->k.start_ns + (fill - 1) * b->k.period_ns;
    b->oldest_ns = b->newest_ns - (int64_t)(live - 2) * b->k.period_ns;
    return st;
}

static double measure_once(bench *b, size_t row) {
    int64_t begin = bench_clock_ns(CLOCK_THREAD_CPUTIME_ID);
    ROWS[row].call(b);
    return (double)(bench_clock_ns(CLOCK_THREAD_CPUTIME_ID) - begin);
}

/* Rows from one to before another, interleaved. */
static void run(bench *b, const scale_options *o, size_t from, size_t to, scale_row *rows) {
    double ns[N_ROWS][SCALE_MAX_ROUNDS];
    for (int round = 0; round < o->rounds; round++)
        for (size_t i = from; i < to; i++) ns[i][round] = measure(b, i, o->round_ns);
    for (size_t i = from; i < to; i++)
        rows[i] = (scale_row){ROWS[i].name, ROWS[i].what, bench_spread_of(ns[i], (size_t)o->rounds)};
}

shmtf_status scale_run(const scale_options *options, scale_row rows[SCALE_N_ROWS], shmtf_error *e) {
    bench b;
    memset(&b, 0, sizeof b);
    bench_pin(bench_cpu_allowed(options->cpu));
    shmtf_status st = prepare(&b, options, e);
    if (st == SHMTF_OK) {
        double first_ns = measure_once(&b, FIRST);
        rows[FIRST] = (scale_row){ROWS[FIRST].name, ROWS[FIRST].what, {first_ns, first_ns, first_ns}};
        run(&b, options, READS, WRITES, rows);
        run(&b, options, WRITES, N_ROWS, rows);
        if (b.failed) *e = b.e, st = b.e.status;
    }
    free(b.items);
    snake_free(&b.k);
    return st;
}
