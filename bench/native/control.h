/* SPDX-License-Identifier: Apache-2.0
 *
 * What the coordinator and its workers share: one anonymous piece of memory.
 *
 * The coordinator describes a phase and raises its number; workers sleep on that number, run the phase from one common
 * instant to another by the clock that all processes share, leave what they counted in their own part, and say so.  The
 * memory has no name, so nothing is left behind however a process ends.
 */
#ifndef SHMTF_BENCH_CONTROL_H
#define SHMTF_BENCH_CONTROL_H

#include "histogram.h"
#include "protocol.h"
#include "segment/atomic.h"

/* One protocol, by some of the workers, once. */
typedef struct {
    uint32_t protocol;   /* index into what the workers attached to */
    uint32_t n_active;   /* workers 0 .. n_active - 1 take part */
    uint32_t n_readers;  /* of those the first ones, where coin is 0 */
    uint32_t coin;       /* every operation is a read with probability read_ratio */
    uint32_t pinned;     /* worker i runs on CPU i of those allowed */
    uint32_t pad;
    double read_ratio;
    int64_t start_ns, measure_ns, end_ns; /* CLOCK_MONOTONIC: begin, begin to count, stop */
    uint64_t seed;
} bench_phase;

enum { WORKER_STARTING, WORKER_READY, WORKER_FAILED };

typedef struct {
    shmtf_word32 state, done; /* done: number of the last phase it took part in and finished */
    uint64_t reads, writes;   /* completed while measuring */
    uint64_t read_retries, write_retries, failures, checked, mixed;
    uint64_t cpu_ns;
    char error[BENCH_ERROR_SIZE]; /* why it failed, or the first operation that did */
    bench_histogram read_ns, write_ns;                /* latency */
    bench_histogram age_oldest_ns, age_mean_ns; /* of checked lookups: now - stamps */
    bench_histogram span_ns, deviation_ns;       /* of their stamps: newest - oldest, standard deviation */
} bench_worker;

typedef struct {
    shmtf_word32 phase_number; /* a futex */
    shmtf_word32 stop;         /* set once: leave at the next operation */
    uint32_t n_workers;
    bench_phase phase;
    bench_worker worker[];
} bench_control;

size_t bench_control_size(uint32_t n_workers);
/* Returns a descriptor, or -1 with errno. */
int bench_control_make(uint32_t n_workers);
/* NULL with errno.  Both ends map the same memory. */
bench_control *bench_control_map(const char *path);
void bench_control_unmap(bench_control *c);

void bench_control_start(bench_control *c, const bench_phase *phase);
void bench_control_stop(bench_control *c);
/* Sleep until a phase above `last` begins, at most 0.1 s; its number, 0 if there is none yet, or -1 to leave. */
int64_t bench_control_next(bench_control *c, uint32_t last);

/* Attached, or not, for the reason in w->error. */
void bench_worker_enter(bench_worker *w, bool ready);
/* A worker's part of a phase, apart from the operations. */
void bench_worker_begin(bench_control *c, uint32_t index);
void bench_worker_end(bench_control *c, uint32_t index, uint64_t read_retries, uint64_t write_retries, uint64_t cpu_ns);
/* Look at the stamps of one lookup, [k] being that of frame first + 1 + k; `now_ns` is when it returned.  Stamps up to
 * start_ns are of the time before the phase: they say nothing about freshness, and belong to no update. */
void bench_worker_check(bench_worker *w, const bench_shape *shape, uint32_t first, const int64_t *stamps, int64_t now_ns,
                        int64_t start_ns);
void bench_worker_fail(bench_worker *w, const char *why);

/* The stamp of an update of the frames after `first`: the time, with `first` modulo write_len in its low bits, so that
 * whoever sees one record of the update knows which frames it wrote. */
int64_t bench_update_stamp(const bench_shape *shape, uint32_t first, int64_t now_ns);

#endif
