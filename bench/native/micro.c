/* SPDX-License-Identifier: Apache-2.0
 *
 * Reads and writes go to two stores, so that the times asked for stay valid however much is written.  Every row runs
 * for a short while in every round; a disturbance of the machine so hits all rows of a round, not one row.
 */
#define _GNU_SOURCE
#include "micro.h"

#include <string.h>
#include <unistd.h>

#include "floor.h"
#include "snake.h"

enum { CHAIN = 16, N_STARTS = 4096, BATCH = 256, RECENT_NS = 200000000 };

typedef struct {
    snake read, write;
    floor_tree floor;
    uint32_t starts[N_STARTS];
    uint32_t next;
    bench_random random;
    int64_t oldest_ns, newest_ns; /* of the times that every chain of `read` can answer */
    uint32_t depth_back;          /* records between newest_ns and oldest_ns */
    shmtf_transform items[CHAIN];
    shmtf_pose sink;
    shmtf_error e;
    bool failed;
} bench;

static uint32_t start(bench *b) { return b->starts[b->next++ % N_STARTS]; }

static void floor_hot(bench *b) { floor_compose(&b->floor, 0, CHAIN, &b->sink); }
static void floor_random(bench *b) { floor_walk(&b->floor, start(b), CHAIN, &b->sink); }
static void floor_seqlock(bench *b) { floor_walk_seqlock(&b->floor, start(b), CHAIN, &b->sink); }
static void floor_recent(bench *b) {
    uint32_t back = 1 + bench_random_below(&b->random, 20);
    floor_interpolate(&b->floor, start(b), CHAIN, back, &b->sink);
}
static void floor_newest(bench *b) { floor_interpolate(&b->floor, start(b), CHAIN, 1, &b->sink); }
static void floor_any_time(bench *b) {
    uint32_t back = 1 + bench_random_below(&b->random, b->depth_back);
    floor_interpolate(&b->floor, start(b), CHAIN, back, &b->sink);
}

/* The items of one write: frames and stamps only, the poses stay.  By name: as a program has them that never kept the
 * handles which an earlier write filled in. */
static shmtf_transform *write_items(bench *b, uint32_t first, uint32_t n, bool by_name) {
    snake *k = &b->write;
    for (uint32_t i = 0; i < n; i++) {
        shmtf_transform *t = &b->items[i];
        t->parent = snake_ref(k, first + i, by_name);
        t->child = snake_ref(k, first + i + 1, by_name);
        t->stamp_ns = k->newest_ns[first + i + 1] += k->period_ns;
    }
    return b->items;
}

static void floor_write_n(bench *b, uint32_t n) {
    uint32_t first = start(b);
    floor_write(&b->floor, first, n, write_items(b, first, n, false));
}
static void floor_write_16(bench *b) { floor_write_n(b, CHAIN); }
static void floor_write_1(bench *b) { floor_write_n(b, 1); }

static void check(bench *b, shmtf_status st) {
    if (st != SHMTF_OK) b->failed = true;
}

static void latest(bench *b, uint32_t first, bool by_name) {
    const snake *k = &b->read;
    shmtf_result r;
    r.edges = NULL;
    check(b, shmtf_lookup_latest_transform(k->store, NULL, snake_ref(k, first, by_name), snake_ref(k, first + CHAIN, by_name), 0, &r, &b->e));
    b->sink = r.pose;
}
static void latest_hot(bench *b) { latest(b, 0, false); }
static void latest_handle(bench *b) { latest(b, start(b), false); }
static void latest_name(bench *b) { latest(b, start(b), true); }

static void at(bench *b, const int64_t *time, bool by_name) {
    const snake *k = &b->read;
    shmtf_result r;
    uint32_t first = start(b);
    r.edges = NULL;
    check(b, shmtf_lookup_transform(k->store, NULL, snake_ref(k, first, by_name), snake_ref(k, first + CHAIN, by_name), time, 0, &r, &b->e));
    b->sink = r.pose;
}
static int64_t time_in(bench *b, int64_t oldest) {
    return oldest + (int64_t)(bench_random_next(&b->random) % (uint64_t)(b->newest_ns - oldest));
}
static void at_recent(bench *b) {
    int64_t oldest = b->newest_ns - RECENT_NS, t = time_in(b, oldest > b->oldest_ns ? oldest : b->oldest_ns);
    at(b, &t, false);
}
static void at_recent_name(bench *b) {
    int64_t oldest = b->newest_ns - RECENT_NS, t = time_in(b, oldest > b->oldest_ns ? oldest : b->oldest_ns);
    at(b, &t, true);
}
static void at_any_time(bench *b) {
    int64_t t = time_in(b, b->oldest_ns);
    at(b, &t, false);
}
static void common(bench *b) { at(b, NULL, false); }

static void write_n(bench *b, uint32_t n, bool by_name) {
    shmtf_transform *items = write_items(b, start(b), n, by_name);
    check(b, shmtf_set_transforms(b->write.store, items, n, NULL, NULL, &b->e));
}
static void write_16_handle(bench *b) { write_n(b, CHAIN, false); }
static void write_16_name(bench *b) { write_n(b, CHAIN, true); }
static void write_1_handle(bench *b) { write_n(b, 1, false); }
static void write_1_name(bench *b) { write_n(b, 1, true); }

