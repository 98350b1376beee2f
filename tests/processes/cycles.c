/* SPDX-License-Identifier: Apache-2.0
 *
 * usage: cycles STORE CYCLES KILLS
 *
 * Attach, write, wait, read, close, CYCLES times in one process; then KILLS processes that attach, write without end and are
 * killed.  Prints "descriptors D mappings M slots S locks L": what is left beyond what was there before, which should be
 * nothing: descriptors and mappings of this process, slots that a live process holds, frames that stay locked.
 */
#define _GNU_SOURCE
#include <dirent.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/wait.h>
#include <unistd.h>

#include "member.h"

static long count_descriptors(void) {
    long n = 0;
    DIR *d = opendir("/proc/self/fd");
    while (d && readdir(d)) n++;
    if (d) closedir(d);
    return n;
}
static long count_mappings(void) {
    char line[512];
    long n = 0;
    FILE *maps = fopen("/proc/self/maps", "r");
    while (maps && fgets(line, sizeof line, maps)) n += strstr(line, "/dev/shm/") != NULL;
    if (maps) fclose(maps);
    return n;
}

static void put(shmtf_store *h, int64_t stamp) {
    shmtf_error e;
    shmtf_transform t[2] = {{shmtf_by_name("a"), shmtf_by_name("b"), stamp, {0, 0, 0, 0, 0, 0, 1}, 0},
                            {shmtf_by_name("b"), shmtf_by_name("c"), stamp, {0, 0, 0, 0, 0, 0, 1}, 0}};
    const shmtf_write_options wait = {.timeout_ns = -1};
    if (shmtf_set_transforms(h, t, 2, &wait, NULL, &e)) stop("write", &e);
}

static void cycle(const char *name, int64_t k) {
    uint64_t version;
    shmtf_error e;
    shmtf_result r = {.edges = NULL};
    shmtf_store *h = join(name, k % 3 == 2 ? SHMTF_READONLY : 0);
    if (k % 3 != 2) put(h, k);
    if (k % 7 == 0 && shmtf_wait_for_change(h, NULL, 0, 0, -1, &version, &e)) stop("wait", &e);
    if (shmtf_lookup_latest_transform(h, NULL, shmtf_by_name("a"), shmtf_by_name("c"), 0, &r, &e)) stop("read", &e);
    shmtf_close(h);
}

static void victim(const char *name, int ready) {
    shmtf_store *h = join(name, 0);
    for (int64_t k = 1ll << 40;; k++) {
        put(h, k);
        if (k % 64 == 32 && write(ready, "x", 1) != 1) _exit(1);
    }
}

int main(int argc, char **argv) {
    if (argc != 4) return 2;
    const char *name = argv[1];
    long cycles = atol(argv[2]), kills = atol(argv[3]);
    cycle(name, 0);
    long descriptors = count_descriptors(), mappings = count_mappings();
    for (long k = 1; k <= cycles; k++) cycle(name, k);
    for (long k = 0; k < kills; k++) {
        int ends[2];
        char c;
        if (pipe(ends)) return 1;
        pid_t pid = fork();
        if (!pid) victim(name, ends[1]);
        for (long i = 0; i <= k % 3; i++)
            if (read(ends[0], &c, 1) != 1) return 1;
        kill(pid, SIGKILL);
        waitpid(pid, NULL, 0);
        close(ends[0]);
        close(ends[1]);
    }
    descriptors = count_descriptors() - descriptors;
    mappings = count_mappings() - mappings;
    shmtf_store *h = join(name, 0);
    shmtf_error e;
    shmtf_writer_info writers[1024];
    size_t n, alive = 0;
    put(h, 1ll << 60); /* the locks of the last victim are taken from it */
    if (shmtf_writers(h, writers, 1024, &n, &e)) stop("writers", &e);
    for (size_t i = 0; i < n; i++) alive += writers[i].alive && writers[i].pid != getpid();
    shmtf_check_report report;
    if (shmtf_check(h, 0, &report, &e)) stop("check", &e);
    printf("descriptors %ld mappings %ld slots %zu locks %llu\n", descriptors, mappings, alive, (unsigned long long)report.locks_held);
    shmtf_close(h);
    return 0;
}
