/* SPDX-License-Identifier: Apache-2.0
 *
 * The policy around transactions: who is asked for, how long, and in which order of politeness.
 *
 * NoWait first: at a conflict spin a little (most holders are gone within a microsecond), then release everything and
 * come again later.  After POLITE_ATTEMPTS, or at once with priority, push: keep the locks, wait for the next in id
 * order, and announce it.  Deadlock is impossible: whoever holds and waits, waits upwards.
 *
 * A wish is a courtesy, never a lock: who meets an ordinary one comes again once, who meets one with priority lets go of
 * everything and waits for it, but once a wish and for some milliseconds at most, since its owner may be stopped, and some
 * times an operation at most.  A wish that was waited for in vain is taken away.
 */
#include <errno.h>
#include <sched.h>
#include <stdlib.h>

#include "api/store.h"
#include "core/recover.h"

enum {
    SPIN_PAUSES = 200,
    POLITE_ATTEMPTS = 8,
    FREE_RETRIES = 64,
    PUSH_YIELDS = 16, /* a holder that is not running needs the processor more than we need sleep */
    PUSH_SLEEP_NS = 50000,
    COURTESY_SLEEPS = 14, /* from PUSH_SLEEP_NS to MAX_BACKOFF_NS each: some 10 ms, in which a crowded machine runs everybody */
    MOST_COURTESIES = 8,  /* an operation: those with priority may be many */
    MAX_BACKOFF_NS = 1000000
};

typedef enum { WRITE_SET, WRITE_DECLARE, WRITE_REMOVE, WRITE_CLEAR } write_kind;

typedef struct {
    write_kind kind;
    const char *name;   /* declare */
    unsigned ring_log2; /* declare */
    shmtf_ref *ref;     /* remove */
    bool keep_static;   /* clear */
    stage g;
    int64_t deadline; /* valid once first_busy_ns is set */
    int64_t first_busy_ns;
    int pushes, courtesies;
    const shmtf_write_options *options;
    shmtf_error *e;
} write_job;

static stage_status run_stage(write_job *j) {
    switch (j->kind) {
    case WRITE_SET: return stage_transforms(&j->g);
    case WRITE_DECLARE: return stage_declare(&j->g, j->name, j->ring_log2);
    case WRITE_REMOVE: return stage_remove(&j->g, j->ref);
    default: return stage_clear(&j->g, j->keep_static);
    }
}

/* Is what blocked us still there? */
static bool still_blocked(const shmtf_store *h, const txn *x) {
    const shmtf_frame_words_t *f = &h->s.frames[x->blocked_id];
    return load_acquire(x->wished ? &f->want : &f->lock) == x->blocked_by;
}

typedef enum { GO_ON, GIVE_UP, BACK_OFF, SIGNALLED } verdict;

/* The time-out runs from the first conflict on. */
static bool in_time(write_job *j) {
    int64_t now = clock_monotonic_ns();
    if (!j->first_busy_ns) {
        j->first_busy_ns = now;
        j->deadline = deadline_after(j->options ? j->options->timeout_ns : 0);
    }
    return now < j->deadline;
}

/* Children are locked in id order, but a birth takes any free frame: that must not wait below what is held. */
static bool waits_upwards(const txn *x) {
    for (size_t i = 0; i < x->n; i++)
        if (x->entries[i].w.id >= x->blocked_id) return false;
    return true;
}

/* A frame is held: spin, see whether its holder lives, recover what the dead left, or wait if we push. */
static verdict negotiate(shmtf_store *h, write_context *c, write_job *j) {
    txn *x = &c->x;
    unsigned slot = lock_slot(x->blocked_by);
    for (int i = 0; i < SPIN_PAUSES && still_blocked(h, x); i++) cpu_relax();
    if (!lock_owned(x->blocked_by) || !still_blocked(h, x)) return GO_ON;
    if (slot >= h->s.geo.max_writers) return GIVE_UP;
    if (!peer_alive(h->query_fd, &h->file, slot)) {
        shmtf_word *want = &h->s.frames[x->blocked_id].want;
        if (load_acquire(want) == x->blocked_by) cas_acq_rel(want, x->blocked_by, 0);
        recover_dead(&h->s, x->blocked_id, x->blocked_by);
        x->recoveries++;
        return GO_ON;
    }
    if (!x->pushing || x->n_staged || !waits_upwards(x) || x->wished || !in_time(j)) return BACK_OFF;
    txn_want(x, x->blocked_id);
    if (j->pushes++ < PUSH_YIELDS) return sched_yield(), GO_ON;
    return clock_sleep_ns(PUSH_SLEEP_NS) == EINTR ? SIGNALLED : GO_ON;
}

