/* SPDX-License-Identifier: Apache-2.0
 * The n-th call of the system fails, for every n and each error it may answer, while a store is created, attached, first
 * written, waited for, closed and unlinked: the call under test ends with success or an error, nothing stays open, mapped or
 * named, and the next attempt succeeds.  The linker puts the functions below before the system's (see CMakeLists.txt).
 * Tier: test. */
#define _GNU_SOURCE
#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <linux/futex.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/statfs.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

#include "shmtf.h"
#include "support/check.h"

static bool armed;
static long countdown;
static int error_wanted;
static const char *failed; /* the function that failed, or NULL */

/* Is this the call that fails? */
static bool fails(const char *what) {
    if (!armed || countdown-- != 0) return false;
    failed = what;
    errno = error_wanted;
    return true;
}

#define WRAP(type, name, parameters, arguments, failure) \
    type __real_##name parameters;                       \
    type __wrap_##name parameters;                       \
    type __wrap_##name parameters { return fails(#name) ? (failure) : __real_##name arguments; }

WRAP(int, fstat, (int fd, struct stat *st), (fd, st), -1)
WRAP(int, fstatfs, (int fd, struct statfs *st), (fd, st), -1)
WRAP(void *, mmap, (void *at, size_t n, int prot, int flags, int fd, off_t off), (at, n, prot, flags, fd, off), MAP_FAILED)
WRAP(int, madvise, (void *at, size_t n, int advice), (at, n, advice), -1)
WRAP(int, posix_fallocate, (int fd, off_t at, off_t n), (fd, at, n), error_wanted)
WRAP(int, linkat, (int a, const char *from, int b, const char *to, int flags), (a, from, b, to, flags), -1)
WRAP(int, unlink, (const char *path), (path), -1)
WRAP(int, fchmod, (int fd, mode_t mode), (fd, mode), -1)
WRAP(int, access, (const char *path, int mode), (path, mode), -1)
WRAP(ssize_t, getrandom, (void *to, size_t n, unsigned flags), (to, n, flags), -1)
WRAP(int, clock_nanosleep, (clockid_t c, int flags, const struct timespec *t, struct timespec *left), (c, flags, t, left), EINTR)
WRAP(void *, calloc, (size_t n, size_t size), (n, size), NULL)
WRAP(void *, realloc, (void *old, size_t n), (old, n), NULL)

int __real_close(int fd);
int __wrap_close(int fd);
int __wrap_close(int fd) { /* closes all the same, as Linux does */
    int done = __real_close(fd);
    return fails("close") ? -1 : done;
}
int __real_open(const char *path, int flags, ...);
int __wrap_open(const char *path, int flags, ...);
int __wrap_open(const char *path, int flags, ...) {
    va_list more;
    va_start(more, flags);
    int fd = fails("open") ? -1 : __real_open(path, flags, va_arg(more, int));
    va_end(more);
    return fd;
}
int __real_fcntl(int fd, int command, ...);
int __wrap_fcntl(int fd, int command, ...);
int __wrap_fcntl(int fd, int command, ...) {
    va_list more;
    va_start(more, command);
    int done = fails("fcntl") ? -1 : __real_fcntl(fd, command, va_arg(more, void *));
    va_end(more);
    return done;
}
long __real_syscall(long number, ...);
long __wrap_syscall(long number, ...);
long __wrap_syscall(long number, ...) {
    long a[6];
    va_list more;
    va_start(more, number);
    for (int i = 0; i < 6; i++) a[i] = va_arg(more, long);
    va_end(more);
    return fails("syscall") ? -1 : __real_syscall(number, a[0], a[1], a[2], a[3], a[4], a[5]);
}

/* ---- what stays behind ---- */

static char name[64];
static char bell[128];

static long count_entries(const char *directory, const char *part) {
    long n = 0;
    DIR *d = opendir(directory);
    NEED(d);
    for (struct dirent *entry; (entry = readdir(d));) n += strstr(entry->d_name, part) != NULL;
    closedir(d);
    return n;
}
/* Descriptors; mappings of files in shared memory; names of ours. */
static void take_stock(long stock[3]) {
    char line[512];
    stock[0] = count_entries("/proc/self/fd", "");
    FILE *maps = fopen("/proc/self/maps", "r");
    NEED(maps);
    for (stock[1] = 0; fgets(line, sizeof line, maps);) stock[1] += strstr(line, "/dev/shm/") != NULL;
    fclose(maps);
    stock[2] = count_entries("/dev/shm", name) + (bell[0] && access(bell, F_OK) == 0);
}

/* ---- the steps of a store's life ---- */

typedef struct {
    shmtf_store *h;
    shmtf_error e;
} life;

static const shmtf_config config = {.max_frames = 8, .history = 6, .cache_time_ns = -1, .stream_bytes = 0, .max_writers = 4};

