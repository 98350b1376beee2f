/* SPDX-License-Identifier: Apache-2.0
 *
 * A concurrency protocol under test: the same snake, another way to keep readers and writers apart.  Those of this tree
 * are listed in protocols.c; a peer in a library of its own exports shmtf_bench_peer and is loaded by its path.
 */
#ifndef SHMTF_BENCH_PROTOCOL_H
#define SHMTF_BENCH_PROTOCOL_H

#include <stdbool.h>

#include "common.h"

#ifdef __cplusplus
extern "C" {
#endif

enum { BENCH_ERROR_SIZE = 256, BENCH_PLACE_SIZE = 128 };

typedef struct {
    uint32_t n_frames, history;
    uint32_t read_len, write_len;
    bool by_name; /* every operation starts from names; else from handles resolved once */
} bench_shape;

typedef struct bench_client bench_client; /* a worker's view; each protocol has its own struct */

typedef struct {
    const char *name, *what;
    bool threads;     /* its memory belongs to one process: the workers are threads of that process */
    bool common_time; /* lookups are at the newest common time: every stamp is that time, and shows no mixture */
    /* Make the memory, full of records older than now.  `place` is a wish (a name that is free), and then what attach
     * needs; the memory lives until remove or, where it has no name, until this process ends. */
    bool (*create)(char place[BENCH_PLACE_SIZE], const bench_shape *shape, char error[BENCH_ERROR_SIZE]);
    /* Remove the name, if there is one; who attached stays attached. */
    void (*remove)(const char *place);
    bench_client *(*attach)(const char *place, const bench_shape *shape, char error[BENCH_ERROR_SIZE]);
    void (*detach)(bench_client *c);
    /* T_first_(first + read_len).  stamps: NULL, or room for read_len stamps, [k] being that of frame first + 1 + k. */
    bool (*read)(bench_client *c, uint32_t first, shmtf_pose *out, int64_t *stamps, char error[BENCH_ERROR_SIZE]);
    /* Write the write_len frames after `first`, all with one stamp; frame i gets bench_written_pose(i).  The items are
     * given from the leaf to the root, as reads climb; opposite: from the root to the leaf. */
    bool (*write)(bench_client *c, uint32_t first, int64_t stamp_ns, bool opposite, char error[BENCH_ERROR_SIZE]);
    /* How often operations of this client were begun again because of others. */
    void (*retries)(bench_client *c, uint64_t *reads, uint64_t *writes);
} bench_protocol;

extern const bench_protocol bench_shmtf, bench_shmtf_common, bench_giant, bench_giant_atomic, bench_snapshot, bench_latest, bench_silo;

/* NULL if there is no such protocol; n counts up from 0. */
const bench_protocol *bench_protocol_at(size_t n);
const bench_protocol *bench_protocol_find(const char *name);

/* What a peer's library exports. */
#define BENCH_PEER_SYMBOL "shmtf_bench_peer"
const bench_protocol *shmtf_bench_peer(void);
/* Add the peer in a shared library.  NULL: why not is in `error`.  Twice is once. */
const bench_protocol *bench_protocol_load(const char *path, char error[BENCH_ERROR_SIZE]);

#ifdef __cplusplus
}
#endif
#endif
