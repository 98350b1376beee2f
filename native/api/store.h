/* SPDX-License-Identifier: Apache-2.0
 *
 * The handle behind shmtf.h, shared by the files of this folder.
 */
#ifndef SHMTF_API_STORE_H
#define SHMTF_API_STORE_H

#include <pthread.h>

#include "core/lookup.h"
#include "core/stage.h"
#include "segment/guard.h"
#include "segment/map.h"
#include "segment/peer.h"
#include "segment/wait.h"

enum { MAX_CONTEXTS = 64 };

/* What one thread needs to write: a claimed slot, and memory that transactions work in. */
typedef struct {
    local_flag taken;
    void *anchor;
    txn x;
    uint32_t *order;
    size_t order_room;
    uint64_t random;
} write_context;

struct shmtf_store {
    shmtf_segment s;
    void *base;
    map_file file;
    int query_fd; /* O_RDONLY: asks who lives, and reopens the file; its number may be stolen by a careless daemon */
    bool readonly;
    uint64_t uuid[2];
    char writer[SHMTF_HOLDER_SIZE];
    unsigned forks; /* peer_fork_count() when the mappings were made */
    local_hint entry; /* the same; GUARD_LOST once the file was cut short */
    pthread_mutex_t mutex; /* over making contexts, the bell and the authority */
    write_context *contexts[MAX_CONTEXTS];
    local_flag n_contexts;
    local_hint *depth, *above; /* see core/lookup.h */
    local_hint64 *checked;
    bell *bell_map;
    local_flag has_bell; /* bell_map is there, and stays */
    int64_t bell_retry_ns;
    local_flag authority; /* index of `writer` among the authorities; -1: not interned yet */
    local_count commits, aborts, helps, recoveries, rereads, restarts, waits, late_dropped, repeats;
};

/* First in every call: a forked child gets mappings of its own, and a handle whose file was cut short is of no more use. */
shmtf_status store_enter_slowly(shmtf_store *h, shmtf_error *e);
static inline shmtf_status store_enter(shmtf_store *h, shmtf_error *e) {
    return hint_get_acquire(&h->entry) == peer_fork_count() ? SHMTF_OK : store_enter_slowly(h, e);
}
/* Last in a call, since its answer may have come from a lost mapping: `status`, or CORRUPT.  A success, too: another thread
 * of this handle may have been writing when the file was cut, and made frames of its own in the zeros. */
shmtf_status store_lost(shmtf_error *e);
static inline shmtf_status store_leave(const shmtf_store *h, shmtf_status status, shmtf_error *e) {
    return hint_get(&h->entry) == GUARD_LOST ? store_lost(e) : status;
}
/* The bell, opened or made; NULL if that may not be now.  Tried again a second later: memory or descriptors may be there then,
 * and a writer without it delays those who wait. */
bell *store_bell(shmtf_store *h);
static inline bell *store_has_bell(shmtf_store *h) { return flag_get(&h->has_bell) ? h->bell_map : NULL; }

/* Take a context for this thread; claims a slot if all are in use.  Give it back with store_give. */
shmtf_status store_take(shmtf_store *h, write_context **c, shmtf_error *e);
static inline void store_give(write_context *c) { flag_give(&c->taken); }
/* The slot was taken from us: drop its claim, so that the next take claims another. */
void store_lose(shmtf_store *h, write_context *c);
uint16_t store_authority(shmtf_store *h, const char *name);

/* Errors.  e may be NULL.  Clearing sets the status alone, so that success is cheap; whoever sets a field of an error
 * opens it first, which zeroes the rest once.  Setters return `status`. */
static inline void error_clear(shmtf_error *e) {
    if (e) e->status = SHMTF_OK;
}
shmtf_error *error_open(shmtf_error *e);
shmtf_status error_set(shmtf_error *e, shmtf_status status, const char *what, const char *hint);
shmtf_status error_system(shmtf_error *e, shmtf_status status, int sys_errno, const char *what, const char *hint);
void error_frame(shmtf_error *e, const shmtf_store *h, const shmtf_ref *parent, const shmtf_ref *child);
void error_ref_name(const shmtf_store *h, const shmtf_ref *ref, char out[SHMTF_NAME_SIZE]);
void error_holder(shmtf_error *e, const shmtf_store *h, unsigned slot);
void store_text(const shmtf_word *words, char out[SHMTF_HOLDER_SIZE]);

/* A deadline in CLOCK_MONOTONIC; INT64_MAX: never. */
static inline int64_t deadline_after(int64_t timeout_ns) {
    if (timeout_ns < 0) return INT64_MAX;
    int64_t now = clock_monotonic_ns();
    return timeout_ns > INT64_MAX - now ? INT64_MAX : now + timeout_ns;
}

/* The frame of a reference as of a commit word.  *again: this commit is too old to tell. */
shmtf_status store_find(shmtf_store *h, uint64_t snapshot, const shmtf_ref *ref, shmtf_frame *frame, bool *again, shmtf_error *e);

#endif
