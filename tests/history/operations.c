/* SPDX-License-Identifier: Apache-2.0 */
#include "operations.h"

#include <sched.h>
#include <string.h>

#include "api/store.h"
#include "core/recover.h"

enum { BATCH = 16, TRANSFER_TRIES = 2000 };
static const shmtf_write_options patient = {.timeout_ns = 200000000};

uint64_t member_random(member *m) {
    m->random ^= m->random << 13;
    m->random ^= m->random >> 7;
    m->random ^= m->random << 17;
    return m->random >> 11;
}
uint64_t member_below(member *m, uint64_t n) { return member_random(m) % n; }

bool member_has_room(const member *m) {
    enum { MOST_AT_ONCE = 8 }; /* a snapshot and what is read in it */
    uint64_t most = sizeof(history_entry) + MOST_ITEMS * sizeof(history_item);
    return atomic_load(&m->all->used[m->n]) + MOST_AT_ONCE * most <= m->all->buffer_bytes;
}

/* ---- the log ----------------------------------------------------------------------------------------------- */

history_entry *log_open(member *m, history_kind kind) {
    history_entry *e = (history_entry *)(void *)(m->buffer + atomic_load(&m->all->used[m->n]));
    memset(e, 0, sizeof *e);
    e->kind = (uint16_t)kind;
    e->status = PENDING;
    e->process = m->process;
    return e;
}
void log_begin(member *m, history_entry *e) {
    e->begin = atomic_fetch_add(&m->all->order, 1);
    e->low = shmtf_commit_version(m->h);
}
void log_publish(member *m, const history_entry *e) { atomic_fetch_add(&m->all->used[m->n], history_size(e)); }
void log_end(member *m, history_entry *e, shmtf_status st) {
    e->high = shmtf_commit_version(m->h);
    e->end = atomic_fetch_add(&m->all->order, 1);
    e->status = (uint16_t)st; /* last: whoever is killed before leaves it pending */
}
static uint64_t handle_of(shmtf_frame f) { return f.gen ? (uint64_t)f.gen << 24 | f.id : 0; }

/* Did the call commit, and as which version?  Not all functions say so; the writer's state does. */
static void note_commit(member *m, history_entry *e, const shmtf_counters *before) {
    shmtf_counters after;
    shmtf_get_counters(m->h, &after);
    if (after.commits == before->commits) return;
    e->flags |= F_COMMITTED | F_VERSION;
    if (!e->version) e->version = state_version(load_acquire(&m->h->s.writers[m->h->contexts[0]->x.slot].state));
}

/* ---- writes ------------------------------------------------------------------------------------------------ */

static int64_t new_stamp(member *m) { return (int64_t)atomic_fetch_add(&m->all->stamp, 1) * TICK; }

typedef struct {
    shmtf_transform t[BATCH];
    uint16_t child[BATCH], parent[BATCH];
    size_t n;
} batch;

static void add(member *m, batch *b, unsigned parent, unsigned child, int64_t stamp, uint32_t flags) {
    size_t i = b->n++;
    b->child[i] = (uint16_t)child;
    b->parent[i] = (uint16_t)parent;
    b->t[i] = (shmtf_transform){shmtf_by_name(m->names[parent]), shmtf_by_name(m->names[child]), stamp, {0, 0, 0, 0, 0, 0, 1}, flags};
    b->t[i].pose.x = (double)m->next_value++;
    b->t[i].pose.y = BANK_AMOUNT;
    if (member_below(m, 2)) { /* a handle that may have gone stale, beside the name */
        b->t[i].child.frame = m->handle[child];
        b->t[i].parent.frame = m->handle[parent];
    }
}

static void write_batch(member *m, batch *b) {
    shmtf_counters before;
    shmtf_error error;
    history_entry *e = log_open(m, OP_SET);
    history_item *item = history_items(e);
    uint64_t version = 0;
    e->n = (uint16_t)b->n;
    for (size_t i = 0; i < b->n; i++) {
        const shmtf_transform *t = &b->t[i];
        uint32_t flags = t->flags & SHMTF_STATIC ? F_STATIC : 0;
        item[i] = (history_item){.child = b->child[i], .parent = b->parent[i], .flags = flags, .stamp = t->stamp_ns, .x = t->pose.x, .y = t->pose.y};
    }
    shmtf_get_counters(m->h, &before);
    log_begin(m, e);
    log_publish(m, e);
    shmtf_status st = shmtf_set_transforms(m->h, b->t, b->n, &patient, &version, &error);
    for (size_t i = 0; i < b->n && st == SHMTF_OK; i++) {
        item[i].child_handle = handle_of(m->handle[b->child[i]] = b->t[i].child.frame);
        item[i].parent_handle = handle_of(m->handle[b->parent[i]] = b->t[i].parent.frame);
    }
    e->version = version;
    e->flags = st == SHMTF_OK ? F_VERSION : 0;
    note_commit(m, e, &before);
    log_end(m, e, st);
}

