/* SPDX-License-Identifier: Apache-2.0
 * A store's file is cut short under living mappings: with the guard calls answer CORRUPT, and a SIGBUS that is not about
 * a store goes where it would have gone.  Each case runs in a process of its own.  Tier: test. */
#define _GNU_SOURCE
#include <fcntl.h>
#include <pthread.h>
#include <signal.h>
#include <stdbool.h>
#include <stdio.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/wait.h>
#include <unistd.h>

#include "shmtf.h"
#include "support/check.h"

static char name[64], path[96];
static _Thread_local shmtf_error e;

static shmtf_store *open_store(const char *which, unsigned flags) {
    const shmtf_config c = {.max_frames = 16, .history = 6, .cache_time_ns = -1, .stream_bytes = 0, .max_writers = 4};
    shmtf_store *h = NULL;
    shmtf_create(which, &c, 0600, &e);
    NEED(shmtf_attach(which, flags, "guard", 0, &h, &e) == SHMTF_OK);
    return h;
}
static shmtf_status put(shmtf_store *h, int64_t stamp) {
    shmtf_transform t[2] = {{shmtf_by_name("a"), shmtf_by_name("b"), stamp, {(double)stamp, 0, 0, 0, 0, 0, 1}, 0},
                            {shmtf_by_name("b"), shmtf_by_name("c"), stamp, {-(double)stamp, 0, 0, 0, 0, 0, 1}, 0}};
    const shmtf_write_options wait = {.timeout_ns = -1};
    return shmtf_set_transforms(h, t, 2, &wait, NULL, &e);
}
static shmtf_status look(shmtf_store *h, double *x) {
    shmtf_result r = {.edges = NULL};
    shmtf_status st = shmtf_lookup_latest_transform(h, NULL, shmtf_by_name("a"), shmtf_by_name("c"), 0, &r, &e);
    *x = r.pose.x;
    return st;
}
static void cut(const char *file, long bytes) { NEED(truncate(file, bytes) == 0); }

/* ---- cases: the exit code of the child is that of check_result, unless a signal is expected ---- */

static void without_guard(void) {
    double x;
    shmtf_store *h = open_store(name, 0);
    EQUAL(look(h, &x), SHMTF_LOOKUP);
    cut(path, 0);
    look(h, &x);
}

/* Every call says so, the handle can be closed, and neighbours do not notice. */
static void every_call(unsigned flags, long bytes) {
    char other[80];
    shmtf_store *h = open_store(name, 0), *r = open_store(name, flags), *more[100];
    snprintf(other, sizeof other, "%s-other", name);
    shmtf_store *o = open_store(other, 0);
    EQUAL(shmtf_guard_truncation(&e), SHMTF_OK);
    EQUAL(shmtf_guard_truncation(NULL), SHMTF_OK);
    for (int i = 0; i < 100; i++) more[i] = open_store(other, SHMTF_READONLY); /* more than a block of the list */
    EQUAL(put(h, 1), SHMTF_OK);
    EQUAL(put(o, 5), SHMTF_OK);
    double x;
    EQUAL(look(r, &x), SHMTF_OK);
    cut(path, bytes);
    size_t n;
    shmtf_info info;
    shmtf_frame frame[4];
    shmtf_frame_info about;
    shmtf_record record[4];
    shmtf_check_report report;
    shmtf_writer_info writers[4];
    shmtf_frame_words words;
    uint64_t version;
    EQUAL(look(r, &x), SHMTF_CORRUPT);
    CHECK(e.what && strstr(e.what, "cut short"));
    EQUAL(put(r, 2), SHMTF_CORRUPT);
    EQUAL(shmtf_get_info(r, &info, &e), SHMTF_CORRUPT);
    EQUAL(shmtf_frames(r, NULL, frame, 4, &n, &e), SHMTF_CORRUPT);
    EQUAL(shmtf_resolve(r, NULL, "b", frame, &e), SHMTF_CORRUPT);
    EQUAL(shmtf_get_frame_info(r, NULL, shmtf_by_name("b"), &about, &e), SHMTF_CORRUPT);
    EQUAL(shmtf_records(r, NULL, shmtf_by_name("b"), record, 4, &n, &e), SHMTF_CORRUPT);
    EQUAL(shmtf_wait_for_change(r, NULL, 0, 9, -1, &version, &e), SHMTF_CORRUPT);
    EQUAL(shmtf_writers(r, writers, 4, &n, &e), SHMTF_CORRUPT);
    EQUAL(shmtf_get_frame_words(r, shmtf_by_name("b"), &words, &e), SHMTF_CORRUPT);
    EQUAL(shmtf_check(r, 0, &report, &e), SHMTF_CORRUPT);
    shmtf_close(r);
    EQUAL(put(h, 2), SHMTF_CORRUPT); /* the first touch may be a write, too */
    shmtf_close(h);
    EQUAL(shmtf_attach(name, 0, NULL, 0, &h, &e), bytes ? SHMTF_CORRUPT : SHMTF_VERSION);
    EQUAL(put(o, 6), SHMTF_OK);
    for (int i = 0; i < 100; i++) CHECK(look(more[i], &x) == SHMTF_OK && x == 0);
    for (int i = 0; i < 100; i++) shmtf_close(more[i]);
    shmtf_close(o);
    shmtf_unlink(other, NULL);
}
static void every_call_write(void) { every_call(0, 0); }
static void every_call_readonly(void) {
    shmtf_store *h = open_store(name, SHMTF_READONLY);
    double x;
    shmtf_guard_truncation(NULL);
    CHECK(look(h, &x) == SHMTF_LOOKUP);
    cut(path, 4096);
    EQUAL(look(h, &x), SHMTF_CORRUPT);
    EQUAL(put(h, 3), SHMTF_CORRUPT);
    shmtf_close(h);
}

