/* SPDX-License-Identifier: Apache-2.0
 *
 * The loop of one worker of `ycsb`: a process, or a thread of a host.
 */
#ifndef SHMTF_BENCH_WORKER_H
#define SHMTF_BENCH_WORKER_H

#include "control.h"

enum { BENCH_MAX_PROTOCOLS = 8 };

typedef struct {
    bench_shape shape;
    uint32_t n_protocols;
    const bench_protocol *protocols[BENCH_MAX_PROTOCOLS];
    const char *places[BENCH_MAX_PROTOCOLS];
    double frequency;     /* operations per second of one worker; 0: as fast as it goes */
    bool opposite;
    bool mixed_rate;      /* writers write each of their edges when it is due; lookups span the slow edge */
    uint32_t check_every; /* every so many lookups one is looked at more closely; 0: none */
} bench_job;

/* Attach, then run phases until told to stop.  False: it could not attach; why is in the worker's part. */
bool bench_work(bench_control *c, uint32_t index, const bench_job *job);
/* Be the process whose threads are the workers of job's only protocol, which needs that: make its memory, run
 * bench_work in a thread for each, remove its name.  False: it could not be made; why is in every worker's part. */
bool bench_host(bench_control *c, bench_job *job);
/* This process ends when `parent` does. */
void bench_die_with(int parent);
/* Does the next operation read? */
static inline bool bench_next_is_read(const bench_phase *p, uint32_t index, bench_random *random) {
    if (!p->coin) return index < p->n_readers;
    return (double)(bench_random_next(random) >> 11) * 0x1p-53 < p->read_ratio;
}

#endif
