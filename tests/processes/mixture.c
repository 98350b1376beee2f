/* SPDX-License-Identifier: Apache-2.0
 *
 * usage: mixture STORE PROCESSES UPDATES
 *
 * Half of the processes write UPDATES times the 16 edges of one chain, each time with one stamp and one value; the
 * other half read the chain's latest transform until all writers are done.  Nobody may see two stamps in one read, or
 * a value that does not belong to the stamp; nobody may fail; every writer must get all its updates through.
 */
#define _GNU_SOURCE
#include <sched.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/wait.h>
#include <unistd.h>

#include "member.h"

enum { EDGES = 16 };

typedef struct {
    atomic_long stamp, writing, waiting, reads, distinct, commits;
} shared;

static shared *all;
static const char *store_name;
static char names[EDGES + 1][8];

static void update(shmtf_store *h) {
    shmtf_transform t[EDGES];
    shmtf_error e;
    const shmtf_write_options wait = {.timeout_ns = -1};
    long stamp = atomic_fetch_add(&all->stamp, 1);
    for (int i = 0; i < EDGES; i++) /* from the far end: the order in a batch is the caller's */
        t[i] = (shmtf_transform){shmtf_by_name(names[EDGES - 1 - i]), shmtf_by_name(names[EDGES - i]), stamp, {(double)stamp, 0, 0, 0, 0, 0, 1}, 0};
    if (shmtf_set_transforms(h, t, EDGES, &wait, NULL, &e)) stop("write", &e);
    atomic_fetch_add(&all->commits, 1);
}

static void writer(long updates) {
    shmtf_store *h = join(store_name, 0);
    while (atomic_load(&all->waiting)) sched_yield(); /* until every reader has read */
    for (long i = 0; i < updates; i++) update(h);
    atomic_fetch_sub(&all->writing, 1);
    shmtf_close(h);
    _exit(0);
}

static void reader(void) {
    shmtf_store *h = join(store_name, SHMTF_READONLY);
    shmtf_edge edges[EDGES];
    int64_t last = -1;
    uint64_t version = 0;
    for (int more = 1; more;) {
        shmtf_error e;
        shmtf_result r = {.edges = edges, .max_edges = EDGES};
        more = atomic_load(&all->writing) > 0; /* once more after the last writer */
        if (shmtf_lookup_latest_transform(h, NULL, shmtf_by_name(names[0]), shmtf_by_name(names[EDGES]), 0, &r, &e)) stop("read", &e);
        if (r.n_edges != EDGES || r.oldest_ns != r.newest_ns) stop("a mixture of stamps", NULL);
        for (int i = 0; i < EDGES; i++)
            if (edges[i].stamp_ns != r.oldest_ns) stop("an edge with another stamp", NULL);
        if (r.pose.x != (double)(EDGES * r.oldest_ns)) stop("a value that was never written", NULL);
        if (r.oldest_ns < last || r.version < version) stop("time went back", NULL);
        atomic_fetch_add(&all->distinct, r.oldest_ns != last);
        if (atomic_fetch_add(&all->reads, 1), last < 0) atomic_fetch_sub(&all->waiting, 1);
        last = r.oldest_ns;
        version = r.version;
    }
    shmtf_close(h);
    _exit(0);
}

int main(int argc, char **argv) {
    shmtf_error e;
    shmtf_config c = {.max_frames = 32, .history = 64, .cache_time_ns = -1, .stream_bytes = 0, .max_writers = 64};
    if (argc < 4) return 2;
    store_name = argv[1];
    int n = atoi(argv[2]), bad = 0, status;
    long updates = atol(argv[3]);
    all = mmap(NULL, sizeof *all, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
    if (all == MAP_FAILED || shmtf_create(store_name, &c, 0600, &e)) stop("create", &e);
    for (int i = 0; i <= EDGES; i++) snprintf(names[i], sizeof names[i], "f%d", i);
    shmtf_store *h = join(store_name, 0);
    atomic_store(&all->stamp, 1);
    update(h);
    atomic_store(&all->writing, n - n / 2);
    atomic_store(&all->waiting, n / 2);
    for (int i = 0; i < n; i++) {
        pid_t pid = fork();
        if (pid < 0) stop("fork", NULL);
        if (!pid && i % 2 == 0) writer(updates);
        if (!pid) reader();
    }
    while (wait(&status) > 0) {
        if (!WIFEXITED(status) || WEXITSTATUS(status)) bad++;
    }
    long want = 1 + updates * (n - n / 2);
    printf("%d processes: %ld commits, %ld reads of 16 edges, %ld different, %d failed\n", n, (long)all->commits, (long)all->reads,
           (long)all->distinct, bad);
    if (all->commits != want || shmtf_commit_version(h) > (uint64_t)want) bad++;
    shmtf_close(h);
    return bad != 0;
}
