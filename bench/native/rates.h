/* SPDX-License-Identifier: Apache-2.0
 *
 * When the edges of the workload `mixed-rate` are due: one edge of the chain at 1 Hz, the others at 30 to 200 Hz, each
 * with a phase of its own.  The writers share the edges out; every edge has one writer.
 *
 * A store may have forgotten the last phase.  So before anything is measured all edges are written once, the slow one
 * last: then its stamp is a time at which every edge has data.
 */
#ifndef SHMTF_BENCH_RATES_H
#define SHMTF_BENCH_RATES_H

#include "protocol.h"

typedef struct {
    int64_t due_ns;
    uint32_t child;
    bool written;
} rates_edge;

typedef struct {
    rates_edge *heap; /* the next one due first */
    uint32_t n;
    int64_t start_ns;
} rates;

/* The slow edge's child, and any edge's updates per second. */
static inline uint32_t rates_slow(const bench_shape *shape) { return shape->n_frames / 2; }
double rates_of(const bench_shape *shape, uint32_t child);

/* The edges of writer `index` of `n_writers`, due at start_ns, the slow one half-way to measure_ns, and then at their rate.
 * False: no memory. */
bool rates_make(rates *r, const bench_shape *shape, uint32_t index, uint32_t n_writers, int64_t start_ns, int64_t measure_ns);
void rates_free(rates *r);
/* The next one was written at now_ns; times that have passed meanwhile are left out. */
void rates_written(rates *r, const bench_shape *shape, int64_t now_ns);

#endif
