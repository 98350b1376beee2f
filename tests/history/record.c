/* SPDX-License-Identifier: Apache-2.0
 *
 * usage: history_record --unlink STORE
 *        history_record STORE LOG SEED MILLISECONDS WRITERS READERS KILLS_PER_SECOND [CHAOS [KIB_PER_PROCESS]]
 *
 * Real processes work on one store and log what they asked and what they were told; writers are killed at random
 * moments and replaced.  Half of the readers are attached read-only.  CHAOS > 0 makes processes give up their processor,
 * or sleep, at about that many of 4,096 shared accesses, so that what is one instruction apart comes to be a scheduling
 * apart; and writers then also kill themselves before a store.  The log is judged by history_replay.
 */
#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <sched.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include "operations.h"
#include "segment/atomic.h"
#include "segment/failpoint.h"

static history_control *all;
static const char *store_name;
static long kills_per_second;
static uint64_t chaos, chaos_state = 1;
static bool mortal;
enum { STORES_OF_A_LIFE = 16384 };

static void stop(const char *what, const shmtf_error *e) {
    char text[256] = "";
    if (e) shmtf_error_message(e, text, sizeof text);
    fprintf(stderr, "process %d: %s %s\n", (int)getpid(), what, text);
    _exit(1);
}

/* ---- disorder ---------------------------------------------------------------------------------------------- */

static void disturb(uint64_t of_4096) {
    chaos_state ^= chaos_state << 13;
    chaos_state ^= chaos_state >> 7;
    chaos_state ^= chaos_state << 17;
    if ((chaos_state >> 8 & 4095) >= of_4096) return;
    bool long_enough_for_many_commits = (chaos_state >> 34 & 15) == 0;
    const struct timespec moment = {0, (long)(chaos_state >> 40 & 0xffff) << (long_enough_for_many_commits ? 6 : 0)};
    if (chaos_state >> 32 & 3) sched_yield();
    else nanosleep(&moment, NULL);
}

#ifdef SHMTF_STEPS
void shmtf_step(int kind, const void *word) {
    (void)word;
    if (!chaos) return;
    disturb(chaos);
    if (mortal && kind == SHMTF_STEP_STORE && (chaos_state >> 16) % STORES_OF_A_LIFE == 0) kill(getpid(), SIGKILL);
}
void shmtf_failpoint(const char *name) {
    (void)name;
    if (chaos) disturb(8 * chaos);
}
#endif

/* ---- processes --------------------------------------------------------------------------------------------- */

static member join(unsigned buffer, unsigned flags) {
    shmtf_error e;
    member m = {.all = all, .n = buffer, .process = (uint32_t)atomic_fetch_add(&all->incarnations, 1)};
    m.buffer = (char *)all + HISTORY_HEADER + buffer * all->buffer_bytes;
    m.random = (all->seed + 1) * 0x9e3779b97f4a7c15ull ^ (m.process + 1) * 0xd1342543de82ef95ull;
    chaos_state = m.random | 1;
    m.next_value = (uint64_t)m.process << 24 | 1;
    for (int i = 0; i < N_NAMES; i++) {
        char kind = i == 0 ? 'w' : i < FIRST_BANK ? 'g' : i < FIRST_FREE ? 'b' : 'a';
        snprintf(m.names[i], sizeof m.names[i], "%c%d", kind, i);
    }
    if (shmtf_attach(store_name, flags, NULL, 0, &m.h, &e)) stop("attach", &e);
    for (int i = 0; i < BANK && !(flags & SHMTF_READONLY); i++) /* not there yet for the first to come */
        if (shmtf_resolve(m.h, NULL, m.names[FIRST_BANK + i], &m.bank[i], &e)) m.bank[i] = (shmtf_frame){0, 0};
    return m;
}

static void work(unsigned buffer, bool writes) {
    member m = join(buffer, !writes && buffer % 2 ? SHMTF_READONLY : 0);
    mortal = writes && kills_per_second;
    while (!atomic_load(&all->over) && member_has_room(&m)) {
        if (writes && member_random(&m) % 4) write_something(&m);
        else read_something(&m);
    }
    _exit(0); /* not shmtf_close: a store has to bear that, too */
}

static pid_t spawn(unsigned buffer, bool writes) {
    pid_t pid = fork();
    if (pid < 0) stop("fork", NULL);
    if (!pid) {
        prctl(PR_SET_PDEATHSIG, SIGKILL);
        work(buffer, writes);
    }
    return pid;
}

/* How a process ended: 0 if as it should. */
static int reap(pid_t pid, bool killed) {
    int status;
    while (waitpid(pid, &status, 0) < 0)
        if (errno != EINTR) return 1;
    if (WIFEXITED(status)) return WEXITSTATUS(status) != 0;
    return !killed || WTERMSIG(status) != SIGKILL;
}

