/* SPDX-License-Identifier: Apache-2.0
 *
 * Silo's protocol (Tu et al. 2013), as the thesis' author applied it to tf: optimistic readers, a version per frame.
 *
 * The frame's word is its version, with bit 0 set while a writer has it.  A lookup notes each frame's version, copies,
 * and at the end looks whether every version is still the same; if not it begins again.  At the moment between the last
 * copy and the first check all copies were in force.  A writer locks its frames in the order of their ids, the highest first,
 * which excludes deadlock, writes, and gives each its next version.  There is no logging, so there are no epochs; updates read nothing,
 * so they validate nothing.  The word names no owner: who dies holding it leaves the frame locked for ever.
 *
 *   lock      CAS acquire, then a release fence: a reader that sees a word of ours sees the frame locked, or newer
 *   unlock    store release; pairs with the acquire load of the version before the copy
 *   validate  acquire fence, then the versions again; pairs with the release fence
 */
#define _GNU_SOURCE
#include "baseline.h"

#define LOCKED 1ull

HOT_INLINE void note_and_copy_edge(bench_client *c, uint32_t frame, baseline_record *out) {
    baseline_frame *f = &c->frames[frame];
    uint64_t version = load_acquire(&f->lock);
    for (unsigned turn = 0; version & LOCKED; version = load_acquire(&f->lock)) baseline_pause(&turn);
    c->seen[c->n_seen++] = (baseline_seen){f, version};
    baseline_copy(c, frame, out);
}

static bool unchanged(const bench_client *c) {
    uint64_t changed = 0;
    fence_acquire();
    for (uint32_t k = 0; k < c->n_seen; k++) changed |= load_relaxed(&c->seen[k].frame->lock) ^ c->seen[k].version;
    return !changed;
}

static bool read_chain(bench_client *c, uint32_t first, shmtf_pose *out, int64_t *stamps, char error[BENCH_ERROR_SIZE]) {
    uint32_t target, source;
    if (!baseline_ends(c, first, &target, &source, error)) return false;
    for (;; c->read_retries++) {
        bool ok = baseline_walk(c, target, source, stamps, out, note_and_copy_edge);
        if (unchanged(c)) return ok || (snprintf(error, BENCH_ERROR_SIZE, "no path"), false);
    }
}

/* Insertion from the back: items that are given from the leaf to the root are in order at once. */
static void sort_by_id(baseline_item *items, uint32_t n) {
    for (uint32_t i = n - 1; i-- > 0;) {
        baseline_item moving = items[i];
        uint32_t at = i;
        for (; at + 1 < n && items[at + 1].id > moving.id; at++) items[at] = items[at + 1];
        items[at] = moving;
    }
}

static void lock_frame(baseline_frame *f) {
    for (unsigned turn = 0;; baseline_pause(&turn)) {
        uint64_t version = load_relaxed(&f->lock);
        if (!(version & LOCKED) && cas_acq_rel(&f->lock, version, version | LOCKED)) return;
    }
}

static bool write_all(bench_client *c, uint32_t first, int64_t stamp_ns, bool opposite, char error[BENCH_ERROR_SIZE]) {
    int64_t arrival_ns = bench_clock_ns(CLOCK_REALTIME);
    uint32_t n = c->shape.write_len;
    if (!baseline_prepare(c, first, opposite, error)) return false;
    sort_by_id(c->items, n);
    for (uint32_t i = 0; i < n; i++) lock_frame(&c->frames[c->items[i].id]);
    fence_release();
    for (uint32_t i = 0; i < n; i++) baseline_put(c, &c->items[i], stamp_ns, arrival_ns);
    for (uint32_t i = 0; i < n; i++) {
        shmtf_word *lock = &c->frames[c->items[i].id].lock;
        store_release(lock, load_relaxed(lock) + 1);
    }
    return true;
}

const bench_protocol bench_silo = {
    .name = "silo",
    .what = "a version per frame: lookups validate and begin again, writers lock in the order of ids",
    .create = baseline_create,
    .remove = baseline_remove,
    .attach = baseline_attach,
    .detach = baseline_detach,
    .read = read_chain,
    .write = write_all,
    .retries = baseline_retries,
};
