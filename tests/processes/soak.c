/* SPDX-License-Identifier: Apache-2.0
 *
 * usage: soak STORE WRITERS READERS KILLS
 *
 * Writers change two groups of frames, each always as a whole: in one all values are equal, in the other they sum to
 * zero; they also give birth to frames and remove them.  They are killed with SIGKILL at random moments and replaced,
 * KILLS times, while readers check both groups at one snapshot each.  In the end nothing may be left behind.
 */
#define _GNU_SOURCE
#include <errno.h>
#include <signal.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include "member.h"

enum { GROUP = 8, MOST = 64 };

typedef struct {
    atomic_long stamp, reads, expired, commits;
    atomic_int over;
} shared;

static shared *all;
static const char *store_name;
static uint64_t random_state;
static char names[2 * GROUP][8];

static uint64_t rnd(void) {
    random_state ^= random_state << 13;
    random_state ^= random_state >> 7;
    return random_state ^= random_state << 17;
}

static const shmtf_write_options wait_long = {.timeout_ns = -1};

static void change_group(shmtf_store *h, int group) {
    shmtf_transform t[GROUP];
    shmtf_error e;
    int64_t stamp = atomic_fetch_add(&all->stamp, 1);
    if (rnd() % 8 == 0) stamp -= (int64_t)(rnd() % 6); /* late, or the same again */
    double sum = 0, equal = (double)(rnd() % 100000);
    for (int i = 0; i < GROUP; i++) {
        double x = group == 0 ? equal : i + 1 < GROUP ? (double)(int64_t)(rnd() % 2001) - 1000 : -sum;
        sum += x;
        t[i] = (shmtf_transform){shmtf_by_name("root"), shmtf_by_name(names[group * GROUP + i]), stamp, {x, 0, 0, 0, 0, 0, 1}, 0};
    }
    if (shmtf_set_transforms(h, t, GROUP, &wait_long, NULL, &e)) stop("write", &e);
    atomic_fetch_add(&all->commits, 1);
}

static void come_and_go(shmtf_store *h) {
    char name[16];
    shmtf_error e;
    snprintf(name, sizeof name, "guest%d", (int)(rnd() % 6));
    shmtf_transform t = {shmtf_by_name("root"), shmtf_by_name(name), 1, {1, 0, 0, 0, 0, 0, 1}, rnd() % 2 ? SHMTF_STATIC : 0};
    shmtf_status st = rnd() % 2 ? shmtf_set_transforms(h, &t, 1, &wait_long, NULL, &e)
                                : shmtf_remove_frame(h, shmtf_by_name(name), &wait_long, &e);
    if (st && st != SHMTF_LOOKUP) stop("a guest", &e);
}

static void writer(uint64_t seed) {
    random_state = seed * 0x9e3779b97f4a7c15ull | 1;
    shmtf_store *h = join(store_name, 0);
    for (;;) {
        if (rnd() % 16 == 0) come_and_go(h);
        else change_group(h, (int)(rnd() % 2));
    }
}

static void reader(uint64_t seed) {
    random_state = seed * 0x9e3779b97f4a7c15ull | 1;
    shmtf_store *h = join(store_name, seed % 2 ? SHMTF_READONLY : 0);
    while (!atomic_load(&all->over)) {
        shmtf_snapshot s = shmtf_take_snapshot(h);
        double x[2 * GROUP], sum = 0;
        shmtf_status st = SHMTF_OK;
        shmtf_error e;
        for (int i = 0; i < 2 * GROUP && !st; i++) {
            shmtf_result r = {.edges = NULL};
            st = shmtf_lookup_latest_transform(h, &s, shmtf_by_name("root"), shmtf_by_name(names[i]), 0, &r, &e);
            x[i] = r.pose.x;
        }
        if (st && st != SHMTF_SNAPSHOT_EXPIRED) stop("read", &e);
        atomic_fetch_add(st ? &all->expired : &all->reads, 1);
        for (int i = 0; i < GROUP && !st; i++) {
            if (x[i] != x[0]) stop("half an update: values that should be equal", NULL);
            sum += x[GROUP + i];
        }
        if (!st && sum != 0) stop("half an update: values that should sum to zero", NULL);
    }
    shmtf_close(h);
    _exit(0);
}

static pid_t spawn(void (*body)(uint64_t), uint64_t seed) {
    pid_t pid = fork();
    if (pid < 0) stop("fork", NULL);
    if (!pid) body(seed);
    return pid;
}

static int killed_by(pid_t pid, int signal_number) {
    int status;
    while (waitpid(pid, &status, 0) < 0)
        if (errno != EINTR) return 0;
    return signal_number ? WIFSIGNALED(status) && WTERMSIG(status) == signal_number : WIFEXITED(status) && !WEXITSTATUS(status);
}

/* After the last death: one writer gets everything, and nothing is held. */
static int left_behind(void) {
    shmtf_check_report report;
    shmtf_error e;
    shmtf_store *h = join(store_name, 0);
    for (int group = 0; group < 2; group++) change_group(h, group);
    if (shmtf_check(h, 1, &report, &e) || shmtf_check(h, 0, &report, &e)) stop("check", &e);
    if (report.locks_held || report.bad_words) fprintf(stderr, "left: %llu locks, %llu bad words\n", (unsigned long long)report.locks_held, (unsigned long long)report.bad_words);
    shmtf_close(h);
    return report.locks_held || report.bad_words;
}

int main(int argc, char **argv) {
    shmtf_error e;
    shmtf_config c = {.max_frames = 24, .history = 32, .cache_time_ns = -1, .stream_bytes = 0, .max_writers = 32};
    pid_t writers[MOST], readers[MOST];
    if (argc < 5) return 2;
    store_name = argv[1];
    int n_writers = atoi(argv[2]), n_readers = atoi(argv[3]), bad = 0;
    long kills = atol(argv[4]);
    all = mmap(NULL, sizeof *all, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
    if (all == MAP_FAILED || n_writers > MOST || n_readers > MOST || shmtf_create(store_name, &c, 0600, &e)) stop("create", &e);
    for (int i = 0; i < 2 * GROUP; i++) snprintf(names[i], sizeof names[i], "%c%d", i < GROUP ? 'e' : 's', i % GROUP);
    random_state = 88172645463325252ull;
    atomic_store(&all->stamp, 100);
    shmtf_store *h = join(store_name, 0);
    for (int group = 0; group < 2; group++) change_group(h, group);
    shmtf_close(h);
    uint64_t seed = 1;
    for (int i = 0; i < n_writers; i++) writers[i] = spawn(writer, seed++);
    for (int i = 0; i < n_readers; i++) readers[i] = spawn(reader, seed++);
    for (long k = 0; k < kills; k++) {
        const struct timespec moment = {0, (long)(rnd() % 4000000)};
        nanosleep(&moment, NULL);
        int i = (int)(rnd() % (uint64_t)n_writers);
        kill(writers[i], SIGKILL);
        if (!killed_by(writers[i], SIGKILL)) bad++;
        writers[i] = spawn(writer, seed++);
    }
    for (int i = 0; i < n_writers; i++) kill(writers[i], SIGKILL);
    for (int i = 0; i < n_writers; i++)
        if (!killed_by(writers[i], SIGKILL)) bad++;
    atomic_store(&all->over, 1);
    for (int i = 0; i < n_readers; i++)
        if (!killed_by(readers[i], 0)) bad++;
    bad += left_behind();
    printf("%ld kills, %ld commits, %ld snapshots of 16 frames, %ld too old, %d problems\n", kills, (long)all->commits, (long)all->reads,
           (long)all->expired, bad);
    return bad != 0;
}
