/* SPDX-License-Identifier: Apache-2.0
 *
 * The thesis' `snapshot` (its section 4.1): a reader-writer lock per frame, never more than one held.  Any number of
 * processes work side by side, and a lookup may see the frames of one update partly.
 */
#define _GNU_SOURCE
#include "rwlock.h"

HOT_INLINE void copy_edge(bench_client *c, uint32_t frame, baseline_record *out) {
    shmtf_word *lock = &c->frames[frame].lock;
    rw_read_lock(lock);
    baseline_copy(c, frame, out);
    rw_read_unlock(lock);
}

static bool read_chain(bench_client *c, uint32_t first, shmtf_pose *out, int64_t *stamps, char error[BENCH_ERROR_SIZE]) {
    uint32_t target, source;
    if (!baseline_ends(c, first, &target, &source, error)) return false;
    return baseline_walk(c, target, source, stamps, out, copy_edge) || (snprintf(error, BENCH_ERROR_SIZE, "no path"), false);
}

static bool write_each(bench_client *c, uint32_t first, int64_t stamp_ns, bool opposite, char error[BENCH_ERROR_SIZE]) {
    int64_t arrival_ns = bench_clock_ns(CLOCK_REALTIME);
    if (!baseline_prepare(c, first, opposite, error)) return false;
    for (uint32_t i = 0; i < c->shape.write_len; i++) {
        shmtf_word *lock = &c->frames[c->items[i].id].lock;
        rw_write_lock(lock);
        baseline_put(c, &c->items[i], stamp_ns, arrival_ns);
        rw_write_unlock(lock);
    }
    return true;
}

const bench_protocol bench_snapshot = {
    .name = "snapshot",
    .what = "a reader-writer lock per frame, one held at a time: lookups may see parts of an update",
    .create = baseline_create,
    .remove = baseline_remove,
    .attach = baseline_attach,
    .detach = baseline_detach,
    .read = read_chain,
    .write = write_each,
    .retries = baseline_retries,
};
