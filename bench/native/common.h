/* SPDX-License-Identifier: Apache-2.0
 *
 * What every benchmark here shares: a clock, a random number, a robot to measure with.
 *
 * The robot is the thesis' snake: `n_frames` frames in one chain, frame i's parent is frame i - 1.  Joints swing by half
 * a radian at about half a hertz, so consecutive records of a 100 Hz frame differ by less than a degree.
 */
#ifndef SHMTF_BENCH_COMMON_H
#define SHMTF_BENCH_COMMON_H

#include <stdint.h>
#include <stdio.h>
#include <time.h>

#include "shmtf.h"

#ifdef __cplusplus
extern "C" {
#endif

enum { BENCH_NAME_SIZE = 16, BENCH_POSES = 64 };

static inline int64_t bench_clock_ns(clockid_t clock) {
    struct timespec t;
    clock_gettime(clock, &t);
    return (int64_t)t.tv_sec * 1000000000 + t.tv_nsec;
}
static inline int64_t bench_now_ns(void) { return bench_clock_ns(CLOCK_MONOTONIC); }

/* xorshift64*: one multiplication per number; the seed must not be 0. */
typedef struct {
    uint64_t state;
} bench_random;
static inline uint64_t bench_random_next(bench_random *r) {
    r->state ^= r->state >> 12;
    r->state ^= r->state << 25;
    r->state ^= r->state >> 27;
    return r->state * 0x2545f4914f6cdd1dull;
}
/* Uniform in [0, n), n < 2^32. */
static inline uint32_t bench_random_below(bench_random *r, uint32_t n) {
    return (uint32_t)((bench_random_next(r) >> 32) * n >> 32);
}

static inline void bench_frame_name(char name[BENCH_NAME_SIZE], uint32_t i) {
    snprintf(name, BENCH_NAME_SIZE, "link_%05u", i);
}
/* The joint's pose in its parent at a time. */
shmtf_pose bench_pose(uint32_t frame, int64_t stamp_ns);
/* What every update writes for a frame: one of BENCH_POSES poses. */
static inline shmtf_pose bench_written_pose(uint32_t frame) { return bench_pose(frame % BENCH_POSES, 0); }

/* The n-th of the CPUs that this process was given, from 0, or from the last one at -1; -1: there are fewer. */
int bench_cpu_allowed(int n);
/* Bind the calling thread to a CPU, or let it go to all that the process was given.  Returns the CPU, or -1. */
int bench_pin(int cpu);
void bench_unpin(void);

typedef struct {
    double median, min, max;
} bench_spread;
/* Of n > 0 values, which are sorted in place. */
bench_spread bench_spread_of(double *values, size_t n);

#ifdef __cplusplus
}
#endif
#endif
