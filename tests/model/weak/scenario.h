/* SPDX-License-Identifier: Apache-2.0
 *
 * For the scenarios of this folder, which a checker of weak memory models (GenMC) runs: the shipped source itself, on static
 * memory, with three frames and three writer slots.  models.py hands them over with poses of one number, as the scheduler
 * beside it does, or every torn record would be looked at in 2^7 ways.
 */
#ifndef SHMTF_TESTS_WEAK_SCENARIO_H
#define SHMTF_TESTS_WEAK_SCENARIO_H

/* What the checker's interpreter does not know: prefetches, and the inline assembly that sanitizers do not know either. */
#define _GNU_SOURCE
#define __builtin_prefetch(...) ((void)0)
#define __builtin_expect(value, likely) (value)
#define __SANITIZE_THREAD__ 1

#include <assert.h>
#include <pthread.h>
#include <stdint.h>
#include <string.h>

/* What is copied here consists of 64-bit words, what is emptied is one struct. */
static inline void copy_words(void *to, const void *from, uint64_t n) {
    for (uint64_t i = 0; i < n / 8; i++) ((uint64_t *)to)[i] = ((const uint64_t *)from)[i];
}
static inline const void *zero_byte(const uint64_t *word) {
    for (int i = 0; i < 8; i++)
        if (!(*word >> 8 * i & 255)) return word;
    return NULL;
}
static inline int differ(const uint64_t *a, const uint64_t *b, uint64_t n) {
    for (uint64_t i = 0; i < n / 8; i++)
        if (a[i] != b[i]) return 1;
    return 0;
}
#define memcmp(a, b, n) differ((const uint64_t *)(a), (const uint64_t *)(b), n)
#define memchr(word, zero, n) zero_byte(word)
#define memset(to, zero, n) (*(to) = (__typeof__(*(to))){0})
#define memcpy(to, from, n) copy_words(to, from, n)
#define __builtin_memcpy(to, from, n) copy_words(to, from, n)

#ifdef MORTAL
#define SHMTF_STEPS
void shmtf_step(int kind, const void *word);
#endif

#include "core/arena.c"
#include "core/names.c"
#include "core/recover.c"
#include "core/ring.c"
#include "core/ring_write.c"
#include "core/tree.c"
#include "core/txn.c"

enum { FRAMES = 3, SLOTS = 3 };

#ifdef MORTAL
#ifndef CRASH_AT
#define CRASH_AT 0
#endif
static _Thread_local bool mortal;
static _Thread_local int stores;
static void (*dies)(void);
void shmtf_step(int kind, const void *word) {
    (void)word;
    if (!mortal || kind != SHMTF_STEP_STORE || ++stores != CRASH_AT) return;
    if (dies) dies();
    pthread_exit(NULL);
}
void shmtf_failpoint(const char *name) { (void)name; }
#endif

static shmtf_global global;
static shmtf_writer writers[SLOTS];
static shmtf_bucket buckets[1];
static shmtf_frame_words_t frames[FRAMES + 1];
static shmtf_name_t names[FRAMES + 1];
static shmtf_inline_ring inlines[FRAMES + 1];
static shmtf_segment s;

/* What a thread's transactions work in. */
typedef struct {
    txn x;
    txn_entry entries[FRAMES + 1];
    uint64_t parents[FRAMES + 1];
    uint32_t entry_of[FRAMES + 1], mark[FRAMES + 1];
    local_hint64 checked[FRAMES + 1];
} writer;
static writer of_slot[SLOTS];

static void make_segment(void) {
    s.geo.max_frames = FRAMES;
    s.geo.max_writers = SLOTS;
    s.geo.n_buckets = 1;
    s.geo.cache_time_ns = -1;
    s.global = &global;
    s.writers = writers;
    s.buckets = buckets;
    s.frames = frames;
    s.names = names;
    s.inlines = inlines;
    atomic_store_explicit(&global.frames_bound, FRAMES, memory_order_relaxed);
    for (unsigned i = 0; i < SLOTS; i++) {
        txn *x = &of_slot[i].x;
        x->s = &s;
        x->slot = i;
        x->live_from = 1;
        x->entries = of_slot[i].entries;
        x->parents = of_slot[i].parents;
        x->entry_of = of_slot[i].entry_of;
        x->mark = of_slot[i].mark;
        x->checked = of_slot[i].checked;
        atomic_store_explicit(&writers[i].live_from, 1, memory_order_relaxed);
    }
}

/* A record of frame `id` with this number everywhere, in the inline ring. */
static bool put(txn *x, uint32_t id, uint64_t number) {
    txn_entry *e;
    if (txn_lock_try(x, id, &e) != TXN_OK) return false;
    ring_record r = {.arrival = number, .stamp = (int64_t)number, .parent = number};
    r.info = info_make(0, KIND_STATIC, 0, 0);
    r.pose.x = (double)number;
    if (ring_put_locked(x->s, &e->w, &r, true, false) != PUT_OK) return false;
    x->n_staged++;
    return true;
}

/* One transaction that writes the same number to two frames, or, second == 0, to one; it does not wait for anybody. */
static txn_status write_frames(unsigned slot, uint32_t first, uint32_t second, uint64_t number, bool reshapes) {
    txn *x = &of_slot[slot].x;
    uint64_t version;
    txn_status st = txn_begin(x);
    if (st != TXN_OK) return st;
    if (!put(x, first, number) || (second && !put(x, second, number))) return txn_abort(x), TXN_HELD;
    x->reshapes = reshapes;
    return txn_commit(x, &version);
}

/* The newest record of a frame at a snapshot; 0: none, or S is too old.  Its words must belong together. */
static uint64_t newest(uint64_t snapshot, uint32_t id, uint64_t *version) {
    ring_record r;
    *version = 0;
    if (ring_latest(&s, id, snapshot, &r) != RING_OK) return 0;
    assert((uint64_t)r.stamp == r.parent && r.pose.x == (double)r.stamp);
    assert(r.version <= commit_version(snapshot));
    *version = r.version;
    return r.parent;
}

/* As in shmtf_take_snapshot. [E2 acquire] */
static uint64_t snapshot_now(void) { return load_acquire(&global.commit); }

#endif