/* What the dead had under way has happened by now, or never will. */
static void close_pending(unsigned buffer, uint64_t version) {
    char *at = (char *)all + HISTORY_HEADER + buffer * all->buffer_bytes, *end = at + atomic_load(&all->used[buffer]);
    static char *last[MOST_BUFFERS]; /* where the last search ended */
    for (at = last[buffer] ? last[buffer] : at; at < end;) {
        history_entry *e = (history_entry *)(void *)at;
        at += history_size(e);
        if (e->status != PENDING) continue;
        e->high = version;
        e->time = (int64_t)atomic_fetch_add(&all->order, 1);
    }
    last[buffer] = at;
}

static history_control *make_log(const char *path, uint64_t n_buffers, uint64_t bytes) {
    int fd = open(path, O_RDWR | O_CREAT | O_TRUNC | O_CLOEXEC, 0600);
    uint64_t size = HISTORY_HEADER + n_buffers * bytes;
    if (fd < 0 || ftruncate(fd, (off_t)size)) stop("the log cannot be made", NULL);
    history_control *c = mmap(NULL, size, PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0);
    if (c == MAP_FAILED) stop("the log cannot be mapped", NULL);
    close(fd);
    c->n_buffers = n_buffers;
    c->buffer_bytes = bytes;
    atomic_store(&c->order, 1);
    atomic_store(&c->stamp, 1000);
    return c;
}

static void make_store(uint64_t seed) {
    static const unsigned live[] = {14, 30, 60};
    shmtf_error e;
    shmtf_config c = {.max_frames = N_NAMES + 11, .history = live[seed % 3], .cache_time_ns = -1, .stream_bytes = 0, .max_writers = 64};
    if (seed / 3 % 2) c.cache_time_ns = 40000; /* in stamps of the log: 40 */
    if (shmtf_create(store_name, &c, 0600, &e)) stop("create", &e);
    all->seed = seed;
    all->live = live[seed % 3];
    all->cache_time_ns = c.cache_time_ns;
    all->magic = HISTORY_MAGIC;
}

static int64_t now_ms(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (int64_t)t.tv_sec * 1000 + t.tv_nsec / 1000000;
}

int main(int argc, char **argv) {
    if (argc == 3 && !strcmp(argv[1], "--unlink")) return shmtf_unlink(argv[2], NULL) != SHMTF_OK;
    if (argc < 8) return 2;
    store_name = argv[1];
    uint64_t seed = strtoull(argv[3], NULL, 0), kib = argc > 9 ? strtoull(argv[9], NULL, 0) : 64 << 10;
    long milliseconds = atol(argv[4]), kills = 0;
    kills_per_second = atol(argv[7]);
    unsigned n_writers = (unsigned)atoi(argv[5]), n = n_writers + (unsigned)atoi(argv[6]);
    pid_t pids[MOST_BUFFERS];
    int bad = 0;
    if (n + 1 > MOST_BUFFERS) return 2;
    all = make_log(argv[2], n + 1, kib << 10);
    make_store(seed);
    member first = join(n, 0);
    write_group(&first);
    write_bank(&first);
    chaos = argc > 8 ? strtoull(argv[8], NULL, 0) : 0;
    for (unsigned i = 0; i < n; i++) pids[i] = spawn(i, i < n_writers);
    const int64_t until = now_ms() + milliseconds;
    while (now_ms() < until) {
        long pause = kills_per_second ? 1000000000 / kills_per_second : 10000000;
        const struct timespec moment = {0, (long)(member_random(&first) % (uint64_t)(2 * pause)) % 1000000000};
        nanosleep(&moment, NULL);
        if (!kills_per_second || !n_writers) continue;
        unsigned i = (unsigned)(member_random(&first) % n_writers);
        kill(pids[i], SIGKILL);
        bad += reap(pids[i], true);
        close_pending(i, shmtf_commit_version(first.h));
        pids[i] = spawn(i, true);
        kills++;
    }
    atomic_store(&all->over, 1);
    for (unsigned i = 0; i < n; i++) bad += reap(pids[i], i < n_writers && kills_per_second);
    chaos = 0;
    read_all(&first);
    printf("seed %llu: %u writers, %u readers, %ld kills, %llu commits, %d failed\n", (unsigned long long)seed, n_writers, n - n_writers,
           kills, (unsigned long long)shmtf_commit_version(first.h), bad);
    shmtf_close(first.h);
    shmtf_unlink(store_name, NULL);
    return bad != 0;
}
