/* SPDX-License-Identifier: Apache-2.0
 *
 * A concurrency protocol under test: the same snake, the same records, the same arithmetic, another way to keep readers
 * and writers apart.  One file each in protocols/.
 */
#ifndef SHMTF_BENCH_PROTOCOL_H
#define SHMTF_BENCH_PROTOCOL_H

#include <stdbool.h>

#include "common.h"

enum { BENCH_ERROR_SIZE = 256, BENCH_PLACE_SIZE = 128 };

typedef struct {
    uint32_t n_frames, history;
    uint32_t read_len, write_len;
    bool by_name; /* every operation starts from names; else from handles resolved once */
} bench_shape;

typedef struct bench_client bench_client; /* a process' view; each protocol has its own struct */

typedef struct {
    const char *name, *what;
    /* Make the shared memory, full of records older than now.  `place` is a wish (a name that is free), and then what
     * attach needs; the memory lives until remove or, where it has no name, until this process ends. */
    bool (*create)(char place[BENCH_PLACE_SIZE], const bench_shape *shape, char error[BENCH_ERROR_SIZE]);
    /* Remove the name, if there is one; processes that attached stay attached. */
    void (*remove)(const char *place);
    bench_client *(*attach)(const char *place, const bench_shape *shape, char error[BENCH_ERROR_SIZE]);
    void (*detach)(bench_client *c);
    /* T_first_(first + read_len): the newest record of every edge.  stamps: NULL, or room for read_len stamps, [k] being
     * that of frame first + 1 + k. */
    bool (*read)(bench_client *c, uint32_t first, int64_t *stamps, char error[BENCH_ERROR_SIZE]);
    /* Write the write_len frames after `first`, all with one stamp.  The items are given from the leaf to the root, as
     * reads climb; opposite: from the root to the leaf. */
    bool (*write)(bench_client *c, uint32_t first, int64_t stamp_ns, bool opposite, char error[BENCH_ERROR_SIZE]);
    /* How often operations of this client were begun again because of others. */
    uint64_t (*retries)(bench_client *c);
} bench_protocol;

extern const bench_protocol bench_shmtf, bench_giant, bench_giant_atomic;

/* NULL if there is no such protocol; n counts up from 0. */
const bench_protocol *bench_protocol_at(size_t n);
const bench_protocol *bench_protocol_find(const char *name);

#endif
