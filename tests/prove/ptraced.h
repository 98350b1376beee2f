/* SPDX-License-Identifier: Apache-2.0
 *
 * A process driven by ptrace: single steps, and short cuts to where it was before.
 */
#ifndef SHMTF_TESTS_PTRACED_H
#define SHMTF_TESTS_PTRACED_H

#include "prove.h"

enum { MOST_INSTRUCTIONS = 1 << 20 };

/* The course of one run, which other runs from the same image repeat, as far as no clock is read. */
typedef struct {
    uint64_t n;          /* instructions */
    uint64_t *at;        /* [i]: address of the instruction that comes after i others */
    uint32_t *nth;       /* [i]: how often that address has come, from the first on; 0: no place for a breakpoint */
    uint32_t *from;      /* [i]: the best place before i to run to at once; 0: the start */
    double each_s;       /* what a step takes */
    double mean_cost;    /* what it takes to get somewhere, in steps */
} course;

course *course_new(void);
/* One instruction.  False: `done` was set by the one before. */
bool ptraced_step(pid_t pid, const _Atomic int *done);
/* Between steps: remember where the process is, after i instructions. */
void course_note(course *c, uint64_t i, pid_t pid);
void course_end(course *c, uint64_t n, double seconds);
/* To where n instructions have been executed.  False: this run took another course (a clock was read), and the process is
 * somewhere else, at its end at the latest. */
bool course_run_to(const course *c, uint64_t n, pid_t pid, const _Atomic int *done);

#endif
