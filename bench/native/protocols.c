/* SPDX-License-Identifier: Apache-2.0 */
#define _GNU_SOURCE
#include "protocol.h"

#include <dlfcn.h>
#include <string.h>

static const bench_protocol *const OURS[] = {&bench_shmtf,    &bench_shmtf_common, &bench_giant, &bench_giant_atomic,
                                            &bench_snapshot, &bench_latest,       &bench_silo};
enum { N_OURS = sizeof OURS / sizeof *OURS, MAX_PEERS = 8 };

static const bench_protocol *peers[MAX_PEERS];
static size_t n_peers;

const bench_protocol *bench_protocol_at(size_t n) {
    if (n < N_OURS) return OURS[n];
    return n - N_OURS < n_peers ? peers[n - N_OURS] : NULL;
}

const bench_protocol *bench_protocol_find(const char *name) {
    const bench_protocol *p;
    for (size_t i = 0; (p = bench_protocol_at(i)); i++)
        if (!strcmp(p->name, name)) return p;
    return NULL;
}

const bench_protocol *bench_protocol_load(const char *path, char error[BENCH_ERROR_SIZE]) {
    const bench_protocol *(*get)(void);
    void *library = dlopen(path, RTLD_NOW | RTLD_LOCAL);
    if (library) *(void **)&get = dlsym(library, BENCH_PEER_SYMBOL); /* POSIX: a function's address fits */
    if (!library || !get) return snprintf(error, BENCH_ERROR_SIZE, "%s", dlerror()), NULL;
    const bench_protocol *peer = get(), *known = bench_protocol_find(peer->name);
    if (known) return known;
    if (n_peers == MAX_PEERS) return snprintf(error, BENCH_ERROR_SIZE, "%s: more than %d peers", path, MAX_PEERS), NULL;
    return peers[n_peers++] = peer;
}