static void *keep_writing(void *argument) {
    shmtf_status st = SHMTF_OK;
    for (int64_t i = 2; st == SHMTF_OK; i++) st = put(argument, i);
    EQUAL(st, SHMTF_CORRUPT);
    return NULL;
}
static void *keep_reading(void *argument) {
    double x;
    shmtf_status st = SHMTF_OK;
    while (st == SHMTF_OK) {
        st = look(argument, &x);
        if (st == SHMTF_OK) NEED(x == 0); /* a found transform was there */
        if (st == SHMTF_SNAPSHOT_EXPIRED) st = SHMTF_OK;
    }
    EQUAL(st, SHMTF_CORRUPT);
    return NULL;
}
static void *keep_waiting(void *argument) {
    int64_t never = INT64_MAX;
    shmtf_result r = {.edges = NULL};
    shmtf_status st = shmtf_lookup_transform(argument, NULL, shmtf_by_name("a"), shmtf_by_name("b"), &never, -1, &r, &e);
    EQUAL(st, SHMTF_CORRUPT);
    return NULL;
}
static void *keep_watching(void *argument) {
    uint64_t version;
    EQUAL(shmtf_wait_for_change(argument, NULL, 0, UINT64_MAX >> 10, -1, &version, &e), SHMTF_CORRUPT);
    return NULL;
}
/* In the middle of reads, writes and waits of several threads, of one handle or of two. */
static void amid(int round) {
    pthread_t thread[6];
    shmtf_store *h = open_store(name, 0), *r = round & 1 ? h : open_store(name, SHMTF_READONLY);
    shmtf_guard_truncation(NULL);
    put(h, 1);
    NEED(!pthread_create(&thread[0], NULL, keep_writing, h) && !pthread_create(&thread[1], NULL, keep_writing, h));
    NEED(!pthread_create(&thread[2], NULL, keep_reading, r) && !pthread_create(&thread[3], NULL, keep_reading, r));
    NEED(!pthread_create(&thread[4], NULL, keep_waiting, r) && !pthread_create(&thread[5], NULL, keep_watching, r));
    shmtf_counters c = {0};
    while (c.commits < 200 + 37 * (uint64_t)round) shmtf_get_counters(h, &c); /* until all of them are at it */
    cut(path, round & 2 ? 0 : 4096 * (1 + round % 8)); /* the frames begin in the tenth page */
    for (int i = 0; i < 6; i++) pthread_join(thread[i], NULL);
    if (r != h) shmtf_close(r);
    shmtf_close(h);
}
static void amid_work(void) {
    for (int round = 0; round < 16; round++) {
        amid(round);
        shmtf_unlink(name, NULL);
    }
}

