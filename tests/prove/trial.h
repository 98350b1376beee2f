/* SPDX-License-Identifier: Apache-2.0
 *
 * Single trials before the k-th store: kill, kill the recoverer too, stop.
 */
#ifndef SHMTF_TESTS_TRIAL_H
#define SHMTF_TESTS_TRIAL_H

#include "prove.h"

/* The step hook: does nothing until it is armed. */
typedef enum { HOOK_OFF, HOOK_COUNT, HOOK_HALT, HOOK_WATCH } hook_mode;
typedef struct { /* shared: a process that counts tells its parent */
    uint64_t stores, loads;
    uint64_t words;               /* different words that were stored to */
    uint64_t commit_at;           /* 0, or the store that is the commit */
    uint64_t changed;             /* stores that changed something, seen while watching */
} step_count;
void hook_arm(hook_mode mode, const world *w, shmtf_store *h, uint64_t at, int signal_number, step_count *count);
void hook_shadow(const world *w); /* watching begins with what the store is now */
void hook_off(void);

typedef struct {
    world *w;
    reference ref;
    unsigned char *base, *dead; /* images: before the operation, and after the death of its writer */
    step_count *count;
    uint64_t version;           /* of the base */
    tally *t;
    uint64_t seed;
} bench;

void bench_make(bench *b, world *w, const operation *op, tally *t, uint64_t seed);
/* Steps of the operation from its base, and of whoever takes over from its victim, from the dead image. */
uint64_t count_stores(bench *b);
uint64_t count_recovery(bench *b, recovery how);

/* Kill before store k, then check it after each way of recovery (all_ways) or one of them.  The state seen, or -1. */
int kill_at(bench *b, uint64_t k, bool all_ways, bool thorough);
/* The dead image is of a victim that left `state`: kill its recoverer before store j, check. */
bool kill_twice_at(bench *b, uint64_t k, int state, recovery how, uint64_t j, bool thorough);
/* Make the dead image of store k without checks. */
bool make_dead(bench *b, uint64_t k);
/* Stop before store k; readers, and if `crowd` writers too, go on beside it; then let it go on. */
bool stop_at(bench *b, uint64_t k, bool crowd, bool thorough);

/* Every store of the operation and of its recovery changes the word it announced, and nothing else changes.
 * *seen: how many stores changed a word. */
bool watch_stores(bench *b, uint64_t *seen);

#endif