/* A chain below the world, always as a whole: half of it is a torn read. */
void write_group(member *m) {
    batch b = {.n = 0};
    int64_t stamp = new_stamp(m);
    bool falling = member_below(m, 2);
    for (unsigned i = 0; i < GROUP; i++) {
        unsigned at = FIRST_GROUP + (falling ? GROUP - 1 - i : i);
        add(m, &b, at - 1, at, stamp, 0);
    }
    write_batch(m, &b);
}

void write_bank(member *m) {
    batch b = {.n = 0};
    int64_t stamp = new_stamp(m);
    for (unsigned i = 0; i < BANK; i++) add(m, &b, 0, FIRST_BANK + i, stamp, 0);
    write_batch(m, &b);
    for (unsigned i = 0; i < BANK; i++) m->bank[i] = m->handle[FIRST_BANK + i];
}

static unsigned usual_parent(member *m, unsigned child) {
    if (child < FIRST_BANK) return child - 1;
    if (child < FIRST_FREE) return 0;
    unsigned i = child - FIRST_FREE;
    switch (member_below(m, 3)) {
    case 0: return 0;
    case 1: return FIRST_GROUP + GROUP - 1;
    default: return i ? FIRST_FREE + i / 2 : 0;
    }
}

static unsigned moving_child(member *m) {
    return member_below(m, 2) ? FIRST_GROUP + (unsigned)member_below(m, GROUP) : FIRST_FREE + (unsigned)member_below(m, FREE);
}

static void write_single(member *m) {
    batch b = {.n = 0};
    unsigned child = moving_child(m);
    add(m, &b, usual_parent(m, child), child, new_stamp(m), 0);
    if (!member_below(m, 4)) add(m, &b, b.parent[0], child, b.t[0].stamp_ns + 1, 0);
    write_batch(m, &b);
}

static void write_late(member *m) {
    batch b = {.n = 0};
    int64_t stamp = new_stamp(m) - (int64_t)(1 + member_below(m, member_below(m, 4) ? 8 : 60)) * TICK;
    unsigned first = moving_child(m), n = 1 + (unsigned)member_below(m, 4);
    for (unsigned i = 0; i < n && first + i < N_NAMES; i++)
        if (first + i != FIRST_BANK && (first >= FIRST_FREE || first + i < FIRST_BANK))
            add(m, &b, usual_parent(m, first + i), first + i, stamp, 0);
    write_batch(m, &b);
}

/* Any parent: births, cycles, edges that come and go. */
static void write_shape(member *m) {
    batch b = {.n = 0};
    int64_t stamp = new_stamp(m);
    unsigned first = (unsigned)member_below(m, FREE), n = 1 + (unsigned)member_below(m, 3);
    uint32_t flags = member_below(m, 4) ? 0 : SHMTF_STATIC;
    for (unsigned i = 0; i < n; i++) {
        unsigned child = (first + i) % FREE, parent = (child + 1 + (unsigned)member_below(m, FREE - 1)) % FREE;
        add(m, &b, member_below(m, 8) ? FIRST_FREE + parent : 0, FIRST_FREE + child, stamp, flags);
    }
    write_batch(m, &b);
}

/* The last batch once more: records that are there already are not written again. */
static void write_again(member *m) {
    batch b = {.n = 0};
    unsigned child = FIRST_FREE + (unsigned)member_below(m, FREE);
    add(m, &b, usual_parent(m, child), child, new_stamp(m), member_below(m, 4) ? 0 : SHMTF_STATIC);
    write_batch(m, &b);
    write_batch(m, &b);
}

static void remove_one(member *m) {
    shmtf_counters before;
    shmtf_error error;
    history_entry *e = log_open(m, OP_REMOVE);
    e->target = (uint16_t)(FIRST_FREE + member_below(m, FREE));
    shmtf_get_counters(m->h, &before);
    log_begin(m, e);
    log_publish(m, e);
    shmtf_status st = shmtf_remove_frame(m->h, shmtf_by_name(m->names[e->target]), &patient, &error);
    note_commit(m, e, &before);
    log_end(m, e, st);
}

static void clear_all(member *m) {
    shmtf_counters before;
    shmtf_error error;
    history_entry *e = log_open(m, OP_CLEAR);
    e->flags = member_below(m, 2) ? F_KEEP_STATIC : 0;
    shmtf_get_counters(m->h, &before);
    log_begin(m, e);
    log_publish(m, e);
    shmtf_status st = shmtf_clear(m->h, e->flags & F_KEEP_STATIC, &patient, &error);
    note_commit(m, e, &before);
    log_end(m, e, st);
}

/* ---- read, then write: the core's transaction with a read under its locks ----------------------------------------- */

