/* SPDX-License-Identifier: Apache-2.0
 *
 * One lock around everything: a robust, process-shared mutex, which is what tf2 does between the threads of one process
 * (the thesis' `old`).
 *
 *   giant         the lock is taken for each frame of an update, as setTransform does: a read may come in between
 *   giant-atomic  the lock is taken once per update, which is what shmtf promises and tf2 does not
 *
 * A holder that dies leaves whole records, because a frame's count is raised after them, and the next one goes on; of its
 * update there may be a part.
 */
#define _GNU_SOURCE
#include <errno.h>

#include "baseline.h"

static void take(baseline_header *h) {
    if (pthread_mutex_lock(&h->mutex) == EOWNERDEAD) pthread_mutex_consistent(&h->mutex);
}
static void give(baseline_header *h) { pthread_mutex_unlock(&h->mutex); }

HOT_INLINE void copy_edge(bench_client *c, uint32_t frame, baseline_record *out) { baseline_copy(c, frame, out); }

static bool read_chain(bench_client *c, uint32_t first, shmtf_pose *out, int64_t *stamps, char error[BENCH_ERROR_SIZE]) {
    uint32_t target, source;
    if (!baseline_ends(c, first, &target, &source, error)) return false;
    take(c->h);
    bool ok = baseline_walk(c, target, source, stamps, out, copy_edge);
    give(c->h);
    return ok || (snprintf(error, BENCH_ERROR_SIZE, "no path"), false);
}

static bool write_each(bench_client *c, uint32_t first, int64_t stamp_ns, bool opposite, char error[BENCH_ERROR_SIZE]) {
    int64_t arrival_ns = bench_clock_ns(CLOCK_REALTIME);
    if (!baseline_prepare(c, first, opposite, error)) return false;
    for (uint32_t i = 0; i < c->shape.write_len; i++) {
        take(c->h);
        baseline_put(c, &c->items[i], stamp_ns, arrival_ns);
        give(c->h);
    }
    return true;
}

static bool write_all(bench_client *c, uint32_t first, int64_t stamp_ns, bool opposite, char error[BENCH_ERROR_SIZE]) {
    int64_t arrival_ns = bench_clock_ns(CLOCK_REALTIME);
    if (!baseline_prepare(c, first, opposite, error)) return false;
    take(c->h);
    for (uint32_t i = 0; i < c->shape.write_len; i++) baseline_put(c, &c->items[i], stamp_ns, arrival_ns);
    give(c->h);
    return true;
}

const bench_protocol bench_giant = {
    .name = "giant",
    .what = "one process-shared robust mutex, taken for every frame written and for every lookup",
    .create = baseline_create,
    .remove = baseline_remove,
    .attach = baseline_attach,
    .detach = baseline_detach,
    .read = read_chain,
    .write = write_each,
    .retries = baseline_retries,
};
const bench_protocol bench_giant_atomic = {
    .name = "giant-atomic",
    .what = "one process-shared robust mutex, taken once per update and for every lookup",
    .create = baseline_create,
    .remove = baseline_remove,
    .attach = baseline_attach,
    .detach = baseline_detach,
    .read = read_chain,
    .write = write_all,
    .retries = baseline_retries,
};
