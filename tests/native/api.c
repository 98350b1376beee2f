/* SPDX-License-Identifier: Apache-2.0
 * The public functions on real segments: life cycle, limits, slots and threads, fork, read-only, waiting. */
#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <pthread.h>
#include <stdbool.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include "shmtf.h"
#include "support/check.h"

static char name[64];
static _Thread_local shmtf_error e;

static shmtf_config small(void) {
    return (shmtf_config){.max_frames = 16, .history = 6, .cache_time_ns = -1, .stream_bytes = 0, .max_writers = 4};
}

static shmtf_store *open_new(const shmtf_config *c) {
    shmtf_store *h = NULL;
    NEED(shmtf_create(name, c, 0600, &e) == SHMTF_OK);
    NEED(shmtf_attach(name, 0, "api", 0, &h, &e) == SHMTF_OK);
    return h;
}
static void drop(shmtf_store *h) {
    shmtf_close(h);
    EQUAL(shmtf_unlink(name, &e), SHMTF_OK);
}

static shmtf_transform edge(const char *parent, const char *child, int64_t stamp, double x) {
    return (shmtf_transform){shmtf_by_name(parent), shmtf_by_name(child), stamp, {x, 0, 0, 0, 0, 0, 1}, 0};
}
static shmtf_status put(shmtf_store *h, const char *parent, const char *child, int64_t stamp, double x) {
    shmtf_transform t = edge(parent, child, stamp, x);
    const shmtf_write_options wait = {.timeout_ns = -1};
    return shmtf_set_transforms(h, &t, 1, &wait, NULL, &e);
}
static shmtf_status latest(shmtf_store *h, const char *target, const char *source, double *x) {
    shmtf_result r = {.edges = NULL};
    shmtf_status st = shmtf_lookup_latest_transform(h, NULL, shmtf_by_name(target), shmtf_by_name(source), 0, &r, &e);
    *x = r.pose.x;
    return st;
}

static void check_life_cycle(void) {
    shmtf_store *h = NULL, *r = NULL;
    shmtf_config c = small();
    static const char *const bad[] = {"", ".hidden", "a/b", NULL};
    EQUAL(shmtf_attach(name, 0, NULL, 0, &h, &e), SHMTF_NOT_FOUND);
    EQUAL(shmtf_unlink(name, &e), SHMTF_NOT_FOUND);
    for (int i = 0; i < 4; i++) EQUAL(shmtf_create(bad[i], &c, 0600, &e), SHMTF_INVALID_ARGUMENT);
    h = open_new(&c);
    EQUAL(shmtf_create(name, &c, 0600, &e), SHMTF_EXISTS);
    EQUAL(put(h, "a", "b", 1, 4), SHMTF_OK);
    NEED(shmtf_attach(name, SHMTF_READONLY, NULL, 0, &r, &e) == SHMTF_OK);
    EQUAL(put(r, "a", "b", 2, 5), SHMTF_READ_ONLY);
    EQUAL(shmtf_clear(r, 0, NULL, &e), SHMTF_READ_ONLY);
    double x;
    CHECK(latest(r, "a", "b", &x) == SHMTF_OK && x == 4);
    EQUAL(shmtf_unlink(name, &e), SHMTF_OK);
    EQUAL(put(h, "a", "b", 3, 6), SHMTF_OK); /* attached processes keep their mapping */
    CHECK(latest(r, "a", "b", &x) == SHMTF_OK && x == 6);
    shmtf_close(r);
    shmtf_close(h);
    shmtf_close(NULL);
}