/* False: an account has no record. */
static bool stage_transfer(member *m, txn *x, history_entry *e) {
    ring_record old[BANK];
    history_item *item = history_items(e);
    int64_t stamp = new_stamp(m);
    for (unsigned i = 0; i < e->n; i++) {
        shmtf_frame frame = m->bank[item[i].child - FIRST_BANK];
        ring_newest_locked(x->s, &txn_entry_for(x, frame.id)->w, &old[i]);
        if (!old[i].position || info_kind(old[i].info) != KIND_DYNAMIC || !tree_record_counts(&x->clears, &old[i])) return false;
        if (old[i].stamp >= stamp) stamp = old[i].stamp + 1;
    }
    for (unsigned i = 0; i < e->n; i++) { /* one gives one to the next, the last to the first */
        ring_record r = {.stamp = stamp, .arrival = 1, .parent = old[i].parent, .info = info_make(0, KIND_DYNAMIC, 0, 0)};
        r.pose = (shmtf_pose){(double)m->next_value++, old[i].pose.y + (i == 0) - (i == 1), 0, 0, 0, 0, 1};
        item[i].seen_x = old[i].pose.x;
        item[i].seen_y = old[i].pose.y;
        item[i].stamp = stamp;
        item[i].x = r.pose.x;
        item[i].y = r.pose.y;
        txn_entry *t = txn_entry_for(x, m->bank[item[i].child - FIRST_BANK].id);
        if (ring_put_locked(x->s, &t->w, &r, false, true) != PUT_OK) return false;
        x->n_staged++;
    }
    return true;
}

static shmtf_status transfer_once(member *m, write_context *c, history_entry *e, const uint32_t *id) {
    txn *x = &c->x;
    shmtf_store *h = m->h;
    txn_status st = txn_begin(x);
    if (st == TXN_LOST) return store_lose(h, c), SHMTF_CLOSED;
    if (st == TXN_OK) st = txn_lock_all(x, id, e->n);
    while (st == TXN_HELD && lock_owned(x->blocked_by) && !peer_alive(h->query_fd, &h->file, lock_slot(x->blocked_by))) {
        recover_dead(x->s, x->blocked_id, x->blocked_by);
        st = txn_lock_all(x, id, e->n);
    }
    if (st != TXN_OK) return txn_abort(x), st == TXN_CORRUPT ? SHMTF_CORRUPT : SHMTF_BUSY;
    if (!stage_transfer(m, x, e)) return txn_abort(x), SHMTF_LOOKUP;
    st = txn_commit(x, &e->version);
    if (st == TXN_LOST) return store_lose(h, c), SHMTF_CLOSED;
    return st == TXN_OK ? SHMTF_OK : st == TXN_CORRUPT ? SHMTF_CORRUPT : SHMTF_BUSY;
}

static void transfer(member *m) {
    write_context *c;
    shmtf_error error;
    history_entry *e = log_open(m, OP_TRANSFER);
    history_item *item = history_items(e);
    uint32_t id[BANK];
    unsigned first = (unsigned)member_below(m, BANK), stride = 1 + 2 * (unsigned)member_below(m, 4);
    e->n = (uint16_t)(2 + member_below(m, 3));
    for (unsigned i = 0; i < e->n; i++) {
        unsigned k = (first + i * stride) % BANK; /* BANK is a power of two and the stride odd: all different */
        if (!m->bank[k].gen) return;
        item[i] = (history_item){.child = (uint16_t)(FIRST_BANK + k), .child_handle = handle_of(m->bank[k])};
        unsigned at = i;
        for (; at && id[at - 1] > m->bank[k].id; at--) id[at] = id[at - 1];
        id[at] = m->bank[k].id;
    }
    log_begin(m, e);
    log_publish(m, e);
    shmtf_status st = SHMTF_BUSY;
    for (int tries = 0; tries < TRANSFER_TRIES && st == SHMTF_BUSY; tries++) {
        if (tries) sched_yield();
        st = store_enter(m->h, &error) || store_take(m->h, &c, &error) ? SHMTF_CLOSED : transfer_once(m, c, e, id);
        if (st != SHMTF_CLOSED) store_give(c);
    }
    e->flags = st == SHMTF_OK ? F_COMMITTED | F_VERSION : 0;
    log_end(m, e, st == SHMTF_OK || st == SHMTF_CORRUPT ? st : SHMTF_BUSY);
}

void write_something(member *m) {
    uint64_t what = member_below(m, 2048);
    if (what < 1) clear_all(m);
    else if (what < 12) write_bank(m);
    else if (what < 700) write_group(m);
    else if (what < 1100) write_single(m);
    else if (what < 1400) transfer(m);
    else if (what < 1450) write_again(m);
    else if (what < 1700) write_late(m);
    else if (what < 1950) write_shape(m);
    else remove_one(m);
}
