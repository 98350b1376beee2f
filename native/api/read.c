/* SPDX-License-Identifier: Apache-2.0
 *
 * Lookups: take a commit, look, take a newer one if the rings have moved on; wait for the missing edge if asked to.
 */
#include <errno.h>

#include "api/store.h"

/* A fresh S is tried this often before a history is called too small for its writers. */
enum { SNAPSHOT_TRIES = 1000 };

shmtf_snapshot shmtf_take_snapshot(shmtf_store *store) {
    shmtf_snapshot s = {0};
    if (store_enter(store, NULL) == SHMTF_OK) s.word = load_seq_cst(&store->s.global->commit); /* [E2 acquire] [E9 seq_cst] */
    return s;
}

uint64_t shmtf_snapshot_version(shmtf_snapshot snapshot) { return commit_version(snapshot.word); }

shmtf_status store_find(shmtf_store *h, uint64_t snapshot, const shmtf_ref *ref, shmtf_frame *frame, bool *again, shmtf_error *e) {
    name_key key;
    ring_status st;
    if (ref->frame.gen) {
        *frame = ref->frame;
        return SHMTF_OK; /* the walk finds out whether it exists */
    }
    const char *why = names_key(&key, ref->name);
    if (why) return error_set(e, SHMTF_INVALID_ARGUMENT, why, "1 to 127 bytes without a leading '/'");
    for (int i = 0; i < SNAPSHOT_TRIES; i++)
        if ((st = names_find(&h->s, snapshot, &key, frame)) != RING_AGAIN) break;
    if (st == RING_OK) return SHMTF_OK;
    if (st == RING_CORRUPT) return error_set(e, SHMTF_CORRUPT, "a frame's ring", "shmtf check NAME says more");
    *again = st != RING_NONE;
    if (!*again) error_frame(e, h, NULL, ref);
    return error_set(e, SHMTF_LOOKUP, "the frame does not exist", NULL);
}

typedef enum { TIME_LATEST, TIME_COMMON, TIME_AT } time_mode;

typedef struct {
    shmtf_ref target, source;
    time_mode mode;
    int64_t time;
    shmtf_result *result;
    shmtf_error *e;
    unsigned bucket; /* out, on failure: what would ring if the answer could change */
} query;

static shmtf_status fail_edge(shmtf_store *h, query *q, const lookup *l, shmtf_status st) {
    const shmtf_ref child = {NULL, l->failed}, parent = {NULL, l->failed_parent};
    q->bucket = bell_bucket(l->failed.id);
    if (error_open(q->e)) {
        q->e->requested_ns = l->time;
        q->e->oldest_ns = l->edge_oldest;
        q->e->newest_ns = l->edge_newest;
        q->e->has_times = 7;
    }
    error_frame(q->e, h, &parent, &child);
    return error_set(q->e, st, "edge", NULL);
}

static shmtf_status fail(shmtf_store *h, query *q, const lookup *l, lookup_status st) {
    q->bucket = BELL_SHAPE;
    switch (st) {
    case LOOKUP_NO_TARGET: error_frame(q->e, h, NULL, &q->target); break;
    case LOOKUP_NO_SOURCE: error_frame(q->e, h, NULL, &q->source); break;
    case LOOKUP_BACKWARD: return fail_edge(h, q, l, SHMTF_BACKWARD);
    case LOOKUP_FORWARD: return fail_edge(h, q, l, SHMTF_FORWARD);
    case LOOKUP_SINGLE: return fail_edge(h, q, l, SHMTF_NO_DATA);
    case LOOKUP_LOOP:
    case LOOKUP_DISCONNECTED:
        error_frame(q->e, h, &q->target, &q->source);
        return error_set(q->e, SHMTF_CONNECTIVITY, st == LOOKUP_LOOP ? "the tree has a loop at that time" : "", NULL);
    default: return error_set(q->e, SHMTF_CORRUPT, "a frame's ring", "shmtf check NAME says more");
    }
    return error_set(q->e, SHMTF_LOOKUP, "the frame does not exist", NULL);
}

static void succeed(query *q, const lookup *l) {
    shmtf_result *r = q->result;
    if (!r) return;
    r->pose = l->pose;
    r->all_static = l->n_dynamic == 0;
    r->oldest_ns = l->n_dynamic ? l->oldest : 0;
    r->newest_ns = l->n_dynamic ? l->newest : 0;
    r->stamp_ns = r->oldest_ns;
    if (l->at_time && l->n_dynamic) r->stamp_ns = r->oldest_ns = r->newest_ns = l->time;
    if (q->mode == TIME_AT) {
        r->stamp_ns = q->time;
        if (r->all_static) r->oldest_ns = r->newest_ns = q->time;
    }
    r->version = commit_version(l->snapshot);
    r->n_edges = l->n_edges;
}

static lookup_status run_lookup(query *q, lookup *l) {
    lookup_status got = lookup_run(l);
    if (got != LOOKUP_OK || q->mode != TIME_COMMON || !l->n_dynamic || l->oldest == l->newest) return got;
    l->at_time = true; /* the newest common time is the oldest of the newest */
    l->time = l->oldest;
    return lookup_run(l);
}

/* A handle, or the frame that most likely has the name. */
static bool guess(const shmtf_store *h, const shmtf_ref *ref, shmtf_frame *frame) {
    name_key key;
    *frame = ref->frame;
    return frame->gen || (!names_key(&key, ref->name) && names_guess(&h->s, &key, frame));
}

