/* SPDX-License-Identifier: Apache-2.0
 *
 * What one call costs, beside the floor measured in the same run.
 */
#ifndef SHMTF_BENCH_MICRO_H
#define SHMTF_BENCH_MICRO_H

#include "common.h"

enum { MICRO_MAX_ROWS = 40, MICRO_MAX_ROUNDS = 99, MICRO_WRITE_LEN = 16, MICRO_MAX_DEPTH = 512, MICRO_TEXT_SIZE = 256 };

typedef struct {
    uint32_t n_frames, history;
    uint32_t depth;   /* edges of a lookup; less than n_frames, as MICRO_WRITE_LEN is */
    int rounds;       /* of all rows, interleaved */
    int64_t round_ns; /* per row and round */
    int cpu;          /* to be pinned to, counted among those allowed; -1: the last one */
    const char *only; /* NULL, or rows whose name contains it, and their floors */
    const char *peer; /* NULL, or the library of a peer whose rows are measured too */
} micro_options;

typedef struct {
    const char *name, *what, *floor; /* floor: name of the row it is compared with, or NULL */
    bench_spread ns;                 /* of processor time, per call */
    double ratio;                    /* median over the floor's median; 0: no floor */
    const char *peer, *beside;       /* of a peer's row: whose, and our row that answers the same question; else NULL */
} micro_row;

typedef struct {
    size_t n;
    micro_row rows[MICRO_MAX_ROWS];
    char without_peer[MICRO_TEXT_SIZE]; /* "", or why the peer's rows are missing */
} micro_result;

/* SHMTF_FULL: shared memory does not hold this configuration. */
shmtf_status micro_run(const micro_options *options, micro_result *result, shmtf_error *e);

#endif