/* A wish was in the way, and nothing is held any more.  Once is polite, whatever the time-out; one with priority is waited
 * for. */
static verdict be_courteous(const shmtf_store *h, txn *x, write_job *j) {
    if (!wish_first(x->blocked_by)) return GO_ON;
    int64_t nap = PUSH_SLEEP_NS;
    int i = 0;
    for (; i < COURTESY_SLEEPS && still_blocked(h, x) && in_time(j); i++, nap *= 2) {
        if (nap > MAX_BACKOFF_NS) nap = MAX_BACKOFF_NS;
        if (clock_sleep_ns(nap) == EINTR) return SIGNALLED;
    }
    /* It seems to be stopped.  If it is not, it says its wish again; else two such wishes would hold us up by turns, each time. */
    if (i == COURTESY_SLEEPS) cas_acq_rel(&h->s.frames[x->blocked_id].want, x->blocked_by, 0);
    x->deferred_to = x->blocked_by;
    x->defers = ++j->courtesies < MOST_COURTESIES && in_time(j);
    return GO_ON;
}

/* After x has committed, having locked n frames. */
static void wake_waiters(bell *b, const txn *x, size_t n) {
    bell_set touched = {{1ull << BELL_ANY}};
    for (size_t i = 0; i < n; i++) bell_add(&touched, bell_bucket(x->entries[i].w.id));
    if (x->reshapes) memset(&touched, 0xff, sizeof touched);
    bell_ring(b, &touched);
}

/* One transaction: stage until it is through or hopeless. */
static stage_status attempt(shmtf_store *h, write_context *c, write_job *j, uint64_t *version, verdict *v) {
    txn *x = &c->x;
    uint32_t wanted = UINT32_MAX;
    *v = GO_ON;
    txn_status begun = txn_begin(x);
    if (begun == TXN_LOST) return store_lose(h, c), STAGE_RETRY;
    if (begun != TXN_OK) return begun == TXN_RETRY ? STAGE_RETRY : STAGE_CORRUPT;
    stage_status st = run_stage(j);
    while (st == STAGE_HELD) {
        uint32_t id = x->blocked_id;
        *v = negotiate(h, c, j);
        if (wanted != UINT32_MAX && wanted != id) txn_unwant(x, wanted);
        wanted = id;
        if (*v != GO_ON) break;
        st = run_stage(j);
    }
    if (wanted != UINT32_MAX) txn_unwant(x, wanted);
    if (st != STAGE_OK) {
        bool births = x->reshapes;
        txn_abort(x);
        if (births) stage_forget_unborn(&j->g);
        return st;
    }
    if (!x->n_staged && !x->reshapes) return txn_commit_nothing(x, version) == TXN_OK ? STAGE_OK : STAGE_RETRY;
    size_t n = x->n;
    txn_status done = txn_commit(x, version);
    if (done == TXN_LOST) store_lose(h, c);
    if (done != TXN_OK) stage_forget_unborn(&j->g);
    if (done != TXN_OK) return done == TXN_CORRUPT ? STAGE_CORRUPT : STAGE_RETRY;
    count_add(&h->commits, 1);
    bell *b = store_has_bell(h);
    if (b && bell_is_armed(b)) wake_waiters(b, x, n);
    return STAGE_OK;
}

static verdict back_off(write_context *c, int n) {
    if (n < 2) return sched_yield(), GO_ON;
    c->random = c->random * 6364136223846793005ull + 1442695040888963407ull;
    uint64_t most = n < 9 ? 4000ull << n : MAX_BACKOFF_NS;
    return clock_sleep_ns((int64_t)((c->random >> 33) % most) + 1) == EINTR ? SIGNALLED : GO_ON;
}

static shmtf_status invalid(write_job *j, const char *what, const char *hint) {
    return error_set(j->e, SHMTF_INVALID_ARGUMENT, what, hint);
}

static shmtf_status full(write_job *j, uint64_t limit, uint64_t needed, const char *what, const char *hint) {
    if (error_open(j->e)) {
        j->e->limit = limit;
        j->e->needed = needed;
    }
    return error_set(j->e, SHMTF_FULL, what, hint);
}

