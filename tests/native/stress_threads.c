/* SPDX-License-Identifier: Apache-2.0
 *
 * Threads write and read one store for SHMTF_STRESS_SECONDS (default 2).  A writer gives edge i of a chain the pose
 * y = weight[i] * k, with one number k for the whole batch.  The weights add up to 0 and no part of them does, so the
 * chain's y is 0 at every commit, at every time and between two records, and is not 0 for a reader that sees a part
 * of a batch, or two batches mixed.  Some stamps are late, the rings are small and turn all the time, and half of the
 * threads share a handle.  Under ThreadSanitizer it also shows that every shared word is an atomic.
 */
#define _GNU_SOURCE
#include <inttypes.h>
#include <math.h>
#include <pthread.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <time.h>
#include <unistd.h>

#include "shmtf.h"

enum { N_EDGES = 8, N_WRITERS = 3, N_READERS = 3, N_WAITERS = 1, N_THREADS = N_WRITERS + N_READERS + N_WAITERS };
#define SECOND_NS 1000000000ll
#define PERIOD_NS 1000000ll

typedef struct {
    pthread_t thread;
    shmtf_store *store;
    uint64_t random, done, busy, unanswered;
} worker;

static int memory_fd;
static atomic_bool stop;
static atomic_llong newest_ns = SECOND_NS;
static char names[N_EDGES + 1][8];

static void fail(const char *what, const shmtf_error *error) {
    char message[512];
    fprintf(stderr, "%s: %s\n", what, error ? shmtf_error_message(error, message, sizeof message) : "");
    abort();
}

static shmtf_store *attach(unsigned flags) {
    shmtf_store *store;
    shmtf_error error;
    if (shmtf_attach_fd(memory_fd, flags, "stress", &store, &error)) fail("attach", &error);
    return store;
}

static uint64_t next_random(worker *w) { /* xorshift64 */
    w->random ^= w->random << 13;
    w->random ^= w->random >> 7;
    w->random ^= w->random << 17;
    return w->random;
}

/* 1 2 4 .. 64, and minus their sum */
static double weight_of(int i) { return i < N_EDGES - 1 ? 1 << i : 1 - (1 << (N_EDGES - 1)); }

static void write_batch(worker *w) {
    shmtf_transform items[N_EDGES] = {0};
    const shmtf_write_options options = {.timeout_ns = 100000000};
    double k = (double)(next_random(w) % 1000000);
    int64_t stamp = atomic_fetch_add(&newest_ns, PERIOD_NS) + PERIOD_NS;
    if (next_random(w) % 4 == 0) stamp -= (int64_t)(next_random(w) % 6) * PERIOD_NS + 1; /* late */
    for (int i = 0; i < N_EDGES; i++) {
        items[i].parent = shmtf_by_name(names[i]);
        items[i].child = shmtf_by_name(names[i + 1]);
        items[i].stamp_ns = stamp;
        items[i].pose = (shmtf_pose){k, weight_of(i) * k, 0, 0, 0, 0, 1};
    }
    shmtf_error error;
    shmtf_status status = shmtf_set_transforms(w->store, items, N_EDGES, &options, NULL, &error);
    if (status && status != SHMTF_BUSY) fail("set_transforms", &error);
    if (status == SHMTF_OK) w->done++;
    if (status == SHMTF_BUSY) w->busy++;
}

static void *run_writer(void *argument) {
    while (!atomic_load(&stop)) write_batch(argument);
    return NULL;
}

static void check_pose(const shmtf_pose *p) {
    if (fabs(p->y) <= 1e-4) return; /* rounding is below 1e-6, the least tear is 1 */
    fprintf(stderr, "half a batch: x %f y %f\n", p->x, p->y);
    abort();
}

/* An answer must be sound; that there is none at that time any more is an answer too. */
static int look_up(worker *w, const shmtf_snapshot *snapshot, const int64_t *time_ns, shmtf_result *result) {
    shmtf_error error;
    shmtf_ref target = shmtf_by_name(names[0]), source = shmtf_by_name(names[N_EDGES]);
    shmtf_status status = shmtf_lookup_transform(w->store, snapshot, target, source, time_ns, 0, result, &error);
    if (status == SHMTF_BACKWARD || status == SHMTF_FORWARD || status == SHMTF_SNAPSHOT_EXPIRED) {
        w->unanswered++;
        return 0;
    }
    if (status) fail("lookup", &error);
    check_pose(&result->pose);
    w->done++;
    return 1;
}

