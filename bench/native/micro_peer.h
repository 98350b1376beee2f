/* SPDX-License-Identifier: Apache-2.0
 *
 * A peer's rows of micro: the same questions to another library, over a snake with the same frames and as many records.
 * The peer is a shared library of its own; it exports shmtf_bench_micro_peer.
 */
#ifndef SHMTF_BENCH_MICRO_PEER_H
#define SHMTF_BENCH_MICRO_PEER_H

#include <stdbool.h>

#include "common.h"

#ifdef __cplusplus
extern "C" {
#endif

enum { MICRO_ERROR_SIZE = 256 };

/* The records of every frame: `history` of them, period_ns apart, the first in the period that begins at first_ns. */
typedef struct {
    uint32_t n_frames, history;
    uint32_t depth; /* edges of a lookup */
    uint32_t write_len;
    int64_t first_ns, period_ns;
} micro_shape;

typedef enum { MICRO_NEWEST, MICRO_RECENT, MICRO_ANY_TIME } micro_when;

typedef struct micro_peer_client micro_peer_client;

typedef struct {
    const char *name, *what;
    const char *beside; /* our row that answers the same question */
    micro_when when;    /* which times `call` is given; newest: 0 */
    /* From frame `first` to the frame `depth` below it, or the write_len frames below it.  False: it was refused. */
    bool (*call)(micro_peer_client *c, uint32_t first, int64_t time_ns);
} micro_peer_row;

typedef struct {
    const char *name;
    /* NULL: why not is in `error`. */
    micro_peer_client *(*make)(const micro_shape *shape, char error[MICRO_ERROR_SIZE]);
    void (*free)(micro_peer_client *c);
    const char *(*why)(const micro_peer_client *c); /* the call that failed was refused */
    const micro_peer_row *rows;
    size_t n_rows;
} micro_peer;

#define MICRO_PEER_SYMBOL "shmtf_bench_micro_peer"
const micro_peer *shmtf_bench_micro_peer(void);

/* NULL: why not is in `error`. */
const micro_peer *micro_peer_load(const char *path, char error[MICRO_ERROR_SIZE]);

#ifdef __cplusplus
}
#endif
#endif