static shmtf_status refuse_times(write_job *j, const shmtf_transform *t) {
    if (error_open(j->e)) {
        j->e->requested_ns = t->stamp_ns;
        j->e->newest_ns = j->g.newest;
        j->e->has_times = 5;
    }
    return error_set(j->e, SHMTF_OLD_DATA, "stamp", "a larger cache_time keeps older data; clear() after a jump back in time");
}

/* From a refusal to an error with its details. */
static shmtf_status refuse(shmtf_store *h, write_job *j, stage_status st) {
    const stage *g = &j->g;
    const shmtf_transform *t = g->n ? &g->items[g->item < g->n ? g->item : g->n - 1] : NULL;
    if (error_open(j->e) && t) {
        j->e->item = (size_t)(t - g->items);
        error_frame(j->e, h, &t->parent, &t->child);
    } else if (error_open(j->e)) {
        const shmtf_ref named = {j->name, {0, 0}};
        error_frame(j->e, h, NULL, j->ref ? j->ref : &named);
    }
    switch (st) {
    case STAGE_FULL_FRAMES: return full(j, h->s.geo.max_frames, h->s.geo.max_frames + 1, "max_frames", "create the store with a larger max_frames");
    case STAGE_FULL_NAMES: return full(j, h->s.geo.n_buckets, 0, "name table", "create the store with a larger max_frames");
    case STAGE_FULL_ARENA: return full(j, h->s.geo.stream_bytes, 0, "stream_bytes", "create the store with a larger stream_bytes, or a smaller history");
    case STAGE_BAD_NAME: return invalid(j, g->what, "1 to 127 bytes of UTF-8 without a leading '/'");
    case STAGE_BAD_POSE:
        if (error_open(j->e)) j->e->value = g->value;
        return invalid(j, g->what, "finite numbers, and a quaternion x y z w with a norm within 0.5 % of 1");
    case STAGE_SELF: return invalid(j, "parent and child are the same frame", NULL);
    case STAGE_MIXED: return invalid(j, "one frame both static and dynamic in one batch", "write them one after the other");
    case STAGE_TOO_MANY:
        if (error_open(j->e)) j->e->limit = g->limit;
        return invalid(j, "too many records for one frame in one batch", "split the batch, or declare the frame with a larger history");
    case STAGE_DECLARED:
        if (error_open(j->e)) j->e->limit = g->limit;
        return invalid(j, "the frame has a history of another size already", "declare it before its first record, or remove it first");
    case STAGE_OLD_DATA: return refuse_times(j, t);
    case STAGE_CYCLE: return error_set(j->e, SHMTF_CYCLE, "the new parent is a descendant of the frame", NULL);
    case STAGE_GONE: return error_set(j->e, SHMTF_LOOKUP, "the frame does not exist", NULL);
    default: return error_set(j->e, SHMTF_CORRUPT, "a word in the segment is impossible", "shmtf check NAME says more");
    }
}

static shmtf_status busy(shmtf_store *h, write_context *c, write_job *j, bool was_held) {
    if (!was_held) return error_set(j->e, SHMTF_CONFLICT, "the tree's shape kept changing", "try again, or allow more time");
    if (error_open(j->e)) {
        const shmtf_ref ref = {NULL, {c->x.blocked_id, names_gen(&h->s, c->x.blocked_id)}};
        error_frame(j->e, h, NULL, &ref);
        error_holder(j->e, h, lock_slot(c->x.blocked_by));
        j->e->value = j->first_busy_ns ? (double)(clock_monotonic_ns() - j->first_busy_ns) * 1e-9 : 0;
    }
    return error_set(j->e, SHMTF_BUSY, "frame", "wait longer, or look at its holder: it may be stopped");
}

static void count_work(shmtf_store *h, txn *x, int aborts) {
    if (aborts) count_add(&h->aborts, (uint64_t)aborts);
    if (x->helps) count_add(&h->helps, x->helps);
    if (x->recoveries) count_add(&h->recoveries, x->recoveries);
    if (x->late_dropped) count_add(&h->late_dropped, x->late_dropped);
    if (x->repeats) count_add(&h->repeats, x->repeats);
    x->helps = x->recoveries = x->late_dropped = x->repeats = 0;
}

