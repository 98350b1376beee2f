/* SPDX-License-Identifier: Apache-2.0
 *
 * usage: longread STORE FRAMES WRITERS READS
 *
 * One lookup along a chain of FRAMES edges, READS times, while WRITERS processes write single records and batches of four
 * all over the chain without a pause.  Each lookup must answer, with one commit's edges: every batch keeps the sum of the
 * chain, so half of a batch shows.  Prints how long lookups took and how many had to begin again; and, for comparison, how
 * often looking at every lock word twice would have found all of them unchanged.  Tier: test; larger on demand.
 */
#define _GNU_SOURCE
#include "api/store.h"
#include "crowd.h"

enum { MOST = 64, MOST_FRAMES = 20000, BEFORE = 100, COMPARE_NS = 300000000, SUM = 1 };

typedef struct {
    atomic_long over, ready, done[MOST];
} board;

static board *all;
static const char *store_name;
static int n_frames;
static char (*names)[16];
static const shmtf_write_options wait_long = {.timeout_ns = -1};

static void write_chain(int k) {
    shmtf_store *h = join(store_name, 0);
    uint64_t random = seed_of(k);
    for (long n = 0; !atomic_load(&all->over) || !n; n++) {
        shmtf_error e;
        shmtf_transform t[4];
        int edges = rnd(&random) % 4 ? 4 : 1;
        /* Four at a time are +v -v +v -v, and so they stay: they begin at a multiple of four, in the second half.  A single
         * one writes the 0 that is there, in the first half. */
        int first = n_frames / 2 / 4 * 4;
        if (edges == 1) first = 2 + (int)(rnd(&random) % (uint64_t)(first - 2));
        else first += 4 * (int)(rnd(&random) % (uint64_t)((n_frames - first) / 4));
        double v = edges == 1 ? 0 : (double)(rnd(&random) % 1000);
        int64_t stamp = now_ns();
        for (int i = 0; i < edges; i++) t[i] = crowd_edge(names[first + i], names[first + i + 1], stamp, i % 2 ? -v : v);
        if (shmtf_set_transforms(h, t, (size_t)edges, &wait_long, NULL, &e)) stop("write", &e);
        if (atomic_fetch_add(&all->done[k], 1) == BEFORE) atomic_fetch_add(&all->ready, 1);
    }
    shmtf_close(h);
}

static void build(shmtf_store *h) {
    shmtf_error e;
    shmtf_transform *t = calloc((size_t)n_frames, sizeof *t);
    if (!t) stop("memory", NULL);
    for (int i = 0; i < n_frames; i++) t[i] = crowd_edge(names[i], names[i + 1], 1, i == 1 ? SUM : 0);
    if (shmtf_set_transforms(h, t, (size_t)n_frames, NULL, NULL, &e)) stop("write", &e);
    free(t);
}

/* What a reader without versions would do: remember the lock word of every frame, which changes with every write, and
 * look whether all are the same after the walk. */
static int unchanged(const shmtf_store *h, uint64_t *words, int frames) {
    double x = 0;
    for (int i = 0; i < frames; i++) {
        const shmtf_frame_words_t *f = &h->s.frames[i + 1];
        words[i] = load_acquire(&f->lock);
        if (lock_owned(words[i])) return 0;
        x += load_double(&f->newest[lock_sel(words[i])].pose[0]);
    }
    fence_acquire();
    for (int i = 0; i < frames; i++)
        if (load_relaxed(&h->s.frames[i + 1].lock) != words[i]) return 0;
    return x == x;
}

static void compare(const shmtf_store *h) {
    uint64_t *words = calloc((size_t)n_frames, sizeof *words);
    if (!words) stop("memory", NULL);
    for (int frames = n_frames; frames >= 10; frames /= 10) {
        long tries = 0, good = 0;
        for (int64_t end = now_ns() + COMPARE_NS; now_ns() < end; tries++) good += unchanged(h, words, frames);
        printf("reading %d frames twice and comparing: %ld tries, %.3f %% found nothing changed\n", frames, tries,
               100.0 * (double)good / (double)tries);
    }
    free(words);
}

static void read_chain(shmtf_store *h, long reads) {
    int64_t *took = calloc((size_t)reads, sizeof *took);
    shmtf_counters c;
    long worst = 0;
    uint64_t restarts = 0, version = 0;
    if (!took) stop("memory", NULL);
    for (long i = 0; i < reads; i++) {
        shmtf_error e;
        shmtf_result r = {.edges = NULL};
        int64_t at = now_ns();
        if (shmtf_lookup_latest_transform(h, NULL, shmtf_by_name(names[0]), shmtf_by_name(names[n_frames]), 0, &r, &e)) stop("read", &e);
        took[i] = now_ns() - at;
        if (r.pose.x != SUM || r.n_edges != (uint32_t)n_frames) stop("half of a write", NULL);
        if (r.version < version) stop("time went back", NULL);
        version = r.version;
        shmtf_get_counters(h, &c);
        if ((long)(c.restarts - restarts) > worst) worst = (long)(c.restarts - restarts);
        restarts = c.restarts;
    }
    printf("%ld lookups of %d edges: all answered, %ld attempts at most, %llu began again, %llu frames read again\n", reads, n_frames,
           worst + 1, (unsigned long long)restarts, (unsigned long long)c.rereads);
    print_spread("a lookup", took, (size_t)reads);
    free(took);
}

int main(int argc, char **argv) {
    shmtf_error e;
    pid_t pids[MOST];
    if (argc < 5) return 2;
    store_name = argv[1];
    n_frames = atoi(argv[2]) / 4 * 4;
    int writers = atoi(argv[3]), bad = 0;
    long reads = atol(argv[4]), before = 0, sum = 0;
    if (n_frames < 16 || n_frames > MOST_FRAMES || writers < 0 || writers > MOST || reads < 1) return 2;
    shmtf_config c = {.max_frames = (uint32_t)n_frames + 1, .history = 30, .cache_time_ns = -1, .stream_bytes = 0, .max_writers = MOST};
    all = shared_memory(sizeof *all);
    names = calloc((size_t)n_frames + 1, sizeof *names);
    if (!names || shmtf_create(store_name, &c, 0600, &e)) stop("create", &e);
    for (int i = 0; i <= n_frames; i++) snprintf(names[i], sizeof names[i], "f%d", i);
    shmtf_store *writer = join(store_name, 0), *h = join(store_name, SHMTF_READONLY);
    build(writer);
    shmtf_close(writer);
    for (int k = 0; k < writers; k++) pids[k] = spawn(write_chain, k);
    while (atomic_load(&all->ready) < writers) usleep(100);
    for (int k = 0; k < writers; k++) before += atomic_load(&all->done[k]);
    int64_t began = now_ns();
    read_chain(h, reads);
    for (int k = 0; k < writers; k++) sum += atomic_load(&all->done[k]);
    printf("beside %d writers with %.0f commits a second\n", writers, (double)(sum - before) * 1e9 / (double)(now_ns() - began));
    compare(h);
    atomic_store(&all->over, 1);
    for (int k = 0; k < writers; k++) bad += !ended_well(pids[k], 0);
    shmtf_close(h);
    return bad != 0;
}
