/* SPDX-License-Identifier: Apache-2.0
 *
 * The thesis' `latest` (its algorithms 6 and 7): two-phase locking over a reader-writer lock per frame.
 *
 * A lookup takes the read lock of each edge as it climbs, waiting where a writer is, and keeps all of them until it has
 * the last.  A writer never waits: it tries the write locks in the order in which the items were given, and where one is
 * held gives all back, sleeps 1 ms and begins again (NoWait).  Who holds and waits is a reader, and what it waits for is
 * held by a writer that does not wait: no deadlock.  Nothing is written before all locks are held.
 */
#define _GNU_SOURCE
#include <time.h>

#include "rwlock.h"

static const struct timespec BACK_OFF = {0, 1000000};

HOT_INLINE void lock_and_copy_edge(bench_client *c, uint32_t frame, baseline_record *out) {
    rw_read_lock(&c->frames[frame].lock);
    c->seen[c->n_seen++].frame = &c->frames[frame];
    baseline_copy(c, frame, out);
}

static bool read_chain(bench_client *c, uint32_t first, shmtf_pose *out, int64_t *stamps, char error[BENCH_ERROR_SIZE]) {
    uint32_t target, source;
    if (!baseline_ends(c, first, &target, &source, error)) return false;
    bool ok = baseline_walk(c, target, source, stamps, out, lock_and_copy_edge);
    for (uint32_t k = 0; k < c->n_seen; k++) rw_read_unlock(&c->seen[k].frame->lock);
    return ok || (snprintf(error, BENCH_ERROR_SIZE, "no path"), false);
}

static bool lock_all(const bench_client *c) {
    for (uint32_t i = 0; i < c->shape.write_len; i++) {
        if (rw_write_try(&c->frames[c->items[i].id].lock)) continue;
        while (i-- > 0) rw_write_unlock(&c->frames[c->items[i].id].lock);
        return false;
    }
    return true;
}

static bool write_all(bench_client *c, uint32_t first, int64_t stamp_ns, bool opposite, char error[BENCH_ERROR_SIZE]) {
    int64_t arrival_ns = bench_clock_ns(CLOCK_REALTIME);
    if (!baseline_prepare(c, first, opposite, error)) return false;
    for (; !lock_all(c); c->write_retries++) nanosleep(&BACK_OFF, NULL);
    for (uint32_t i = 0; i < c->shape.write_len; i++) baseline_put(c, &c->items[i], stamp_ns, arrival_ns);
    for (uint32_t i = 0; i < c->shape.write_len; i++) rw_write_unlock(&c->frames[c->items[i].id].lock);
    return true;
}

const bench_protocol bench_latest = {
    .name = "latest",
    .what = "two-phase locking: lookups hold every edge's read lock, writers try, give way and sleep 1 ms",
    .create = baseline_create,
    .remove = baseline_remove,
    .attach = baseline_attach,
    .detach = baseline_detach,
    .read = read_chain,
    .write = write_all,
    .retries = baseline_retries,
};
