/* SPDX-License-Identifier: Apache-2.0
 *
 * Files and mappings of segments: reserve, map, reopen.  Errors are errno values.
 */
#ifndef SHMTF_SEGMENT_MAP_H
#define SHMTF_SEGMENT_MAP_H

#include <stddef.h>
#include <stdint.h>
#include <sys/types.h>

#include "segment/atomic.h"

typedef struct {
    dev_t dev;
    ino_t ino;
    uint64_t size_bytes;
    uid_t owner;
    mode_t mode;
    nlink_t links;
} map_file;

/* What is behind a descriptor.  ENODEV: not a regular file on tmpfs, whose locks and mappings cannot be relied on. */
int map_stat(int fd, map_file *file);
/* Give an empty file this size and its memory now, so that no store is ever answered by SIGBUS. */
int map_reserve(int fd, uint64_t size_bytes);
/* Another open file description of the same file, whatever its name is by now. */
int map_reopen(int fd, int writable, int *out);
/* Map a file; never inherited by forked children, never in core dumps, known to the guard (`mark`, or NULL: guard.h). */
int map_memory(int fd, uint64_t size_bytes, int writable, local_hint *mark, void **base);
void map_release(void *base, uint64_t size_bytes);
/* "/dev/shm/" and a name that contains no '/', does not start with '.', and is not too long: 0 or EINVAL. */
int map_path(const char *name, char *path, size_t size);

#endif
