/* SPDX-License-Identifier: Apache-2.0
 *
 * What one call costs in a store of a given size.
 */
#ifndef SHMTF_BENCH_SCALE_H
#define SHMTF_BENCH_SCALE_H

#include "common.h"

enum { SCALE_N_ROWS = 6, SCALE_MAX_ROUNDS = 99, SCALE_MIN_HISTORY = 4 };

typedef struct {
    uint32_t n_frames, history;
    uint32_t depth;   /* edges of a lookup, less than n_frames; frames of an update */
    int rounds;       /* of all rows that read, interleaved, then of all that write */
    int64_t round_ns; /* per row and round */
    int cpu;          /* to be pinned to, counted among those allowed; -1: the last one */
} scale_options;

typedef struct {
    const char *name, *what;
    bench_spread ns; /* of processor time, per call */
} scale_row;

/* SHMTF_FULL: shared memory does not hold this configuration. */
shmtf_status scale_run(const scale_options *options, scale_row rows[SCALE_N_ROWS], shmtf_error *e);

#endif
