/* SPDX-License-Identifier: Apache-2.0
 *
 * A scheduler that runs every interleaving of a few threads, up to a number of preemptions, and kills a thread before
 * any store, up to a number of crashes.  Threads are coroutines; each access to the segment is a point where another
 * may go on.  Interleavings are sequentially consistent: what weaker orders allow is shown elsewhere.
 */
#ifndef SHMTF_TESTS_SCHED_H
#define SHMTF_TESTS_SCHED_H

#include <stdbool.h>
#include <stdint.h>

enum { SCHED_THREADS = 4 };

typedef struct {
    int n_threads;
    void (*body[SCHED_THREADS])(int thread);
    bool may_crash[SCHED_THREADS];
    void (*reset)(void);              /* before each execution */
    void (*stepped)(int thread);      /* after each step of a thread */
    void (*finish)(void);             /* after each execution: all threads are done or dead */
    bool (*is_point)(const void *word); /* may the access to this word be seen by others? */
} sched_program;

typedef struct {
    int preemptions, crashes;
    unsigned stride; /* 1: every interleaving; n: preempt and crash only at one in n points, chosen by salt */
    uint64_t salt;
    double seconds; /* 0: no limit */
} sched_bounds;

typedef struct {
    long executions, crashes;
    bool complete;
} sched_result;

sched_result sched_explore(const sched_program *program, const sched_bounds *bounds);
bool sched_is_dead(int thread);
bool sched_is_done(int thread);
/* Go on after another thread has stored something, or died. */
void sched_wait(void);
int sched_current(void); /* the running thread, or -1 */
/* A violation: print it with the schedule that led there, and exit. */
void sched_fail(const char *what);

#endif