/* Once, at one commit.  *again: take a newer one. */
static shmtf_status look(shmtf_store *h, query *q, uint64_t snapshot, bool *again) {
    lookup l; /* not zeroed: the walk sets what it reports */
    l.s = &h->s;
    l.depth = h->depth;
    l.above = h->above;
    l.snapshot = snapshot;
    l.at_time = q->mode == TIME_AT;
    l.poseless = !q->result;
    l.time = q->time;
    l.edges = q->result ? q->result->edges : NULL;
    l.max_edges = l.edges ? q->result->max_edges : 0;
    *again = false;
    /* A walk that succeeds has seen that both frames exist at S; only if it fails, their names are looked up with care. */
    lookup_status got = guess(h, &q->target, &l.target) && guess(h, &q->source, &l.source) ? run_lookup(q, &l) : LOOKUP_NO_SOURCE;
    if (got != LOOKUP_OK && got != LOOKUP_OLD) {
        q->bucket = BELL_SHAPE;
        shmtf_status st = store_find(h, snapshot, &q->target, &l.target, again, q->e);
        if (st == SHMTF_OK) st = store_find(h, snapshot, &q->source, &l.source, again, q->e);
        if (st != SHMTF_OK) return st;
        l.at_time = q->mode == TIME_AT;
        l.time = q->time;
        got = run_lookup(q, &l);
    }
    if (got == LOOKUP_OLD) return *again = true, SHMTF_OK;
    if (got != LOOKUP_OK) return fail(h, q, &l, got);
    succeed(q, &l);
    return SHMTF_OK;
}

static shmtf_status look_until_stable(shmtf_store *h, query *q, const shmtf_snapshot *snapshot) {
    for (int i = 0; i < SNAPSHOT_TRIES; i++) {
        bool again;
        uint64_t s = snapshot ? snapshot->word : load_seq_cst(&h->s.global->commit); /* [E2 acquire] [E9 seq_cst] */
        shmtf_status st = look(h, q, s, &again);
        if (!again) return st;
        error_clear(q->e); /* what it says is about a commit that was too old */
        if (snapshot) break;
        count_add(&h->restarts, 1);
    }
    return error_set(q->e, SHMTF_SNAPSHOT_EXPIRED, "the records of that commit were overwritten",
                     snapshot ? "take a new snapshot, or create the store with a larger history" : "create the store with a larger history");
}

static bool may_come(shmtf_status st) {
    return st == SHMTF_LOOKUP || st == SHMTF_CONNECTIVITY || st == SHMTF_BACKWARD || st == SHMTF_FORWARD || st == SHMTF_NO_DATA;
}

/* Sleep until the failed query's bucket rings, look again. */
static shmtf_status look_waiting(shmtf_store *h, query *q, shmtf_status st, int64_t deadline) {
    bell *b = store_bell(h);
    int64_t poll = 1000000;
    while (may_come(st)) {
        uint32_t seen;
        unsigned bucket = q->bucket;
        if (b) {
            bell_arm(b, &bucket, 1, &seen);
            error_clear(q->e);
            st = look_until_stable(h, q, NULL);
            if (!may_come(st) || q->bucket != bucket) continue; /* another edge is missing now: announce there */
        }
        int64_t left = deadline == INT64_MAX ? INT64_MAX : deadline - clock_monotonic_ns();
        if (left <= 0) return st;
        count_add(&h->waits, 1);
        int err = b ? bell_sleep(b, &bucket, 1, &seen, left) : clock_sleep_ns(left < poll ? left : poll);
        if (err == EINTR) return error_set(q->e, SHMTF_INTERRUPTED, "waiting for a transform", NULL);
        if (hint_get(&h->entry) == GUARD_LOST) break;
        if (poll < 10000000) poll *= 2;
        error_clear(q->e);
        st = look_until_stable(h, q, NULL);
    }
    return st;
}

static shmtf_status run_query(shmtf_store *h, query *q, const shmtf_snapshot *snapshot, int64_t timeout_ns) {
    shmtf_status st = store_enter(h, q->e);
    if (st != SHMTF_OK) return st;
    st = look_until_stable(h, q, snapshot);
    if (timeout_ns != 0 && !snapshot && may_come(st)) st = look_waiting(h, q, st, deadline_after(timeout_ns));
    return store_leave(h, st, q->e);
}

shmtf_status shmtf_lookup_transform(shmtf_store *store, const shmtf_snapshot *snapshot, shmtf_ref target, shmtf_ref source,
                                    const int64_t *time_ns, int64_t timeout_ns, shmtf_result *result, shmtf_error *error) {
    error_clear(error);
    query q = {target, source, time_ns ? TIME_AT : TIME_COMMON, time_ns ? *time_ns : 0, result, error, 0};
    return run_query(store, &q, snapshot, timeout_ns);
}

shmtf_status shmtf_lookup_latest_transform(shmtf_store *store, const shmtf_snapshot *snapshot, shmtf_ref target, shmtf_ref source,
                                           int64_t timeout_ns, shmtf_result *result, shmtf_error *error) {
    error_clear(error);
    query q = {target, source, TIME_LATEST, 0, result, error, 0};
    return run_query(store, &q, snapshot, timeout_ns);
}

shmtf_status shmtf_latest_common_time(shmtf_store *store, const shmtf_snapshot *snapshot, shmtf_ref target, shmtf_ref source,
                                      int64_t *time_ns, int *has_time, shmtf_error *error) {
    error_clear(error);
    shmtf_result r = {.edges = NULL};
    query q = {target, source, TIME_LATEST, 0, &r, error, 0};
    shmtf_status st = run_query(store, &q, snapshot, 0);
    *has_time = st == SHMTF_OK && !r.all_static;
    *time_ns = *has_time ? r.oldest_ns : 0;
    return st;
}
