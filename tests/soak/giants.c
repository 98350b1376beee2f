/* SPDX-License-Identifier: Apache-2.0
 *
 * usage: giants STORE FRAMES SINGLES COMMITS
 *
 * One process writes all FRAMES at once, COMMITS times, while SINGLES processes write one of them at a time without a
 * pause.  It ends when the large writes are through, whatever that takes, and every small writer has got one through as
 * well.  Prints how long the large ones took.  Tier: test; with larger numbers, on demand.
 */
#define _GNU_SOURCE
#include "crowd.h"

enum { MOST = 64, MOST_FRAMES = 10000, BEFORE = 100 };

typedef struct {
    atomic_long over, ready, done[MOST];
} board;

static board *all;
static const char *store_name;
static int n_frames;
static char names[MOST_FRAMES][16];
static const shmtf_write_options wait_long = {.timeout_ns = -1};

static void write_single(int k) {
    shmtf_store *h = join(store_name, 0);
    uint64_t random = seed_of(k);
    for (long n = 0; !atomic_load(&all->over) || !n; n++) {
        shmtf_error e;
        int64_t stamp = now_ns();
        shmtf_transform t = crowd_edge("root", names[rnd(&random) % (uint64_t)n_frames], stamp, (double)stamp);
        if (shmtf_set_transforms(h, &t, 1, &wait_long, NULL, &e)) stop("write", &e);
        if (atomic_fetch_add(&all->done[k], 1) == BEFORE) atomic_fetch_add(&all->ready, 1);
    }
    shmtf_close(h);
}

static void write_all(shmtf_store *h, shmtf_transform *t, int64_t stamp) {
    shmtf_error e;
    for (int i = 0; i < n_frames; i++) t[i].stamp_ns = stamp;
    if (shmtf_set_transforms(h, t, (size_t)n_frames, &wait_long, NULL, &e)) stop("write", &e);
}

int main(int argc, char **argv) {
    shmtf_error e;
    pid_t pids[MOST];
    if (argc < 5) return 2;
    store_name = argv[1];
    n_frames = atoi(argv[2]);
    int singles = atoi(argv[3]), bad = 0;
    long commits = atol(argv[4]);
    if (n_frames < 1 || n_frames > MOST_FRAMES || singles < 1 || singles > MOST || commits < 1) return 2;
    shmtf_config c = {.max_frames = (uint32_t)n_frames + 1, .history = 32, .cache_time_ns = -1, .stream_bytes = 0, .max_writers = MOST};
    all = shared_memory(sizeof *all);
    shmtf_transform *t = calloc((size_t)n_frames, sizeof *t);
    int64_t *took = calloc((size_t)commits, sizeof *took);
    if (!t || !took || shmtf_create(store_name, &c, 0600, &e)) stop("create", &e);
    for (int i = 0; i < n_frames; i++) {
        snprintf(names[i], sizeof names[i], "f%d", i);
        t[i] = crowd_edge("root", names[i], 1, 1);
    }
    shmtf_store *h = join(store_name, 0);
    write_all(h, t, 1);
    for (int k = 0; k < singles; k++) pids[k] = spawn(write_single, k);
    while (atomic_load(&all->ready) < singles) usleep(100); /* all of them are at it */
    int64_t began = now_ns();
    for (long i = 0; i < commits; i++) {
        int64_t at = now_ns();
        write_all(h, t, at);
        took[i] = now_ns() - at;
    }
    double seconds = (double)(now_ns() - began) * 1e-9;
    atomic_store(&all->over, 1);
    for (int k = 0; k < singles; k++) bad += !ended_well(pids[k], 0);
    shmtf_counters counters;
    shmtf_get_counters(h, &counters);
    shmtf_close(h);
    printf("%ld writes of %d frames beside %d writers of single frames: %.3f aborts each; theirs:", commits, n_frames, singles,
           (double)counters.aborts / (double)commits);
    for (int k = 0; k < singles; k++) printf(" %ld", atomic_load(&all->done[k]));
    printf(" in %.2f s\n", seconds);
    print_spread("a large write", took, (size_t)commits);
    return bad != 0;
}
