/* SPDX-License-Identifier: Apache-2.0
 *
 * Reads and writes go to two stores, so that the times asked for stay valid however much is written.  Every row, a
 * peer's too, runs for a short while in every round; a disturbance of the machine so hits all rows of a round, not one.
 */
#define _GNU_SOURCE
#include "micro.h"

#include <string.h>
#include <unistd.h>

#include "floor.h"
#include "micro_peer.h"
#include "snake.h"

enum { N_STARTS = 4096, BATCH = 256, RECENT_NS = 200000000 };

typedef struct {
    snake read, write;
    floor_tree floor;
    const micro_peer *peer; /* NULL: none */
    micro_peer_client *client;
    uint32_t depth;
    uint32_t starts[N_STARTS];
    uint32_t next;
    bench_random random;
    int64_t oldest_ns, newest_ns; /* of the times that every chain of `read` can answer */
    uint32_t depth_back;          /* records between newest_ns and oldest_ns */
    shmtf_transform items[MICRO_WRITE_LEN];
    shmtf_pose sink;
    shmtf_error e;
    bool failed;
} bench;

static uint32_t start(bench *b) { return b->starts[b->next++ % N_STARTS]; }

static void floor_hot(bench *b) { floor_compose(&b->floor, 0, b->depth, &b->sink); }
static void floor_random(bench *b) { floor_walk(&b->floor, start(b), b->depth, &b->sink); }
static void floor_seqlock(bench *b) { floor_walk_seqlock(&b->floor, start(b), b->depth, &b->sink); }
static void floor_recent(bench *b) {
    uint32_t back = 1 + bench_random_below(&b->random, 20);
    floor_interpolate(&b->floor, start(b), b->depth, back, &b->sink);
}
static void floor_newest(bench *b) { floor_interpolate(&b->floor, start(b), b->depth, 1, &b->sink); }
static void floor_any_time(bench *b) {
    uint32_t back = 1 + bench_random_below(&b->random, b->depth_back);
    floor_interpolate(&b->floor, start(b), b->depth, back, &b->sink);
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
static void floor_write_16(bench *b) { floor_write_n(b, MICRO_WRITE_LEN); }
static void floor_write_1(bench *b) { floor_write_n(b, 1); }

static void check(bench *b, shmtf_status st) {
    if (st != SHMTF_OK) b->failed = true;
}

static void latest(bench *b, uint32_t first, bool by_name) {
    const snake *k = &b->read;
    shmtf_result r;
    r.edges = NULL;
    shmtf_ref target = snake_ref(k, first, by_name), source = snake_ref(k, first + b->depth, by_name);
    check(b, shmtf_lookup_latest_transform(k->store, NULL, target, source, 0, &r, &b->e));
    b->sink = r.pose;
}
static void latest_hot(bench *b) { latest(b, 0, false); }
static void latest_handle(bench *b) { latest(b, start(b), false); }
static void latest_name(bench *b) { latest(b, start(b), true); }

/* r: NULL asks only whether there is an answer. */
static void lookup(bench *b, const int64_t *time, bool by_name, shmtf_result *r) {
    const snake *k = &b->read;
    uint32_t first = start(b);
    shmtf_ref target = snake_ref(k, first, by_name), source = snake_ref(k, first + b->depth, by_name);
    check(b, shmtf_lookup_transform(k->store, NULL, target, source, time, 0, r, &b->e));
}
static void at(bench *b, const int64_t *time, bool by_name) {
    shmtf_result r;
    r.edges = NULL;
    lookup(b, time, by_name, &r);
    b->sink = r.pose;
}
static int64_t time_in(bench *b, micro_when when) {
    int64_t oldest = b->newest_ns - RECENT_NS;
    if (when == MICRO_NEWEST) return 0;
    if (when == MICRO_ANY_TIME || oldest < b->oldest_ns) oldest = b->oldest_ns;
    return oldest + (int64_t)(bench_random_next(&b->random) % (uint64_t)(b->newest_ns - oldest));
}
static void at_time(bench *b, micro_when when, bool by_name) {
    int64_t t = time_in(b, when);
    at(b, &t, by_name);
}
static void at_recent(bench *b) { at_time(b, MICRO_RECENT, false); }
static void at_recent_name(bench *b) { at_time(b, MICRO_RECENT, true); }
static void at_any_time(bench *b) { at_time(b, MICRO_ANY_TIME, false); }
static void at_any_time_name(bench *b) { at_time(b, MICRO_ANY_TIME, true); }
static void common(bench *b) { at(b, NULL, false); }
static void common_name(bench *b) { at(b, NULL, true); }
static void can_name(bench *b) { lookup(b, NULL, true, NULL); }

static void write_n(bench *b, uint32_t n, bool by_name) {
    shmtf_transform *items = write_items(b, start(b), n, by_name);
    check(b, shmtf_set_transforms(b->write.store, items, n, NULL, NULL, &b->e));
}
static void write_16_handle(bench *b) { write_n(b, MICRO_WRITE_LEN, false); }
static void write_16_name(bench *b) { write_n(b, MICRO_WRITE_LEN, true); }
static void write_1_handle(bench *b) { write_n(b, 1, false); }
static void write_1_name(bench *b) { write_n(b, 1, true); }

static const struct {
    const char *name, *what, *floor;
    void (*call)(bench *b);
} ROWS[] = {
    {"floor compose", "compose the chain's records, always the same", NULL, floor_hot},
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
    {"any time name", "the same by name", "floor any time", at_any_time_name},
    {"common handle", "newest common time, staggered stamps", "floor newest", common},
    {"common name", "the same by name", "floor newest", common_name},
    {"can name", "is there an answer at the newest common time?", "floor newest", can_name},
    {"write 16 handle", "16 frames, atomically", "floor write 16", write_16_handle},
    {"write 16 name", "the same by name", "floor write 16", write_16_name},
    {"write 1 handle", "1 frame", "floor write 1", write_1_handle},
    {"write 1 name", "the same by name", "floor write 1", write_1_name},
};
enum { N_OURS = sizeof ROWS / sizeof *ROWS };
_Static_assert((int)N_OURS < (int)MICRO_MAX_ROWS, "room for all rows and for a peer's");

static size_t n_rows(const bench *b) { return N_OURS + (b->peer ? b->peer->n_rows : 0); }
static const micro_peer_row *peer_row(const bench *b, size_t row) { return row < N_OURS ? NULL : &b->peer->rows[row - N_OURS]; }

static void call_peer(bench *b, const micro_peer_row *row) {
    if (row->call(b->client, start(b), time_in(b, row->when))) return;
    b->failed = true;
    b->e.status = SHMTF_SYSTEM;
    b->e.what = b->peer->why(b->client);
}

static void call_often(bench *b, size_t row) {
    const micro_peer_row *theirs = peer_row(b, row);
    for (int i = 0; theirs && i < BATCH; i++) call_peer(b, theirs);
    for (int i = 0; !theirs && i < BATCH; i++) ROWS[row].call(b);
}

/* By this thread's processor time: what other processes do meanwhile does not count, except to the caches. */
static double measure(bench *b, size_t row, int64_t round_ns) {
    uint64_t n = 0;
    call_often(b, row); /* warm up after the row before */
    int64_t begin = bench_clock_ns(CLOCK_THREAD_CPUTIME_ID), now = begin;
    while (now - begin < round_ns && !b->failed) {
        call_often(b, row);
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

/* A peer that cannot be measured here leaves its rows out. */
static void prepare_peer(bench *b, const micro_options *o, uint32_t live, char error[MICRO_TEXT_SIZE]) {
    const snake *k = &b->read;
    micro_shape shape = {o->n_frames, live, b->depth, MICRO_WRITE_LEN, b->newest_ns - (int64_t)(live - 1) * k->period_ns, k->period_ns};
    if (!o->peer || !(b->peer = micro_peer_load(o->peer, error))) return;
    b->client = b->peer->make(&shape, error);
    if (!b->client) b->peer = NULL;
}

static shmtf_status prepare(bench *b, const micro_options *o, micro_result *result, shmtf_error *e) {
    unsigned log2 = shmtf_ring_log2_for(o->history);
    uint32_t live = (uint32_t)shmtf_ring_live(log2), fill = (2u << log2) - 3; /* full, and its newest anywhere */
    uint32_t longest = o->depth > MICRO_WRITE_LEN ? o->depth : MICRO_WRITE_LEN;
    shmtf_status st = make(&b->read, "read", o, fill, e);
    if (st == SHMTF_OK) st = make(&b->write, "write", o, fill, e);
    if (st != SHMTF_OK) return st;
    if (!floor_make(&b->floor, o->n_frames, log2, b->read.period_ns)) return SHMTF_FULL;
    b->depth = o->depth;
    b->depth_back = live - 2;
    /* One period is lost at each end to the frames' phases. */
    b->newest_ns = b->read.start_ns + (fill - 1) * b->read.period_ns;
    b->oldest_ns = b->newest_ns - (int64_t)(live - 2) * b->read.period_ns;
    b->random.state = 88172645463325252ull;
    for (uint32_t i = 0; i < MICRO_WRITE_LEN; i++) b->items[i].pose = bench_pose(i, b->read.start_ns);
    for (int i = 0; i < N_STARTS; i++) b->starts[i] = bench_random_below(&b->random, o->n_frames - longest);
    prepare_peer(b, o, live, result->without_peer);
    return SHMTF_OK;
}

/* Of the row itself, or of what a peer's row is compared with. */
static const char *floor_name(const bench *b, size_t row) {
    if (row < N_OURS) return ROWS[row].floor;
    for (size_t i = 0; i < N_OURS; i++)
        if (!strcmp(ROWS[i].name, peer_row(b, row)->beside)) return ROWS[i].floor;
    return NULL;
}
static const char *row_name(const bench *b, size_t row) { return row < N_OURS ? ROWS[row].name : peer_row(b, row)->name; }
static const char *row_what(const bench *b, size_t row) { return row < N_OURS ? ROWS[row].what : peer_row(b, row)->what; }

static bool wanted(const bench *b, const micro_options *o, size_t row) {
    if (!o->only || strstr(row_name(b, row), o->only)) return true;
    for (size_t i = 0; i < n_rows(b); i++) {
        const char *floor = floor_name(b, i);
        if (floor && !strcmp(floor, row_name(b, row)) && strstr(row_name(b, i), o->only)) return true;
    }
    return false;
}

static double ratio_of(const micro_result *result, const micro_row *row) {
    for (size_t i = 0; row->floor && i < result->n; i++)
        if (!strcmp(result->rows[i].name, row->floor)) return row->ns.median / result->rows[i].ns.median;
    return 0;
}

static shmtf_status run(bench *b, const micro_options *o, micro_result *result, shmtf_error *e) {
    static double ns[MICRO_MAX_ROWS][MICRO_MAX_ROUNDS];
    size_t n = n_rows(b) < MICRO_MAX_ROWS ? n_rows(b) : MICRO_MAX_ROWS;
    for (int round = 0; round < o->rounds; round++)
        for (size_t i = 0; i < n; i++) {
            if (wanted(b, o, i)) ns[i][round] = measure(b, i, o->round_ns);
            if (b->failed) return *e = b->e, b->e.status;
        }
    for (size_t i = 0; i < n; i++) {
        const micro_peer_row *theirs = peer_row(b, i);
        if (!wanted(b, o, i)) continue;
        micro_row *row = &result->rows[result->n];
        *row = (micro_row){.name = row_name(b, i), .what = row_what(b, i), .floor = floor_name(b, i)};
        if (theirs) row->peer = b->peer->name, row->beside = theirs->beside;
        row->ns = bench_spread_of(ns[i], (size_t)o->rounds);
        row->ratio = ratio_of(result, row);
        result->n++;
    }
    return SHMTF_OK;
}

shmtf_status micro_run(const micro_options *options, micro_result *result, shmtf_error *e) {
    static bench b;
    memset(&b, 0, sizeof b);
    memset(result, 0, sizeof *result);
    bench_pin(bench_cpu_allowed(options->cpu));
    shmtf_status st = prepare(&b, options, result, e);
    if (st == SHMTF_OK) st = run(&b, options, result, e);
    if (b.client) b.peer->free(b.client);
    if (b.floor.base) floor_free(&b.floor);
    snake_free(&b.read);
    snake_free(&b.write);
    return st;
}