/* Attempts until one is through, refused, or out of time. */
static shmtf_status attempts(shmtf_store *h, write_context *c, write_job *j, uint64_t *version) {
    bool priority = j->options && j->options->priority;
    c->x.priority = priority;
    c->x.defers = !priority;
    for (int n = 0, retries = 0;;) {
        verdict v;
        c->x.yields = n == 0 && !priority;
        c->x.pushing = n >= POLITE_ATTEMPTS || priority;
        c->x.n_staged = 0;
        stage_status st = attempt(h, c, j, version, &v);
        bool retry = st == STAGE_RETRY, was_held = st == STAGE_HELD;
        count_work(h, &c->x, retry || was_held);
        if (st == STAGE_OK) return SHMTF_OK;
        if (!retry && !was_held) return refuse(h, j, st);
        if (v == GIVE_UP) return refuse(h, j, STAGE_CORRUPT);
        if (v == SIGNALLED) return error_set(j->e, SHMTF_INTERRUPTED, "waiting for a frame", NULL);
        if (retry && ++retries < FREE_RETRIES) continue; /* somebody else committed: that is progress */
        bool wished = was_held && c->x.wished;
        if (!wished && !in_time(j)) return busy(h, c, j, was_held);
        v = wished ? be_courteous(h, &c->x, j) : back_off(c, n);
        if (v == SIGNALLED) return error_set(j->e, SHMTF_INTERRUPTED, "waiting for a frame", NULL);
        n++;
    }
}

static bool grow_order(write_context *c, size_t n) {
    if (n <= c->order_room) return true;
    uint32_t *order = realloc(c->order, n * 2 * sizeof *order);
    if (!order) return false;
    c->order = order;
    c->order_room = n * 2;
    return true;
}

static shmtf_status run(shmtf_store *h, write_job *j, uint64_t *version) {
    uint64_t ignored;
    write_context *c;
    shmtf_status st = store_enter(h, j->e);
    if (st != SHMTF_OK) return st;
    if (h->readonly) return error_set(j->e, SHMTF_READ_ONLY, "the store is attached read-only", "attach it without readonly to write");
    stage_status checked = j->kind == WRITE_SET ? stage_check(&j->g) : STAGE_OK;
    if (checked != STAGE_OK) return refuse(h, j, checked);
    if (!store_has_bell(h)) store_bell(h);
    st = store_take(h, &c, j->e);
    if (st != SHMTF_OK) return store_leave(h, st, j->e);
    j->g.x = &c->x;
    j->g.arrival_ns = j->options && j->options->arrival_ns ? j->options->arrival_ns : clock_realtime_ns();
    j->g.writer = store_authority(h, j->options ? j->options->authority : NULL);
    if (grow_order(c, j->g.n)) {
        j->g.order = c->order;
        st = attempts(h, c, j, version ? version : &ignored);
    } else {
        st = error_system(j->e, SHMTF_SYSTEM, ENOMEM, "process memory", NULL);
    }
    store_give(c);
    return store_leave(h, st, j->e);
}

shmtf_status shmtf_set_transforms(shmtf_store *store, shmtf_transform *transforms, size_t n, const shmtf_write_options *options,
                                  uint64_t *version, shmtf_error *error) {
    error_clear(error);
    write_job j = {.kind = WRITE_SET, .options = options, .e = error, .g = {.items = transforms, .n = n}};
    return run(store, &j, version);
}

shmtf_status shmtf_declare_frame(shmtf_store *store, const char *name, uint32_t history, const shmtf_write_options *options,
                                 shmtf_error *error) {
    error_clear(error);
    write_job j = {.kind = WRITE_DECLARE, .options = options, .e = error, .name = name, .ring_log2 = shmtf_ring_log2_for(history)};
    if (!history || !j.ring_log2) return error_set(error, SHMTF_INVALID_ARGUMENT, "history", "between 1 and 3932160 records");
    return run(store, &j, NULL);
}

shmtf_status shmtf_remove_frame(shmtf_store *store, shmtf_ref frame, const shmtf_write_options *options, shmtf_error *error) {
    error_clear(error);
    write_job j = {.kind = WRITE_REMOVE, .options = options, .e = error, .ref = &frame};
    return run(store, &j, NULL);
}

shmtf_status shmtf_clear(shmtf_store *store, int keep_static, const shmtf_write_options *options, shmtf_error *error) {
    error_clear(error);
    write_job j = {.kind = WRITE_CLEAR, .options = options, .e = error, .keep_static = keep_static != 0};
    return run(store, &j, NULL);
}
