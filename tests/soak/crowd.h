/* SPDX-License-Identifier: Apache-2.0
 *
 * What the programs about crowds have in common: processes that end with their parent, memory that they share, a clock,
 * random numbers, and quantiles.
 */
#ifndef SHMTF_TESTS_CROWD_H
#define SHMTF_TESTS_CROWD_H

#include <errno.h>
#include <signal.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include "../processes/member.h"

static inline int64_t now_ns(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (int64_t)t.tv_sec * 1000000000 + t.tv_nsec;
}

static inline uint64_t rnd(uint64_t *state) {
    *state ^= *state << 13;
    *state ^= *state >> 7;
    return *state ^= *state << 17;
}

static inline uint64_t seed_of(int k) { return (uint64_t)(k + 1) * 0x9e3779b97f4a7c15u; }

/* Zeroed, and the same memory in all processes made later. */
static inline void *shared_memory(size_t bytes) {
    void *p = mmap(NULL, bytes, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
    if (p == MAP_FAILED) stop("mmap", NULL);
    return p;
}

/* A process that runs body(k), which does not return, and that no parent leaves behind. */
static inline pid_t spawn(void (*body)(int), int k) {
    fflush(stdout);
    pid_t parent = getpid(), pid = fork();
    if (pid < 0) stop("fork", NULL);
    if (pid) return pid;
    if (prctl(PR_SET_PDEATHSIG, SIGKILL) || getppid() != parent) _exit(1);
    body(k);
    _exit(0);
}

/* Did it end as it should: signal_number 0: by itself, with 0. */
static inline int ended_well(pid_t pid, int signal_number) {
    int status;
    while (waitpid(pid, &status, 0) < 0)
        if (errno != EINTR) return 0;
    return signal_number ? WIFSIGNALED(status) && WTERMSIG(status) == signal_number : WIFEXITED(status) && !WEXITSTATUS(status);
}

static inline int compare_ns(const void *a, const void *b) {
    int64_t x = *(const int64_t *)a, y = *(const int64_t *)b;
    return (x > y) - (x < y);
}

/* Sorts the samples and prints their spread in microseconds. */
static inline void print_spread(const char *what, int64_t *ns, size_t n) {
    if (!n) return;
    qsort(ns, n, sizeof *ns, compare_ns);
    printf("%s: p50 %.1f us, p99 %.1f us, worst %.1f us\n", what, (double)ns[n / 2] / 1e3, (double)ns[n - 1 - n / 100] / 1e3,
           (double)ns[n - 1] / 1e3);
}

static inline shmtf_transform crowd_edge(const char *parent, const char *child, int64_t stamp, double x) {
    return (shmtf_transform){shmtf_by_name(parent), shmtf_by_name(child), stamp, {x, 0, 0, 0, 0, 0, 1}, 0};
}

#endif