static const struct {
    const char *name, *what, *floor;
    void (*call)(bench *b);
} ROWS[] = {
    {"floor compose", "compose 16 records, always the same", NULL, floor_hot},
    {"floor walk", "random start, by parent words", NULL, floor_random},
    {"floor seqlock", "the same, each record's tag checked", NULL, floor_seqlock},
    {"floor newest", "interpolate each edge, between the newest two", NULL, floor_newest},
    {"floor recent", "the same, in the newest 0.2 s", NULL, floor_recent},
    {"floor any time", "the same, anywhere in the history", NULL, floor_any_time},
    {"floor write 16", "lock, write a record, unlock", NULL, floor_write_16},
    {"floor write 1", "the same, one frame", NULL, floor_write_1},
    {"latest hot", "by handle, always the same chain", "floor compose", latest_hot},
    {"latest handle", "by handle, random start", "floor seqlock", latest_handle},
    {"latest name", "by name, random start", "floor seqlock", latest_name},
    {"recent handle", "interpolated in the newest 0.2 s", "floor recent", at_recent},
    {"recent name", "the same by name", "floor recent", at_recent_name},
    {"any time handle", "interpolated anywhere in the history", "floor any time", at_any_time},
    {"common handle", "newest common time, staggered stamps", "floor newest", common},
    {"write 16 handle", "16 frames, atomically", "floor write 16", write_16_handle},
    {"write 16 name", "the same by name", "floor write 16", write_16_name},
    {"write 1 handle", "1 frame", "floor write 1", write_1_handle},
    {"write 1 name", "the same by name", "floor write 1", write_1_name},
};
enum { N_ROWS = sizeof ROWS / sizeof *ROWS };
_Static_assert((int)N_ROWS <= (int)MICRO_MAX_ROWS, "room for all rows");

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
static shmtf_status make(snake *k, const char *role, const micro_options *o, uint32_t fill, shmtf_error *e) {
    char name[64];
    snprintf(name, sizeof name, "shmtf-bench-%ld-%s", (long)getpid(), role);
    shmtf_status st = snake_make(k, name, o->n_frames, o->history, -1, e);
    if (st != SHMTF_OK) return st;
    st = snake_fill(k, fill, bench_clock_ns(CLOCK_REALTIME), e);
    shmtf_unlink(name, NULL);
    return st;
}

static shmtf_status prepare(bench *b, const micro_options *o, shmtf_error *e) {
    unsigned log2 = shmtf_ring_log2_for(o->history);
    uint32_t live = (uint32_t)shmtf_ring_live(log2), fill = (2u << log2) - 3; /* full, and its newest anywhere */
    shmtf_status st = make(&b->read, "read", o, fill, e);
    if (st == SHMTF_OK) st = make(&b->write, "write", o, fill, e);
    if (st != SHMTF_OK) return st;
    if (!floor_make(&b->floor, o->n_frames, log2, b->read.period_ns)) return SHMTF_FULL;
    b->depth_back = live - 2;
    /* One period is lost at each end to the frames' phases. */
    b->newest_ns = b->read.start_ns + (fill - 1) * b->read.period_ns;
    b->oldest_ns = b->newest_ns - (int64_t)(live - 2) * b->read.period_ns;
    b->random.state = 88172645463325252ull;
    for (uint32_t i = 0; i < CHAIN; i++) b->items[i].pose = bench_pose(i, b->read.start_ns);
    for (int i = 0; i < N_STARTS; i++) b->starts[i] = bench_random_below(&b->random, o->n_frames - CHAIN);
    return SHMTF_OK;
}

static bool wanted(const micro_options *o, size_t row) {
    if (!o->only || strstr(ROWS[row].name, o->only)) return true;
    for (size_t i = 0; i < N_ROWS; i++)
        if (ROWS[i].floor && !strcmp(ROWS[i].floor, ROWS[row].name) && strstr(ROWS[i].name, o->only)) return true;
    return false;
}

static double ratio_of(const micro_row *rows, size_t n, const micro_row *row) {
    for (size_t i = 0; row->floor && i < n; i++)
        if (!strcmp(rows[i].name, row->floor)) return row->ns.median / rows[i].ns.median;
    return 0;
}

static shmtf_status run(bench *b, const micro_options *o, micro_row *rows, size_t *n, shmtf_error *e) {
    static double ns[N_ROWS][MICRO_MAX_ROUNDS];
    for (int round = 0; round < o->rounds; round++)
        for (size_t i = 0; i < N_ROWS; i++) {
            if (wanted(o, i)) ns[i][round] = measure(b, i, o->round_ns);
            if (b->failed) return *e = b->e, b->e.status;
        }
    for (size_t i = 0; i < N_ROWS; i++) {
        if (!wanted(o, i)) continue;
        rows[*n] = (micro_row){.name = ROWS[i].name, .what = ROWS[i].what, .floor = ROWS[i].floor};
        rows[*n].ns = bench_spread_of(ns[i], (size_t)o->rounds);
        rows[*n].ratio = ratio_of(rows, *n, &rows[*n]);
        ++*n;
    }
    return SHMTF_OK;
}

shmtf_status micro_run(const micro_options *options, micro_row *rows, size_t *n, shmtf_error *e) {
    static bench b;
    memset(&b, 0, sizeof b);
    *n = 0;
    bench_pin(bench_cpu_allowed(options->cpu));
    shmtf_status st = prepare(&b, options, e);
    if (st == SHMTF_OK) st = run(&b, options, rows, n, e);
    if (b.floor.base) floor_free(&b.floor);
    snake_free(&b.read);
    snake_free(&b.write);
    return st;
}