static void *run_reader(void *argument) {
    worker *w = argument;
    while (!atomic_load(&stop)) {
        shmtf_result first = {0}, second = {0};
        int64_t time_ns = atomic_load(&newest_ns) - (int64_t)(next_random(w) % 4000000);
        look_up(w, NULL, &time_ns, &first);
        look_up(w, NULL, NULL, &first);
        shmtf_snapshot snapshot = shmtf_take_snapshot(w->store);
        if (look_up(w, &snapshot, NULL, &first) && look_up(w, &snapshot, NULL, &second))
            if (first.pose.x != second.pose.x || first.stamp_ns != second.stamp_ns) fail("a snapshot moved", NULL);
    }
    return NULL;
}

static void *run_waiter(void *argument) {
    worker *w = argument;
    const shmtf_ref frame = shmtf_by_name(names[N_EDGES]);
    uint64_t since = shmtf_commit_version(w->store);
    while (!atomic_load(&stop)) {
        shmtf_error error;
        uint64_t version = 0;
        shmtf_status status = shmtf_wait_for_change(w->store, &frame, 1, since, 50000000, &version, &error);
        if (status && status != SHMTF_TIMEOUT && status != SHMTF_INTERRUPTED) fail("wait", &error);
        if (status == SHMTF_OK && version <= since) fail("a wait ended without a newer commit", NULL);
        if (status == SHMTF_OK) since = version;
        if (status == SHMTF_OK) w->done++;
    }
    return NULL;
}

static void make_store(void) {
    shmtf_config config;
    shmtf_error error;
    shmtf_config_default(&config);
    config.max_frames = 32;
    config.history = 8;
    config.stream_bytes = 0;
    config.cache_time_ns = -1;
    memory_fd = memfd_create("shmtf-stress", MFD_CLOEXEC);
    if (memory_fd < 0 || shmtf_format_fd(memory_fd, &config, &error)) fail("format", &error);
    for (int i = 0; i <= N_EDGES; i++) snprintf(names[i], sizeof names[i], "f%d", i);
}

static void check_end(shmtf_store *store) {
    shmtf_check_report report = {0};
    shmtf_error error;
    if (shmtf_check(store, 0, &report, &error)) fail("check", &error);
    if (report.locks_held || report.bad_words) fail(report.first_problem, NULL);
}

int main(void) {
    const char *text = getenv("SHMTF_STRESS_SECONDS");
    double seconds = text ? atof(text) : 2;
    worker workers[N_THREADS] = {0};
    make_store();
    shmtf_store *shared = attach(0);
    worker first = {.store = shared, .random = 1};
    for (int i = 0; i < 2; i++) write_batch(&first); /* so that readers find the chain, and two records an edge */
    for (int i = 0; i < N_THREADS; i++) {
        int writes = i < N_WRITERS;
        workers[i].store = i % 2 ? shared : attach(writes ? 0 : SHMTF_READONLY);
        workers[i].random = UINT64_C(0x9e3779b97f4a7c15) * ((uint64_t)i + 1);
    }
    for (int i = 0; i < N_THREADS; i++) {
        void *(*run)(void *) = i < N_WRITERS ? run_writer : i < N_WRITERS + N_READERS ? run_reader : run_waiter;
        if (pthread_create(&workers[i].thread, NULL, run, &workers[i])) fail("pthread_create", NULL);
    }
    struct timespec pause = {.tv_sec = (time_t)seconds, .tv_nsec = (long)((seconds - floor(seconds)) * 1e9)};
    nanosleep(&pause, NULL);
    atomic_store(&stop, true);
    for (int i = 0; i < N_THREADS; i++) {
        pthread_join(workers[i].thread, NULL);
        printf("thread %d: %" PRIu64 " done, %" PRIu64 " busy, %" PRIu64 " unanswered\n", i, workers[i].done,
               workers[i].busy, workers[i].unanswered);
        if (i % 2 == 0) shmtf_close(workers[i].store);
        if (!workers[i].done) fail("a thread got nowhere", NULL);
    }
    check_end(shared);
    shmtf_close(shared);
    close(memory_fd);
    return 0;
}