/* The bell is a file of its own: without it waits poll, writes go on. */
static void bell_cut(void) {
    char bell[128];
    uint64_t version;
    shmtf_info info;
    double x;
    shmtf_store *h = open_store(name, 0);
    shmtf_guard_truncation(NULL);
    put(h, 1);
    NEED(shmtf_get_info(h, &info, &e) == SHMTF_OK);
    snprintf(bell, sizeof bell, "/dev/shm/.shmtf-bell-%016llx%016llx", (unsigned long long)info.uuid[0], (unsigned long long)info.uuid[1]);
    cut(bell, 0);
    EQUAL(put(h, 2), SHMTF_OK);
    EQUAL(shmtf_wait_for_change(h, NULL, 0, info.version + 2, 1000000, &version, &e), SHMTF_TIMEOUT);
    EQUAL(shmtf_wait_for_change(h, NULL, 0, info.version, -1, &version, &e), SHMTF_OK);
    CHECK(look(h, &x) == SHMTF_OK && x == 0);
    shmtf_close(h);
}

/* ---- signals that are not about a store ---- */

static volatile char *foreign_page(void) {
    FILE *file = tmpfile();
    NEED(file && ftruncate(fileno(file), 4096) == 0);
    volatile char *page = mmap(NULL, 4096, PROT_READ | PROT_WRITE, MAP_SHARED, fileno(file), 0);
    NEED(page != MAP_FAILED && ftruncate(fileno(file), 0) == 0);
    return page;
}
static volatile char *lost_page;
static volatile sig_atomic_t calls;
static void mend(int number) {
    (void)number;
    calls++;
    mmap((void *)(uintptr_t)lost_page, 4096, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS | MAP_FIXED, -1, 0);
}
static void mend_with_info(int number, siginfo_t *info, void *context) {
    if (context && info->si_addr == lost_page) mend(number);
}
static void foreign_dies(void) {
    shmtf_guard_truncation(NULL);
    lost_page = foreign_page();
    (void)*lost_page;
}
static void sent_dies(void) {
    shmtf_store *h = open_store(name, 0);
    shmtf_guard_truncation(NULL);
    put(h, 1);
    raise(SIGBUS);
}
static void foreign_is_passed_on(void) {
    struct sigaction action = {.sa_handler = mend};
    sigaction(SIGBUS, &action, NULL);
    shmtf_guard_truncation(NULL);
    lost_page = foreign_page();
    CHECK(*lost_page == 0 && calls == 1);
    raise(SIGBUS);
    EQUAL(calls, 2);
}
static void foreign_is_passed_on_with_info(void) {
    struct sigaction action = {.sa_sigaction = mend_with_info, .sa_flags = SA_SIGINFO};
    sigaction(SIGBUS, &action, NULL);
    shmtf_guard_truncation(NULL);
    lost_page = foreign_page();
    CHECK(*lost_page == 0 && calls == 1);
}
static void ignored_stays_ignored(void) {
    signal(SIGBUS, SIG_IGN);
    shmtf_guard_truncation(NULL);
    raise(SIGBUS);
    lost_page = foreign_page();
    EQUAL(check_result("ignored"), 0);
    (void)*lost_page; /* an access cannot be ignored */
}

/* A handler above ours that reports, gives the place back, and raises the signal anew. */
static struct sigaction below;
static void report(int number) {
    calls++;
    sigaction(SIGBUS, &below, NULL);
    raise(number);
}
static void handler_above(void) {
    double x;
    struct sigaction action = {.sa_handler = report, .sa_flags = SA_NODEFER};
    shmtf_store *h = open_store(name, 0);
    shmtf_guard_truncation(NULL);
    put(h, 1);
    sigaction(SIGBUS, &action, &below);
    cut(path, 0);
    EQUAL(look(h, &x), SHMTF_CORRUPT);
    EQUAL(calls, 1);
    shmtf_close(h);
}

