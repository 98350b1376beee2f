/* SPDX-License-Identifier: Apache-2.0
 *
 * shmtf through its public C API, as any program would use it.
 */
#define _GNU_SOURCE
#include <stdlib.h>
#include <string.h>

#include "protocol.h"
#include "snake.h"

static const int64_t CACHE_TIME_NS = 10000000000ll, TIMEOUT_NS = 1000000000;

struct bench_client {
    snake k;
    bench_shape shape;
    shmtf_edge *edges;
    shmtf_transform *items;
    shmtf_pose poses[BENCH_POSES];
};

static bool say(char *text, const shmtf_error *e) {
    shmtf_error_message(e, text, BENCH_ERROR_SIZE);
    return false;
}

static bool create(char place[BENCH_PLACE_SIZE], const bench_shape *shape, char error[BENCH_ERROR_SIZE]) {
    snake k;
    shmtf_error e;
    if (snake_make(&k, place, shape->n_frames, shape->history, CACHE_TIME_NS, &e) != SHMTF_OK) return say(error, &e);
    shmtf_status st = snake_fill(&k, 2 * shape->history, bench_now_ns(), &e);
    snake_free(&k);
    if (st == SHMTF_OK) return true;
    shmtf_unlink(place, NULL);
    return say(error, &e);
}

static void unlink_name(const char *place) { shmtf_unlink(place, NULL); }

static void detach(bench_client *c) {
    if (!c) return;
    snake_free(&c->k);
    free(c->edges);
    free(c->items);
    free(c);
}

static bench_client *attach(const char *place, const bench_shape *shape, char error[BENCH_ERROR_SIZE]) {
    shmtf_error e;
    bench_client *c = calloc(1, sizeof *c);
    if (!c) return snprintf(error, BENCH_ERROR_SIZE, "no memory"), NULL;
    c->shape = *shape;
    c->edges = calloc(shape->read_len, sizeof *c->edges);
    c->items = calloc(shape->write_len, sizeof *c->items);
    if (!c->edges || !c->items) return snprintf(error, BENCH_ERROR_SIZE, "no memory"), detach(c), NULL;
    if (snake_attach(&c->k, place, shape->n_frames, &e) != SHMTF_OK) return say(error, &e), detach(c), NULL;
    for (uint32_t i = 0; i < BENCH_POSES; i++) c->poses[i] = bench_written_pose(i);
    return c;
}

static bool read_latest(bench_client *c, uint32_t first, shmtf_pose *out, int64_t *stamps, char error[BENCH_ERROR_SIZE]) {
    uint32_t n = c->shape.read_len;
    shmtf_error e;
    shmtf_result r;
    r.edges = stamps ? c->edges : NULL;
    r.max_edges = n;
    shmtf_ref target = snake_ref(&c->k, first, c->shape.by_name), source = snake_ref(&c->k, first + n, c->shape.by_name);
    if (shmtf_lookup_latest_transform(c->k.store, NULL, target, source, 0, &r, &e) != SHMTF_OK) return say(error, &e);
    *out = r.pose;
    for (uint32_t i = 0; stamps && i < n; i++) stamps[n - 1 - i] = c->edges[i].stamp_ns; /* from the source upwards */
    return true;
}

static bool read_common(bench_client *c, uint32_t first, shmtf_pose *out, int64_t *stamps, char error[BENCH_ERROR_SIZE]) {
    uint32_t n = c->shape.read_len;
    shmtf_error e;
    shmtf_result r;
    r.edges = NULL;
    shmtf_ref target = snake_ref(&c->k, first, c->shape.by_name), source = snake_ref(&c->k, first + n, c->shape.by_name);
    if (shmtf_lookup_transform(c->k.store, NULL, target, source, NULL, 0, &r, &e) != SHMTF_OK) return say(error, &e);
    *out = r.pose;
    for (uint32_t i = 0; stamps && i < n; i++) stamps[i] = r.stamp_ns;
    return true;
}

static bool write_chain(bench_client *c, uint32_t first, int64_t stamp_ns, bool opposite, char error[BENCH_ERROR_SIZE]) {
    uint32_t n = c->shape.write_len;
    shmtf_error e;
    shmtf_write_options options = {.timeout_ns = TIMEOUT_NS};
    for (uint32_t i = 0; i < n; i++) {
        uint32_t child = opposite ? first + 1 + i : first + n - i;
        shmtf_transform *t = &c->items[i];
        t->parent = snake_ref(&c->k, child - 1, c->shape.by_name);
        t->child = snake_ref(&c->k, child, c->shape.by_name);
        t->stamp_ns = stamp_ns;
        t->pose = c->poses[child % BENCH_POSES];
    }
    return shmtf_set_transforms(c->k.store, c->items, n, &options, NULL, &e) == SHMTF_OK || say(error, &e);
}

static void retries(bench_client *c, uint64_t *reads, uint64_t *writes) {
    shmtf_counters counters;
    shmtf_get_counters(c->k.store, &counters);
    *reads = counters.rereads + counters.restarts;
    *writes = counters.aborts;
}

const bench_protocol bench_shmtf = {
    .name = "shmtf",
    .what = "this library: readers take no lock, writers lock per frame and commit with one word",
    .create = create,
    .remove = unlink_name,
    .attach = attach,
    .detach = detach,
    .read = read_latest,
    .write = write_chain,
    .retries = retries,
};
const bench_protocol bench_shmtf_common = {
    .name = "shmtf-common",
    .what = "this library, lookups at the newest time common to all edges, interpolated",
    .common_time = true,
    .create = create,
    .remove = unlink_name,
    .attach = attach,
    .detach = detach,
    .read = read_common,
    .write = write_chain,
    .retries = retries,
};
