/* SPDX-License-Identifier: Apache-2.0
 *
 * usage: fairness STORE WRITERS READERS COMMITS
 *
 * A chain of 100 frames.  Every writer writes 16 neighbouring edges at once, half of the writers from the root outwards,
 * half from the far end inwards (all of them inwards where there are readers, who look outwards); every reader looks
 * along 16 edges.  Nobody pauses, and it ends when each of them has got through COMMITS times: who is starved, never lets
 * it end.  Prints how often each got through.  Tier: test; with larger numbers, on demand.
 */
#define _GNU_SOURCE
#include "crowd.h"

enum { FRAMES = 100, EDGES = 16, MOST = 64 };

typedef struct {
    atomic_long reached, done[MOST], aborts[MOST];
} board;

static board *all;
static const char *store_name;
static int n_writers, n_readers;
static long wanted;
static char names[FRAMES + 1][8];

static int everyone(int k) {
    if (atomic_fetch_add(&all->done[k], 1) + 1 == wanted) atomic_fetch_add(&all->reached, 1);
    return atomic_load(&all->reached) == n_writers + n_readers;
}

static void write_some(int k) {
    const shmtf_write_options wait = {.timeout_ns = -1};
    shmtf_store *h = join(store_name, 0);
    uint64_t random = seed_of(k);
    int inwards = n_readers || k % 2;
    shmtf_counters counters;
    do {
        shmtf_transform t[EDGES];
        shmtf_error e;
        int first = (int)(rnd(&random) % (FRAMES - EDGES + 1));
        int64_t stamp = now_ns();
        for (int i = 0; i < EDGES; i++) {
            int at = first + (inwards ? EDGES - 1 - i : i);
            t[i] = crowd_edge(names[at], names[at + 1], stamp, (double)stamp);
        }
        if (shmtf_set_transforms(h, t, EDGES, &wait, NULL, &e)) stop("write", &e);
    } while (!everyone(k));
    shmtf_get_counters(h, &counters);
    atomic_store(&all->aborts[k], (long)counters.aborts);
    shmtf_close(h);
    _exit(0);
}

static void read_some(int k) {
    shmtf_store *h = join(store_name, SHMTF_READONLY);
    uint64_t random = seed_of(k);
    do {
        shmtf_error e;
        shmtf_result r = {.edges = NULL};
        int first = (int)(rnd(&random) % (FRAMES - EDGES + 1));
        if (shmtf_lookup_latest_transform(h, NULL, shmtf_by_name(names[first]), shmtf_by_name(names[first + EDGES]), 0, &r, &e))
            stop("read", &e);
    } while (!everyone(k));
    shmtf_close(h);
    _exit(0);
}

static void report(const char *what, int first, int n, double seconds) {
    long least = -1, most = 0, sum = 0, aborts = 0;
    for (int k = first; k < first + n; k++) {
        long done = atomic_load(&all->done[k]);
        if (least < 0 || done < least) least = done;
        if (done > most) most = done;
        sum += done;
        aborts += atomic_load(&all->aborts[k]);
    }
    if (!n) return;
    printf("%d %s, each at least %ld times in %.2f s:", n, what, wanted, seconds);
    for (int k = first; k < first + n; k++) printf(" %ld", atomic_load(&all->done[k]));
    printf("; min %ld, max %ld, ratio %.3f; %.0f a second; %.3f aborts each\n", least, most, (double)least / (double)most,
           (double)sum / seconds, (double)aborts / (double)sum);
}

int main(int argc, char **argv) {
    shmtf_error e;
    shmtf_config c = {.max_frames = FRAMES + 1, .history = 256, .cache_time_ns = -1, .stream_bytes = 0, .max_writers = MOST};
    shmtf_transform t[FRAMES];
    pid_t pids[MOST];
    if (argc < 5) return 2;
    store_name = argv[1];
    n_writers = atoi(argv[2]);
    n_readers = atoi(argv[3]);
    wanted = atol(argv[4]);
    all = shared_memory(sizeof *all);
    if (n_writers < 1 || n_readers < 0 || n_writers + n_readers > MOST || wanted < 1) return 2;
    if (shmtf_create(store_name, &c, 0600, &e)) stop("create", &e);
    for (int i = 0; i <= FRAMES; i++) snprintf(names[i], sizeof names[i], "f%d", i);
    for (int i = 0; i < FRAMES; i++) t[i] = crowd_edge(names[i], names[i + 1], 1, 1);
    shmtf_store *h = join(store_name, 0);
    if (shmtf_set_transforms(h, t, FRAMES, NULL, NULL, &e)) stop("write", &e);
    shmtf_close(h);
    int64_t began = now_ns();
    int bad = 0, n = n_writers + n_readers;
    for (int k = 0; k < n; k++) pids[k] = spawn(k < n_writers ? write_some : read_some, k);
    for (int k = 0; k < n; k++) bad += !ended_well(pids[k], 0);
    double seconds = (double)(now_ns() - began) * 1e-9;
    report("writers", 0, n_writers, seconds);
    report("readers", n_writers, n_readers, seconds);
    return bad != 0;
}