static shmtf_status do_create(life *l) { return shmtf_create(name, &config, 0600, &l->e); }
static shmtf_status do_attach(life *l) { return shmtf_attach(name, 0, "syscalls", 0, &l->h, &l->e); }
static shmtf_status do_attach_readonly(life *l) { return shmtf_attach(name, SHMTF_READONLY, "syscalls", 0, &l->h, &l->e); }
static shmtf_status do_write(life *l) {
    shmtf_transform t = {shmtf_by_name("a"), shmtf_by_name("b"), 1, {0, 0, 0, 0, 0, 0, 1}, 0};
    return shmtf_set_transforms(l->h, &t, 1, NULL, NULL, &l->e);
}
static shmtf_status do_wait(life *l) {
    uint64_t version;
    shmtf_status st = shmtf_wait_for_change(l->h, NULL, 0, 99, 2000000, &version, &l->e);
    return st == SHMTF_TIMEOUT ? SHMTF_OK : st;
}
static shmtf_status do_list(life *l) {
    size_t n;
    shmtf_writer_info writers[4];
    shmtf_frame_info info;
    shmtf_status st = shmtf_writers(l->h, writers, 4, &n, &l->e);
    return st == SHMTF_OK ? shmtf_get_frame_info(l->h, NULL, shmtf_by_name("b"), &info, &l->e) : st;
}
static shmtf_status do_close(life *l) {
    shmtf_close(l->h);
    l->h = NULL;
    return SHMTF_OK;
}
static shmtf_status do_unlink(life *l) { return shmtf_unlink(name, &l->e); }

static shmtf_status (*const steps[])(life *) = {do_create, do_attach_readonly, do_close, do_attach, do_write, do_wait, do_list, do_close, do_unlink};
enum { N_STEPS = sizeof steps / sizeof *steps };

/* The life with its step `at` under test.  False: the n-th call did not come. */
static bool live(int at, long n, int error, long tried[2]) {
    long before[3], after[3];
    bool hit = false;
    life l = {.h = NULL};
    bell[0] = 0;
    take_stock(before);
    for (int i = 0; i < N_STEPS; i++) {
        if (i != at) {
            if (!CHECK(steps[i](&l) == SHMTF_OK)) fprintf(stderr, "  step %d beside step %d, call %ld failing in %s with %d\n", i, at, n, failed, error);
        } else {
            countdown = n;
            error_wanted = error;
            failed = NULL;
            armed = true;
            shmtf_status st = steps[i](&l);
            armed = false;
            hit = failed != NULL;
            bool right = st == SHMTF_OK || (st == l.e.status && st != SHMTF_CORRUPT && l.e.what && l.e.what[0]);
            if (!right) fprintf(stderr, "  step %d, call %ld is %s failing with %d: status %d\n", i, n, failed, error, (int)st);
            CHECK(right);
            tried[st != SHMTF_OK] += hit;
            bool attaches = steps[i] == do_attach || steps[i] == do_attach_readonly;
            CHECK(!attaches || st == SHMTF_OK || !l.h); /* no handle beside an error */
            if (st != SHMTF_OK && !CHECK(steps[i](&l) == SHMTF_OK)) fprintf(stderr, "  again: step %d after call %ld, %s, failed with %d\n", i, n, failed, error);
        }
        if (steps[i] == do_attach && l.h) {
            shmtf_info info;
            shmtf_get_info(l.h, &info, NULL);
            snprintf(bell, sizeof bell, "/dev/shm/.shmtf-bell-%016llx%016llx", (unsigned long long)info.uuid[0], (unsigned long long)info.uuid[1]);
        }
    }
    take_stock(after);
    /* Who may not look into a store removes it without its bell; and a bell that is said not to be there is not removed. */
    bool told = steps[at] == do_unlink && failed && ((error == ENOENT && !strcmp(failed, "unlink")) ||
                                                     ((error == EACCES || error == EPERM) && !strcmp(failed, "open")));
    if (told) {
        unlink(bell);
        after[2] = before[2];
    }
    for (int k = 0; k < 3; k++)
        if (after[k] != before[k]) {
            static const char *const kind[] = {"descriptors", "mappings", "names"};
            fprintf(stderr, "  %s: %ld, then %ld: step %d, call %ld, %s failed with %d\n", kind[k], before[k], after[k], at, n, failed, error);
            CHECK(after[k] == before[k]);
            unlink(bell);
        }
    return hit;
}

int main(void) {
    static const int errors[] = {ENOMEM, ENOSPC, EMFILE, EINTR, EACCES, EPERM, EINVAL, ENOENT, ENOSYS, EIO, ENOLCK, EAGAIN};
    long tried[2] = {0, 0}, calls = 0;
    snprintf(name, sizeof name, "shmtf-test-syscalls-%d", (int)getpid());
    alarm(240);
    shmtf_guard_truncation(NULL);
    for (int at = 0; at < N_STEPS; at++)
        for (long n = 0;; n++) {
            bool hit = true;
            for (size_t k = 0; k < sizeof errors / sizeof *errors && hit; k++) hit = live(at, n, errors[k], tried);
            if (!hit) break;
            calls++;
        }
    printf("syscalls: %ld calls, %ld failures survived, %ld reported\n", calls, tried[0], tried[1]);
    CHECK(calls > 30);
    return check_result("syscalls");
}
