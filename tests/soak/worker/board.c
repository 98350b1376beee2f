/* SPDX-License-Identifier: Apache-2.0 */
#define _GNU_SOURCE
#include "board.h"

#include <fcntl.h>
#include <stdio.h>
#include <string.h>
#include <sys/mman.h>
#include <time.h>
#include <unistd.h>

board_globals *board;
board_cell *cell;

void board_open(const char *path, int number) {
    size_t bytes = (size_t)(number + 2) * 8 * PAGE_WORDS;
    int fd = open(path, O_RDWR | O_CLOEXEC);
    void *p = fd < 0 ? MAP_FAILED : mmap(NULL, bytes, PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0);
    if (p == MAP_FAILED) {
        perror(path);
        _exit(2);
    }
    close(fd);
    board = p;
    cell = (board_cell *)(void *)((char *)p + (size_t)(number + 1) * 8 * PAGE_WORDS);
}

_Noreturn static void give_up(const char *text) {
    fprintf(stderr, "process %d: %s\n", (int)getpid(), text);
    snprintf(cell->text, sizeof cell->text, "%s", text);
    atomic_store(&cell->violated, 1);
    _exit(3);
}

_Noreturn void violation(const char *what, const shmtf_error *e) {
    char text[512], message[256] = "";
    if (e) shmtf_error_message(e, message, sizeof message);
    snprintf(text, sizeof text, "%s%s%s", what, e ? ": " : "", message);
    give_up(text);
}

_Noreturn void violation_numbers(const char *what, long long a, long long b) {
    char text[512];
    snprintf(text, sizeof text, "%s: %lld, %lld", what, a, b);
    give_up(text);
}

static long long clock_ns(clockid_t clock) {
    struct timespec t;
    clock_gettime(clock, &t);
    return (long long)t.tv_sec * 1000000000 + t.tv_nsec;
}

stopwatch watch_start(void) {
    stopwatch w = {.stops = atomic_load(&cell->stops)};
    w.cpu = clock_ns(CLOCK_THREAD_CPUTIME_ID);
    w.wall = clock_ns(CLOCK_MONOTONIC);
    return w;
}

/* Four buckets for each power of two. */
static int bucket_of(long long ns) {
    int log = 63 - __builtin_clzll((unsigned long long)ns | 4);
    int at = 4 * log + (int)((unsigned long long)ns >> (log - 2) & 3);
    return at < BUCKETS ? at : BUCKETS - 1;
}

static long long note(const stopwatch *w, word *histogram, word *worst) {
    long long wall = clock_ns(CLOCK_MONOTONIC) - w->wall;
    if (atomic_load(&cell->stops) != w->stops) return 0;
    atomic_fetch_add_explicit(&histogram[bucket_of(wall)], 1, memory_order_relaxed);
    raise_word(worst, wall);
    return 1;
}

void watch_read(const stopwatch *w) {
    if (note(w, cell->read, &cell->worst_read)) raise_word(&cell->worst_read_cpu, clock_ns(CLOCK_THREAD_CPUTIME_ID) - w->cpu);
}

void watch_write(const stopwatch *w) { note(w, cell->write, &cell->worst_write); }

void board_counters(shmtf_store *h, shmtf_counters *last) {
    shmtf_counters now;
    shmtf_get_counters(h, &now);
    const uint64_t more[9] = {now.commits - last->commits,       now.aborts - last->aborts,     now.helps - last->helps,
                              now.recoveries - last->recoveries, now.rereads - last->rereads,   now.restarts - last->restarts,
                              now.waits - last->waits,           now.late_dropped - last->late_dropped, now.repeats - last->repeats};
    for (int i = 0; i < 9; i++)
        if (more[i]) atomic_fetch_add_explicit(&cell->counters[i], (long long)more[i], memory_order_relaxed);
    *last = now;
}
