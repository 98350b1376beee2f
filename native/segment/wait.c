/* SPDX-License-Identifier: Apache-2.0 */
#define _GNU_SOURCE
#include "segment/wait.h"

#include <errno.h>
#include <fcntl.h>
#include <linux/futex.h>
#include <limits.h>
#include <stdio.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

enum { BELL_BYTES = 4096 };
_Static_assert(sizeof(bell) <= BELL_BYTES, "the bell is one page");

int64_t clock_monotonic_ns(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (int64_t)t.tv_sec * 1000000000 + t.tv_nsec;
}

int64_t clock_realtime_ns(void) {
    struct timespec t;
    clock_gettime(CLOCK_REALTIME, &t);
    return (int64_t)t.tv_sec * 1000000000 + t.tv_nsec;
}

int clock_sleep_ns(int64_t ns) {
    struct timespec t = {ns / 1000000000, ns % 1000000000};
    return clock_nanosleep(CLOCK_MONOTONIC, 0, &t, NULL);
}

void bell_path(const uint64_t uuid[2], char path[64]) {
    snprintf(path, 64, "/dev/shm/.shmtf-bell-%016llx%016llx", (unsigned long long)uuid[0], (unsigned long long)uuid[1]);
}

int bell_remove(const uint64_t uuid[2]) {
    char path[64];
    bell_path(uuid, path);
    return unlink(path) ? errno : 0;
}

/* Made whole before it has a name, like the store. */
static int make_bell(const char *path, const map_file *file) {
    char self[32];
    int fd = open("/dev/shm", O_TMPFILE | O_RDWR | O_CLOEXEC, 0600);
    if (fd < 0) fd = open(path, O_RDWR | O_CREAT | O_EXCL | O_CLOEXEC | O_NOFOLLOW, 0600);
    if (fd < 0) return -1;
    mode_t mode = (file->mode & 0222) | (file->mode & 0222) << 1; /* who may write the store, read and write */
    snprintf(self, sizeof self, "/proc/self/fd/%d", fd);
    if (map_reserve(fd, BELL_BYTES) || fchmod(fd, mode | 0600) ||
        (linkat(AT_FDCWD, self, AT_FDCWD, path, AT_SYMLINK_FOLLOW) && errno != EEXIST)) {
        close(fd);
        return -1;
    }
    close(fd);
    return open(path, O_RDWR | O_CLOEXEC | O_NOFOLLOW); /* ours, or that of whoever was first */
}

bell *bell_open(const uint64_t uuid[2], const map_file *file) {
    char path[64];
    map_file found;
    void *base = NULL;
    bell_path(uuid, path);
    int fd = open(path, O_RDWR | O_CLOEXEC | O_NOFOLLOW);
    if (fd < 0 && errno == ENOENT && geteuid() == file->owner && file->links) fd = make_bell(path, file);
    if (fd < 0) return NULL;
    if (map_stat(fd, &found) || found.owner != file->owner || found.size_bytes != BELL_BYTES || map_memory(fd, BELL_BYTES, 1, NULL, &base))
        base = NULL;
    close(fd);
    return base;
}

void bell_close(bell *b) { map_release(b, BELL_BYTES); }

static long futex(shmtf_word32 *word, int op, uint32_t value, const struct timespec *timeout) {
    return syscall(SYS_futex, word, op, value, timeout, NULL, 0);
}

void bell_ring(bell *b, const bell_set *touched) {
    for (int i = 0; i < BELL_WORDS; i++) {
        uint64_t bits = load_seq_cst(&b->armed[i]) & touched->bits[i];
        if (!bits) continue;
        fetch_and_acq_rel(&b->armed[i], ~bits);
        for (; bits; bits &= bits - 1) {
            shmtf_word32 *word = &b->word[i * 64 + __builtin_ctzll(bits)];
            increment32(word);
            futex(word, FUTEX_WAKE, INT_MAX, NULL);
        }
    }
}

void bell_arm(bell *b, const unsigned *buckets, unsigned n, uint32_t *seen) {
    for (unsigned i = 0; i < n; i++) {
        seen[i] = load32_acquire(&b->word[buckets[i]]);
        fetch_or_seq_cst(&b->armed[buckets[i] / 64], 1ull << buckets[i] % 64); /* [E9 seq_cst] */
    }
}

static struct timespec to_timespec(int64_t ns) { return (struct timespec){ns / 1000000000, ns % 1000000000}; }

int bell_sleep(bell *b, const unsigned *buckets, unsigned n, const uint32_t *seen, int64_t timeout_ns) {
    enum { SLICE_NS = 100000000 };
    if (timeout_ns > SLICE_NS) timeout_ns = SLICE_NS;
    if (n == 1) {
        struct timespec t = to_timespec(timeout_ns);
        long r = futex(&b->word[buckets[0]], FUTEX_WAIT, seen[0], &t);
        return r < 0 && errno == EINTR ? EINTR : 0;
    }
#ifdef SYS_futex_waitv
    struct futex_waitv waiters[BELL_MAX_WAIT];
    for (unsigned i = 0; i < n; i++)
        waiters[i] = (struct futex_waitv){.val = seen[i], .uaddr = (uintptr_t)&b->word[buckets[i]], .flags = FUTEX_32};
    struct timespec until = to_timespec(clock_monotonic_ns() + timeout_ns);
    long r = syscall(SYS_futex_waitv, waiters, n, 0, &until, CLOCK_MONOTONIC);
    if (r >= 0 || errno != ENOSYS) return r < 0 && errno == EINTR ? EINTR : 0;
#endif
    return clock_sleep_ns(timeout_ns < 1000000 ? timeout_ns : 1000000); /* an old kernel: poll */
}
