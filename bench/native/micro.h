/* SPDX-License-Identifier: Apache-2.0
 *
 * What one call costs, beside the floor measured in the same run.
 */
#ifndef SHMTF_BENCH_MICRO_H
#define SHMTF_BENCH_MICRO_H

#include "common.h"

enum { MICRO_MAX_ROWS = 24, MICRO_MAX_ROUNDS = 99, MICRO_MIN_FRAMES = 17 };

typedef struct {
    uint32_t n_frames, history;
    int rounds;       /* of all rows, interleaved */
    int64_t round_ns; /* per row and round */
    int cpu;          /* to be pinned to, counted among those allowed; -1: the last one */
    const char *only; /* NULL, or rows whose name contains it, and their floors */
} micro_options;

typedef struct {
    const char *name, *what, *floor; /* floor: name of the row it is compared with, or NULL */
    bench_spread ns;                 /* of processor time, per call */
    double ratio;                    /* median over the floor's median; 0: no floor */
} micro_row;

/* rows: room for MICRO_MAX_ROWS.  SHMTF_FULL: shared memory does not hold this configuration. */
shmtf_status micro_run(const micro_options *options, micro_row *rows, size_t *n, shmtf_error *e);

#endif
