/* SPDX-License-Identifier: Apache-2.0
 *
 * Threads for the scheduler that write and read one small store, and check it against the ghost.
 */
#ifndef SHMTF_TESTS_XSIM_H
#define SHMTF_TESTS_XSIM_H

#include "ghost.h"
#include "sched.h"
#include "support/world.h"

enum { XSIM_SLOTS = 5, XSIM_SETUP = 4 }; /* a slot for each thread, and one for the setup and the end */

typedef struct {
    const char *name;
    uint64_t max_frames;
    void (*setup)(void);
    int n_threads;
    void (*body[SCHED_THREADS])(int thread);
    unsigned readers; /* bit per thread: it writes nothing and is not killed */
    const char *names; /* frames that the end may write to */
    bool odd_rings; /* rings may lie anywhere in the arena, and each of its words is a point */
    void (*after)(uint64_t snapshot); /* what else must hold at the end */
} scenario;

extern const scenario scenarios[];
extern const int n_scenarios;

extern world xs;
/* Run a transaction until it is through, refused, or `tries` are used up; by the thread itself in slot `slot`. */
stage_status xsim_set(int slot, shmtf_transform *items, size_t n, int tries);
stage_status xsim_remove(int slot, shmtf_ref ref, int tries);
stage_status xsim_clear(int slot, bool keep_static, int tries);
/* From now on the slot's transactions give way to wishes, or wait for locks and announce it, with priority or without. */
typedef enum { POLITE, WAITS, WAITS_FIRST } xsim_manner;
void xsim_manners(int slot, xsim_manner manner);
/* A ring of that size for a frame that has none. */
void xsim_declare(int slot, const char *name, unsigned log2);
/* If that thread is dead, take over its slot.  True: the slot is the caller's. */
bool xsim_adopt(int slot);

/* Reads at one commit, against the ghost at its version. */
uint64_t xsim_snapshot(void);
void xsim_read_latest(uint64_t snapshot, const char *names);               /* by handle as of the setup */
void xsim_read_names(uint64_t snapshot, const char *names);                /* by name */
void xsim_read_around(uint64_t snapshot, const char *names, int64_t time); /* by handle as of the setup */
void xsim_read_path(uint64_t snapshot, const char *target, const char *source);

/* A violation. */
void xsim_fail(const char *what, uint64_t got, uint64_t want);
static inline void xsim_expect(uint64_t got, uint64_t want, const char *what) {
    if (got != want) xsim_fail(what, got, want);
}
void xsim_check_ring(uint32_t id);
void xsim_check_rings_apart(void);

#endif