/* The handler is inherited, the list is not: an address of the parent's store is foreign in the child. */
static void in_a_forked_child(void) {
    double x;
    shmtf_store *h = open_store(name, 0);
    shmtf_guard_truncation(NULL);
    put(h, 1);
    for (int lost = 0; lost < 2; lost++) {
        pid_t child = fork();
        if (!child) {
            if (!lost) CHECK(look(h, &x) == SHMTF_OK && put(h, 2) == SHMTF_OK);
            cut(path, 0);
            EQUAL(look(h, &x), SHMTF_CORRUPT);
            shmtf_close(h);
            _exit(check_result("child"));
        }
        int status;
        NEED(waitpid(child, &status, 0) == child);
        EQUAL(status, 0);
        EQUAL(look(h, &x), SHMTF_CORRUPT);
    }
    shmtf_close(h);
}

/* What the child maps where the parent had a store is nothing of ours. */
static void foreign_at_an_old_address(void) {
    shmtf_store *h = open_store(name, 0);
    shmtf_guard_truncation(NULL);
    char line[512];
    unsigned long base = 0;
    FILE *maps = fopen("/proc/self/maps", "r");
    while (maps && fgets(line, sizeof line, maps))
        if (strstr(line, name) && !base) base = strtoul(line, NULL, 16);
    NEED(base && maps);
    fclose(maps);
    pid_t child = fork();
    if (!child) {
        int fd = open("/dev/shm", O_TMPFILE | O_RDWR, 0600);
        volatile char *page = mmap((void *)base, 4096, PROT_READ, MAP_SHARED | MAP_FIXED_NOREPLACE, fd, 0);
        NEED((unsigned long)page == base);
        (void)*page;
        _exit(0);
    }
    int status;
    NEED(waitpid(child, &status, 0) == child);
    shmtf_close(h);
    shmtf_unlink(name, NULL);
    CHECK(WIFSIGNALED(status) && WTERMSIG(status) == SIGBUS);
}

static void run(void (*body)(void), const char *what, int signal_number) {
    shmtf_unlink(name, NULL);
    fflush(stdout);
    pid_t child = fork();
    if (!child) {
        alarm(120); /* a hang */
        body();
        _exit(check_result(what));
    }
    int status;
    NEED(waitpid(child, &status, 0) == child);
    if (signal_number) CHECK(WIFSIGNALED(status) && WTERMSIG(status) == signal_number);
    else CHECK(WIFEXITED(status) && WEXITSTATUS(status) == 0);
    if (check_failures) fprintf(stderr, "  in %s, status %#x\n", what, (unsigned)status);
    shmtf_unlink(name, NULL);
}

#if defined(__SANITIZE_THREAD__)
enum { WATCHED = 2 }; /* it calls handlers later, when nothing is left to be mended */
#elif defined(__SANITIZE_ADDRESS__)
enum { WATCHED = 1 }; /* it has handlers of its own, which end the process otherwise */
#else
enum { WATCHED = 0 };
#endif

int main(void) {
    snprintf(name, sizeof name, "shmtf-test-guard-%d", (int)getpid());
    snprintf(path, sizeof path, "/dev/shm/%s", name);
    if (WATCHED == 2) return puts("guard: not with ThreadSanitizer") < 0;
    if (!WATCHED) {
        run(without_guard, "without the guard", SIGBUS);
        run(foreign_dies, "foreign", SIGBUS);
        run(sent_dies, "sent", SIGBUS);
        run(ignored_stays_ignored, "ignored", SIGBUS);
        run(foreign_at_an_old_address, "an old address", 0);
    }
    run(every_call_write, "every call", 0);
    run(every_call_readonly, "readonly", 0);
    run(amid_work, "amid work", 0);
    run(bell_cut, "bell", 0);
    run(foreign_is_passed_on, "passed on", 0);
    run(foreign_is_passed_on_with_info, "passed on with info", 0);
    run(handler_above, "handler above", 0);
    run(in_a_forked_child, "forked child", 0);
    return check_result("guard");
}
