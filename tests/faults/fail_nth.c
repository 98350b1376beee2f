/* SPDX-License-Identifier: Apache-2.0
 *
 * For LD_PRELOAD: once armed, the n-th call of these functions fails with the given error. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <stdarg.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/types.h>
#include <sys/vfs.h>

static long countdown = -1;
static int error_wanted, failed;

void fail_arm(long n, int error);
int fail_disarm(void);

void fail_arm(long n, int error) {
    failed = 0;
    error_wanted = error;
    countdown = n + 1;
}
/* Did a call fail since? */
int fail_disarm(void) {
    countdown = -1;
    return failed;
}

static int fails(void) {
    if (countdown <= 0 || --countdown) return 0;
    failed = 1;
    errno = error_wanted;
    return 1;
}

#define WRAP(type, name, parameters, arguments, failure)             \
    type name parameters {                                           \
        static type(*real) parameters;                               \
        if (!real) real = (type(*) parameters)dlsym(RTLD_NEXT, #name); \
        return fails() ? (failure) : real arguments;                 \
    }
#define WRAP_OPEN(name)                                              \
    int name(const char *path, int flags, ...) {                     \
        static int (*real)(const char *, int, ...);                  \
        va_list more;                                                \
        va_start(more, flags);                                       \
        mode_t mode = va_arg(more, mode_t);                          \
        va_end(more);                                                \
        if (!real) real = (int (*)(const char *, int, ...))dlsym(RTLD_NEXT, #name); \
        return fails() ? -1 : real(path, flags, mode);               \
    }
#define WRAP_FCNTL(name)                                             \
    int name(int fd, int command, ...) {                             \
        static int (*real)(int, int, ...);                           \
        va_list more;                                                \
        va_start(more, command);                                     \
        void *argument = va_arg(more, void *);                       \
        va_end(more);                                                \
        if (!real) real = (int (*)(int, int, ...))dlsym(RTLD_NEXT, #name); \
        return fails() ? -1 : real(fd, command, argument);           \
    }

WRAP_OPEN(open)
WRAP_OPEN(open64)
WRAP_FCNTL(fcntl)
WRAP_FCNTL(fcntl64)
WRAP(int, shm_open, (const char *name, int flags, mode_t mode), (name, flags, mode), -1)
WRAP(int, shm_unlink, (const char *name), (name), -1)
WRAP(int, fstat, (int fd, struct stat *st), (fd, st), -1)
WRAP(int, fstatfs, (int fd, struct statfs *st), (fd, st), -1)
WRAP(int, madvise, (void *at, size_t n, int advice), (at, n, advice), -1)
WRAP(int, posix_fallocate, (int fd, off_t at, off_t n), (fd, at, n), error_wanted)
WRAP(int, linkat, (int a, const char *from, int b, const char *to, int flags), (a, from, b, to, flags), -1)
WRAP(int, fchmod, (int fd, mode_t mode), (fd, mode), -1)
WRAP(int, unlink, (const char *path), (path), -1)
WRAP(void *, mmap, (void *at, size_t n, int prot, int flags, int fd, off_t off), (at, n, prot, flags, fd, off), MAP_FAILED)
