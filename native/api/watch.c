/* SPDX-License-Identifier: Apache-2.0
 *
 * Sleeping until something changes.
 */
#include <errno.h>

#include "api/store.h"

/* Has this frame, or the name, a record newer than `since` at this commit?  What cannot be told counts as changed. */
static bool changed(shmtf_store *h, uint64_t commit, const shmtf_ref *ref, uint64_t since, unsigned *bucket) {
    shmtf_frame frame = ref->frame;
    bool touched = true;
    *bucket = BELL_SHAPE;
    if (!frame.gen) {
        name_key key;
        names_key(&key, ref->name);
        ring_status st = names_find(&h->s, commit, &key, &frame);
        if (st == RING_NONE) return false;
        if (st != RING_OK) return true;
    }
    if (!frame.id || frame.id > h->s.geo.max_frames || names_gen(&h->s, frame.id) != frame.gen) return true;
    *bucket = bell_bucket(frame.id);
    ring_status st = ring_changed_since(&h->s, frame.id, commit, since, &touched);
    return touched || (st != RING_OK && st != RING_NONE);
}

typedef struct {
    const shmtf_ref *frames;
    size_t n;
    uint64_t since;
    unsigned buckets[BELL_MAX_WAIT];
    unsigned n_buckets; /* 0: not known yet */
} watch;

/* One look.  Sets the buckets that would ring: those of the frames, or of any commit if they are many. */
static bool look(shmtf_store *h, watch *w, uint64_t *version) {
    uint64_t commit = load_seq_cst(&h->s.global->commit); /* [E2 acquire] [E9 seq_cst] */
    bool is_changed = false;
    tree_clears clears;
    *version = commit_version(commit);
    w->n_buckets = 1;
    w->buckets[0] = w->n ? BELL_SHAPE : BELL_ANY;
    if (*version <= w->since) {
        if (w->n > BELL_MAX_WAIT - 1) w->buckets[0] = BELL_ANY;
        for (size_t i = 0; i < w->n && w->n < BELL_MAX_WAIT; i++) changed(h, commit, &w->frames[i], *version, &w->buckets[w->n_buckets++]);
        return false;
    }
    if (!w->n) return true;
    if (tree_clears_at(&h->s, commit, &clears) != RING_OK || clears.dynamic_upto > w->since) return true;
    for (size_t i = 0; i < w->n; i++) {
        unsigned bucket;
        if (changed(h, commit, &w->frames[i], w->since, &bucket)) is_changed = true;
        if (w->n < BELL_MAX_WAIT) w->buckets[w->n_buckets++] = bucket;
        else w->buckets[0] = BELL_ANY;
    }
    return is_changed;
}

shmtf_status shmtf_wait_for_change(shmtf_store *h, const shmtf_ref *frames, size_t n, uint64_t since, int64_t timeout_ns,
                                   uint64_t *version, shmtf_error *error) {
    error_clear(error);
    shmtf_status st = store_enter(h, error);
    if (st != SHMTF_OK) return st;
    watch w = {.frames = frames, .n = n, .since = since};
    for (size_t i = 0; i < n; i++) {
        name_key key;
        const char *why = frames[i].frame.gen ? NULL : names_key(&key, frames[i].name);
        if (why) return error_set(error, SHMTF_INVALID_ARGUMENT, why, "1 to 127 bytes without a leading '/'");
    }
    int64_t deadline = deadline_after(timeout_ns), poll = 1000000;
    bell *b = NULL;
    for (bool first = true;; first = false) {
        uint32_t seen[BELL_MAX_WAIT];
        if (look(h, &w, version)) return store_leave(h, SHMTF_OK, error);
        if (hint_get(&h->entry) == GUARD_LOST) return store_lost(error);
        int64_t left = deadline == INT64_MAX ? INT64_MAX : deadline - clock_monotonic_ns();
        if (left <= 0) return error_set(error, SHMTF_TIMEOUT, "no change", NULL);
        if (first) b = store_bell(h);
        if (b) {
            watch armed = w;
            bell_arm(b, armed.buckets, armed.n_buckets, seen);
            if (look(h, &w, version)) return store_leave(h, SHMTF_OK, error);
            if (w.n_buckets != armed.n_buckets || memcmp(w.buckets, armed.buckets, w.n_buckets * sizeof *w.buckets)) continue;
        }
        count_add(&h->waits, 1);
        int err = b ? bell_sleep(b, w.buckets, w.n_buckets, seen, left) : clock_sleep_ns(left < poll ? left : poll);
        if (err == EINTR) return error_set(error, SHMTF_INTERRUPTED, "waiting for a change", NULL);
        if (poll < 10000000) poll *= 2;
    }
}
