/* SPDX-License-Identifier: Apache-2.0
 *
 * usage: priority STORE WRITERS WRITES
 *
 * WRITERS processes write the same 16 frames without a pause.  Beside them two others write them WRITES times each, one
 * with priority and one without, and count the commits of others between their call and their own commit: every commit in
 * this store is one of these frames', so the versions tell.  Prints both.  Tier: test.
 */
#define _GNU_SOURCE
#include "crowd.h"

enum { EDGES = 16, MOST = 32, BEFORE = 100 };

typedef struct {
    atomic_long over, ready, at_it, let_pass[2], most[2], aborts[2], done[MOST];
} board;

static board *all;
static const char *store_name;
static long writes;
static char names[EDGES][16];

static uint64_t write_once(shmtf_store *h, int priority) {
    const shmtf_write_options options = {.timeout_ns = -1, .priority = priority};
    shmtf_transform t[EDGES];
    shmtf_error e;
    uint64_t version;
    int64_t stamp = now_ns();
    for (int i = 0; i < EDGES; i++) t[i] = crowd_edge("root", names[i], stamp, (double)stamp);
    if (shmtf_set_transforms(h, t, EDGES, &options, &version, &e)) stop("write", &e);
    return version;
}

static void saturate(int k) {
    shmtf_store *h = join(store_name, 0);
    while (!atomic_load(&all->over)) {
        write_once(h, 0);
        if (atomic_fetch_add(&all->done[k], 1) == BEFORE) atomic_fetch_add(&all->ready, 1);
    }
    shmtf_close(h);
}

static void ask(int priority) {
    shmtf_store *h = join(store_name, 0);
    shmtf_counters c;
    for (long i = 0; i < writes; i++) {
        uint64_t before = shmtf_commit_version(h);
        long passed = (long)(write_once(h, priority) - before - 1);
        atomic_fetch_add(&all->let_pass[priority], passed);
        if (passed > all->most[priority]) atomic_store(&all->most[priority], passed);
        usleep(200); /* so that the next call comes at any moment of the others */
    }
    shmtf_get_counters(h, &c);
    atomic_store(&all->aborts[priority], (long)c.aborts);
    shmtf_close(h);
}

int main(int argc, char **argv) {
    shmtf_error e;
    shmtf_config c = {.max_frames = EDGES + 1, .history = 60, .cache_time_ns = -1, .stream_bytes = 0, .max_writers = MOST + 2};
    pid_t pids[MOST], askers[2];
    if (argc < 4) return 2;
    store_name = argv[1];
    int writers = atoi(argv[2]), bad = 0;
    writes = atol(argv[3]);
    if (writers < 1 || writers > MOST || writes < 1) return 2;
    all = shared_memory(sizeof *all);
    if (shmtf_create(store_name, &c, 0600, &e)) stop("create", &e);
    for (int i = 0; i < EDGES; i++) snprintf(names[i], sizeof names[i], "f%d", i);
    shmtf_store *h = join(store_name, 0);
    write_once(h, 0);
    shmtf_close(h);
    for (int k = 0; k < writers; k++) pids[k] = spawn(saturate, k);
    while (atomic_load(&all->ready) < writers) usleep(100);
    for (int k = 0; k < 2; k++) askers[k] = spawn(ask, k);
    for (int k = 0; k < 2; k++) bad += !ended_well(askers[k], 0);
    atomic_store(&all->over, 1);
    for (int k = 0; k < writers; k++) bad += !ended_well(pids[k], 0);
    for (int k = 0; k < 2; k++)
        printf("%s: %ld writes beside %d others: %.2f commits of others before each, %ld at most, %.2f aborts each\n",
               k ? "with priority" : "ordinary", writes, writers, (double)all->let_pass[k] / (double)writes, (long)all->most[k],
               (double)all->aborts[k] / (double)writes);
    return bad != 0;
}