static void check_limits(void) {
    shmtf_config c;
    shmtf_config_default(&c);
    CHECK(shmtf_segment_size(&c, &e) > 0);
#define LIMIT(field, value)                        \
    c = small();                                   \
    c.field = (value);                             \
    EQUAL(shmtf_segment_size(&c, &e), 0);          \
    EQUAL(e.status, SHMTF_INVALID_ARGUMENT);       \
    CHECK(e.what && !strcmp(e.what, #field));      \
    EQUAL(shmtf_create(name, &c, 0600, &e), SHMTF_INVALID_ARGUMENT)
    LIMIT(max_frames, 0);
    LIMIT(max_frames, 1u << 24);
    LIMIT(history, 0);
    LIMIT(history, 1u << 23);
    LIMIT(max_writers, 0);
    LIMIT(max_writers, 1024);
    LIMIT(stream_bytes, 1ull << 60);
    c = small();
    c.stream_bytes = 1ull << 39; /* allowed, but not there */
    EQUAL(shmtf_create(name, &c, 0600, &e), SHMTF_FULL);
    EQUAL(access("/dev/shm", F_OK), 0);
    shmtf_store *h;
    EQUAL(shmtf_attach(name, 0, NULL, 0, &h, &e), SHMTF_NOT_FOUND);
}

/* Files that are no stores are refused, each with a reason. */
static void check_strangers(void) {
    shmtf_store *h;
    shmtf_config c = small();
    char path[96];
    snprintf(path, sizeof path, "/dev/shm/%s", name);
    for (int k = 0; k < 3; k++) {
        int fd = open(path, O_RDWR | O_CREAT | O_EXCL, 0600);
        NEED(fd >= 0);
        if (k) NEED(ftruncate(fd, k == 1 ? 100 : 1 << 16) == 0);
        shmtf_status st = shmtf_attach(name, 0, NULL, 0, &h, &e);
        CHECK(st == SHMTF_VERSION || st == SHMTF_CORRUPT);
        CHECK(e.what && *e.what);
        close(fd);
        unlink(path);
    }
    NEED(mkfifo(path, 0600) == 0);
    CHECK(shmtf_attach(name, 0, NULL, 0, &h, &e) != SHMTF_OK);
    unlink(path);
    NEED(symlink("/dev/null", path) == 0);
    CHECK(shmtf_attach(name, 0, NULL, 0, &h, &e) != SHMTF_OK);
    unlink(path);
    for (int word = 0; word < 22; word++) { /* every word of the header, changed */
        NEED(shmtf_create(name, &c, 0600, &e) == SHMTF_OK);
        int fd = open(path, O_RDWR);
        uint64_t v;
        NEED(pread(fd, &v, 8, 8 * word) == 8);
        v ^= 1ull << 33;
        NEED(pwrite(fd, &v, 8, 8 * word) == 8);
        close(fd);
        bool constant = word < 4 || word >= 8;
        if (constant) CHECK(shmtf_attach(name, 0, NULL, 0, &h, &e) != SHMTF_OK);
        unlink(path);
    }
}

typedef struct {
    shmtf_store *h;
    pthread_barrier_t *barrier;
    int k, failures;
    char child[16];
} worker;

static void *work(void *argument) {
    worker *w = argument;
    pthread_barrier_wait(w->barrier);
    double x;
    for (int i = 1; i <= 400; i++) {
        int64_t t = i / 2;
        w->failures += put(w->h, "root", w->child, i, i) != SHMTF_OK;
        shmtf_status st = latest(w->h, "c0", w->child, &x);
        w->failures += st != SHMTF_OK;
        shmtf_result r = {.edges = NULL};
        st = shmtf_lookup_transform(w->h, NULL, shmtf_by_name("root"), shmtf_by_name(w->child), &t, 0, &r, &e);
        w->failures += st == SHMTF_OK ? r.pose.x != (double)t : st != SHMTF_BACKWARD && st != SHMTF_NO_DATA && st != SHMTF_FORWARD;
    }
    w->failures += latest(w->h, "root", w->child, &x) != SHMTF_OK || x != 400;
    return NULL;
}

/* More threads than slots: a slot belongs to a handle's call, and is taken over by the next. */
static void check_threads(int n, unsigned slots, bool one_handle) {
    shmtf_config c = small();
    c.max_writers = slots;
    shmtf_store *h = open_new(&c);
    pthread_barrier_t barrier;
    pthread_t thread[8];
    worker w[8];
    NEED(put(h, "root", "c0", 0, 0) == SHMTF_OK);
    pthread_barrier_init(&barrier, NULL, (unsigned)n);
    for (int i = 0; i < n; i++) {
        w[i] = (worker){.h = h, .barrier = &barrier, .k = i};
        snprintf(w[i].child, sizeof w[i].child, "c%d", i % 4);
        if (!one_handle) NEED(shmtf_attach(name, 0, NULL, 0, &w[i].h, &e) == SHMTF_OK);
        NEED(pthread_create(&thread[i], NULL, work, &w[i]) == 0);
    }
    for (int i = 0; i < n; i++) {
        pthread_join(thread[i], NULL);
        EQUAL(w[i].failures, 0);
        if (!one_handle) shmtf_close(w[i].h);
    }
    pthread_barrier_destroy(&barrier);
    drop(h);
}

static void check_exhaustion(void) {
    shmtf_config c = small();
    c.max_writers = 2;
    shmtf_store *h[4];
    h[0] = open_new(&c);
    for (int i = 1; i < 4; i++) NEED(shmtf_attach(name, 0, "many", 0, &h[i], &e) == SHMTF_OK);
    EQUAL(put(h[0], "a", "b", 1, 1), SHMTF_OK);
    EQUAL(put(h[1], "a", "b", 2, 1), SHMTF_OK);
    EQUAL(put(h[2], "a", "b", 3, 1), SHMTF_FULL);
    CHECK(e.what && !strcmp(e.what, "max_writers") && e.limit == 2);
    shmtf_writer_info writers[4];
    size_t n;
    EQUAL(shmtf_writers(h[3], writers, 4, &n, &e), SHMTF_OK);
    CHECK(n == 2 && writers[0].alive && writers[0].pid == getpid());
    shmtf_close(h[1]);
    EQUAL(put(h[2], "a", "b", 3, 1), SHMTF_OK);
    shmtf_close(h[2]);
    shmtf_close(h[3]);
    drop(h[0]);
}

static void check_fork(void) {
    shmtf_config c = small();
    shmtf_store *h = open_new(&c);
    EQUAL(put(h, "a", "b", 1, 1), SHMTF_OK);
    pid_t child = fork();
    if (!child) {
        double x;
        bool ok = latest(h, "a", "b", &x) == SHMTF_OK && x == 1 && put(h, "a", "b", 2, 2) == SHMTF_OK;
        shmtf_writer_info writers[4];
        size_t n;
        ok = ok && shmtf_writers(h, writers, 4, &n, &e) == SHMTF_OK && n == 2; /* a slot of its own */
        shmtf_close(h);
        _exit(ok ? 0 : 1);
    }
    int status;
    NEED(waitpid(child, &status, 0) == child);
    CHECK(WIFEXITED(status) && WEXITSTATUS(status) == 0);
    double x;
    CHECK(latest(h, "a", "b", &x) == SHMTF_OK && x == 2);
    EQUAL(put(h, "a", "b", 3, 3), SHMTF_OK);
    drop(h);
}

static void *write_later(void *argument) {
    put(argument, "a", "b", 20, 7);
    return NULL;
}

/* Items remember handles.  When the frame behind them ends, the names still say what is meant, in every item at once. */
static void check_handles_of_an_ended_life(void) {
    shmtf_config c = small();
    shmtf_store *h = open_new(&c);
    shmtf_transform batch[2] = {edge("p", "c", 1, 1), edge("p", "c", 2, 2)};
    double x;
    EQUAL(shmtf_set_transforms(h, batch, 2, NULL, NULL, &e), SHMTF_OK);
    EQUAL(shmtf_remove_frame(h, shmtf_by_name("c"), NULL, &e), SHMTF_OK);
    EQUAL(shmtf_set_transforms(h, batch, 2, NULL, NULL, &e), SHMTF_OK);
    EQUAL(latest(h, "p", "c", &x), SHMTF_OK);
    EQUAL(x, 2);
    EQUAL(shmtf_remove_frame(h, shmtf_by_name("p"), NULL, &e), SHMTF_OK);
    EQUAL(shmtf_set_transforms(h, batch, 2, NULL, NULL, &e), SHMTF_OK);
    EQUAL(latest(h, "p", "c", &x), SHMTF_OK);
    drop(h);
}

static void check_waits(void) {
    shmtf_config c = small();
    shmtf_store *h = open_new(&c), *r;
    pthread_t thread;
    NEED(shmtf_attach(name, SHMTF_READONLY, NULL, 0, &r, &e) == SHMTF_OK);
    uint64_t version = 77, seen;
    const shmtf_ref b = shmtf_by_name("b");
    EQUAL(shmtf_wait_for_change(r, &b, 1, 0, 0, &version, &e), SHMTF_TIMEOUT);
    EQUAL(version, 0);
    EQUAL(put(h, "a", "b", 10, 1), SHMTF_OK);
    EQUAL(shmtf_wait_for_change(r, &b, 1, 0, -1, &version, &e), SHMTF_OK);
    EQUAL(version, 1);
    EQUAL(put(h, "a", "z", 10, 1), SHMTF_OK);
    EQUAL(shmtf_wait_for_change(r, &b, 1, version, 1000000, &seen, &e), SHMTF_TIMEOUT);
    EQUAL(shmtf_wait_for_change(r, NULL, 0, version, -1, &seen, &e), SHMTF_OK);
    for (int i = 0; i < 2; i++) {
        shmtf_store *who = i ? h : r;
        int64_t t = 20 + i * 5;
        shmtf_result result = {.edges = NULL};
        EQUAL(shmtf_lookup_transform(who, NULL, shmtf_by_name("a"), b, &t, 1000000, &result, &e), i ? SHMTF_FORWARD : SHMTF_NO_DATA);
        if (i) break;
        NEED(pthread_create(&thread, NULL, write_later, h) == 0);
        EQUAL(shmtf_lookup_transform(who, NULL, shmtf_by_name("a"), b, &t, -1, &result, &e), SHMTF_OK);
        CHECK(result.pose.x == 7);
        pthread_join(thread, NULL);
    }
    shmtf_close(r);
    drop(h);
}

int main(void) {
    snprintf(name, sizeof name, "shmtf-test-api-%d", (int)getpid());
    check_life_cycle();
    check_limits();
    check_strangers();
    check_threads(8, 8, true);
    check_threads(4, 5, false);
    check_exhaustion();
    check_fork();
    check_handles_of_an_ended_life();
    check_waits();
    shmtf_unlink(name, NULL);
    return check_result("api");
}
