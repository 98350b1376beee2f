/* SPDX-License-Identifier: Apache-2.0 */
#define _GNU_SOURCE
#include "segment/map.h"

#include <errno.h>
#include <fcntl.h>
#include <linux/magic.h>
#include <stdio.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/vfs.h>
#include <unistd.h>

#include "segment/guard.h"

int map_stat(int fd, map_file *file) {
    struct stat st;
    struct statfs fs;
    if (fstat(fd, &st) || fstatfs(fd, &fs)) return errno;
    if (!S_ISREG(st.st_mode) || fs.f_type != TMPFS_MAGIC) return ENODEV;
    *file = (map_file){st.st_dev, st.st_ino, (uint64_t)st.st_size, st.st_uid, st.st_mode & 07777, st.st_nlink};
    return 0;
}

int map_reserve(int fd, uint64_t size_bytes) {
    int e;
    struct rlimit most;
    if (!getrlimit(RLIMIT_FSIZE, &most) && size_bytes > most.rlim_cur) return EFBIG; /* or SIGXFSZ would come */
    do e = posix_fallocate(fd, 0, (off_t)size_bytes);
    while (e == EINTR);
    if (e && ftruncate(fd, 0)) return e; /* give back what was reserved; the file is to be dropped anyway */
    return e;
}

int map_reopen(int fd, int writable, int *out) {
    char path[32];
    snprintf(path, sizeof path, "/proc/self/fd/%d", fd);
    *out = open(path, (writable ? O_RDWR : O_RDONLY) | O_CLOEXEC);
    return *out < 0 ? errno : 0;
}

int map_memory(int fd, uint64_t size_bytes, int writable, local_hint *mark, void **base) {
    *base = mmap(NULL, size_bytes, writable ? PROT_READ | PROT_WRITE : PROT_READ, MAP_SHARED, fd, 0);
    if (*base == MAP_FAILED) return *base = NULL, errno;
    int e = madvise(*base, size_bytes, MADV_DONTFORK) ? errno : guard_add(*base, size_bytes, writable, mark);
    if (e) {
        munmap(*base, size_bytes);
        return *base = NULL, e;
    }
    madvise(*base, size_bytes, MADV_DONTDUMP); /* a core dump would keep the writer "alive" while it is written */
    return 0;
}

void map_release(void *base, uint64_t size_bytes) {
    if (!base) return;
    guard_remove(base);
    munmap(base, size_bytes);
}

int map_path(const char *name, char *path, size_t size) {
    size_t n = name ? strlen(name) : 0;
    if (n == 0 || n > 200 || name[0] == '.' || strchr(name, '/')) return EINVAL;
    snprintf(path, size, "/dev/shm/%s", name);
    return 0;
}
