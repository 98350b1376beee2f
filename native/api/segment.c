/* SPDX-License-Identifier: Apache-2.0
 *
 * Making, naming and removing segments.
 */
#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <sys/random.h>
#include <sys/stat.h>
#include <unistd.h>

#include "api/store.h"
#include "core/arena.h"

void shmtf_config_default(shmtf_config *c) {
    *c = (shmtf_config){.max_frames = 1024, .history = 128, .cache_time_ns = 10000000000ll, .stream_bytes = 8u << 20, .max_writers = 128};
}

static shmtf_status geometry(const shmtf_config *c, shmtf_geometry *geo, shmtf_error *e) {
    static const struct {
        const char *name, *hint;
        uint64_t limit;
    } limits[] = {{"max_frames", "between 1 and 16777214", SHMTF_MAX_FRAMES},
                  {"max_writers", "between 1 and 1023", SHMTF_MAX_WRITERS},
                  {"history", "between 1 and 3932160 records a frame, and fewer with many frames", 3932160},
                  {"stream_bytes", "at most 1 TiB", 1ull << 40}};
    const char *bad = shmtf_layout_compute(geo, c->max_frames, c->history, c->cache_time_ns, c->stream_bytes, c->max_writers);
    if (!bad) return SHMTF_OK;
    for (size_t i = 0; i < sizeof limits / sizeof *limits; i++)
        if (!strcmp(bad, limits[i].name)) {
            if (error_open(e)) e->limit = limits[i].limit;
            return error_set(e, SHMTF_INVALID_ARGUMENT, limits[i].name, limits[i].hint);
        }
    return error_set(e, SHMTF_INVALID_ARGUMENT, bad, NULL);
}

uint64_t shmtf_segment_size(const shmtf_config *config, shmtf_error *error) {
    shmtf_geometry geo;
    error_clear(error);
    return geometry(config, &geo, error) == SHMTF_OK ? geo.size_bytes : 0;
}

shmtf_status shmtf_format_fd(int fd, const shmtf_config *config, shmtf_error *error) {
    shmtf_geometry geo;
    map_file file;
    shmtf_segment s;
    uint64_t uuid[2];
    void *base;
    local_hint mark = 0;
    error_clear(error);
    peer_fork_guard();
    shmtf_status st = geometry(config, &geo, error);
    if (st != SHMTF_OK) return st;
    int err = map_stat(fd, &file);
    if (err) return error_system(error, SHMTF_SYSTEM, err, "a new store needs an empty file in shared memory", NULL);
    if (file.size_bytes) return error_set(error, SHMTF_EXISTS, "the file is not empty", NULL);
    peer_hold_creation(fd);
    err = map_reserve(fd, geo.size_bytes);
    if (err == ENOSPC || err == EFBIG || err == ENOMEM) {
        if (error_open(error)) error->needed = geo.size_bytes;
        return error_system(error, SHMTF_FULL, err, "shared memory",
                            "make the store smaller (max_frames, history, stream_bytes) or /dev/shm larger");
    }
    if (!err) err = map_memory(fd, geo.size_bytes, 1, &mark, &base);
    if (err) return error_system(error, SHMTF_SYSTEM, err, "reserving the store's memory", NULL);
    if (getrandom(uuid, sizeof uuid, 0) != (ssize_t)sizeof uuid) uuid[0] = (uint64_t)clock_realtime_ns(), uuid[1] = (uint64_t)getpid();
    shmtf_layout_bind(&s, &geo, base);
    shmtf_layout_format(&s, uuid, clock_realtime_ns(), (uint64_t)getpid());
    shmtf_layout_publish(&s);
    bool lost = hint_get(&mark) == GUARD_LOST;
    map_release(base, geo.size_bytes);
    return lost ? store_lost(error) : SHMTF_OK;
}

shmtf_status shmtf_guard_truncation(shmtf_error *error) {
    error_clear(error);
    peer_fork_guard();
    int err = guard_install();
    return err ? error_system(error, SHMTF_SYSTEM, err, "installing a handler of SIGBUS", NULL) : SHMTF_OK;
}

static shmtf_status bad_name(shmtf_error *e) {
    return error_set(e, SHMTF_INVALID_ARGUMENT, "store name", "1 to 200 bytes without '/', not starting with '.'");
}

static shmtf_status open_error(shmtf_error *e, int err) {
    if (err == ENOENT) return error_system(e, SHMTF_NOT_FOUND, err, "no store has this name", "create it first, or wait with a timeout");
    return error_system(e, SHMTF_SYSTEM, err, "opening the store", NULL);
}

shmtf_status shmtf_create(const char *name, const shmtf_config *config, unsigned mode, shmtf_error *error) {
    char path[256], self[32];
    error_clear(error);
    if (map_path(name, path, sizeof path)) return bad_name(error);
    if (access(path, F_OK) == 0) return error_set(error, SHMTF_EXISTS, "the name is taken", "attach to it, or unlink it first");
    int fd = open("/dev/shm", O_TMPFILE | O_RDWR | O_CLOEXEC, 0600);
    bool in_place = fd < 0;
    if (in_place) fd = open(path, O_RDWR | O_CREAT | O_EXCL | O_CLOEXEC | O_NOFOLLOW, 0600);
    if (fd < 0) return error_system(error, errno == EEXIST ? SHMTF_EXISTS : SHMTF_SYSTEM, errno, "creating the store", NULL);
    shmtf_status st = shmtf_format_fd(fd, config, error);
    snprintf(self, sizeof self, "/proc/self/fd/%d", fd);
    if (st == SHMTF_OK && (fchmod(fd, mode) || (!in_place && linkat(AT_FDCWD, self, AT_FDCWD, path, AT_SYMLINK_FOLLOW))))
        st = error_system(error, errno == EEXIST ? SHMTF_EXISTS : SHMTF_SYSTEM, errno, "naming the store", NULL);
    if (st != SHMTF_OK && in_place) unlink(path);
    close(fd);
    return st;
}

static shmtf_status open_named(const char *path, unsigned flags, const char *writer, shmtf_store **store, shmtf_error *e) {
    int fd = open(path, ((flags & SHMTF_READONLY) ? O_RDONLY : O_RDWR) | O_CLOEXEC | O_NOFOLLOW | O_NONBLOCK);
    if (fd < 0) return open_error(e, errno);
    shmtf_status st = shmtf_attach_fd(fd, flags, writer, store, e);
    close(fd);
    return st;
}

shmtf_status shmtf_attach(const char *name, unsigned flags, const char *writer, int64_t timeout_ns, shmtf_store **store,
                          shmtf_error *error) {
    char path[256];
    error_clear(error);
    *store = NULL;
    if (map_path(name, path, sizeof path)) return bad_name(error);
    int64_t deadline = deadline_after(timeout_ns), pause = 1000000;
    for (;;) {
        shmtf_status st = open_named(path, flags, writer, store, error);
        if (st != SHMTF_NOT_FOUND && st != SHMTF_NOT_READY) return st;
        if (clock_monotonic_ns() >= deadline) return st;
        if (clock_sleep_ns(pause)) return error_set(error, SHMTF_INTERRUPTED, "waiting for the store", NULL);
        pause = pause < 20000000 ? pause * 2 : pause;
    }
}

shmtf_status shmtf_unlink_bell_fd(int fd, shmtf_error *error) {
    map_file file;
    void *page;
    error_clear(error);
    peer_fork_guard();
    int err = map_stat(fd, &file);
    if (!err && file.size_bytes < SHMTF_PAGE) return SHMTF_OK; /* never had one */
    if (!err) err = map_memory(fd, SHMTF_PAGE, 0, NULL, &page);
    if (err) return error_system(error, SHMTF_SYSTEM, err, "reading the store's header", NULL);
    const shmtf_header *h = page;
    uint64_t uuid[2] = {load_relaxed(&h->uuid[0]), load_relaxed(&h->uuid[1])};
    bool ours = load_relaxed(&h->magic) == SHMTF_MAGIC;
    map_release(page, SHMTF_PAGE);
    if (!ours) return SHMTF_OK;
    err = bell_remove(uuid);
    return err && err != ENOENT ? error_system(error, SHMTF_SYSTEM, err, "removing the bell", NULL) : SHMTF_OK;
}

shmtf_status shmtf_unlink(const char *name, shmtf_error *error) {
    char path[256];
    error_clear(error);
    if (map_path(name, path, sizeof path)) return bad_name(error);
    int fd = open(path, O_RDONLY | O_CLOEXEC | O_NOFOLLOW | O_NONBLOCK);
    /* what may not be opened, and what is no file, may still be removed */
    if (fd < 0 && errno != EACCES && errno != EPERM && errno != ELOOP && errno != ENXIO) return open_error(error, errno);
    shmtf_error e;
    shmtf_status st = SHMTF_OK;
    /* The bell first: if we die here, the name is still there to be removed, and without the file nobody knows the bell's name.
     * And last: a writer may have made one meanwhile, but makes none for a store without a name. */
    if (fd >= 0) st = shmtf_unlink_bell_fd(fd, &e);
    if (st != SHMTF_OK && e.sys_errno != ENODEV) {
        close(fd);
        return error_system(error, st, e.sys_errno, e.what, e.hint);
    }
    int err = unlink(path) ? errno : 0;
    if (fd >= 0) shmtf_unlink_bell_fd(fd, NULL);
    if (fd >= 0) close(fd);
    return err ? open_error(error, err) : SHMTF_OK;
}

shmtf_status shmtf_get_info(shmtf_store *h, shmtf_info *info, shmtf_error *error) {
    error_clear(error);
    shmtf_status st = store_enter(h, error);
    if (st != SHMTF_OK) return st;
    const shmtf_geometry *g = &h->s.geo;
    memset(info, 0, sizeof *info);
    info->config = (shmtf_config){(uint32_t)g->max_frames, (uint32_t)g->history, g->cache_time_ns, g->stream_bytes, (uint32_t)g->max_writers};
    info->format = SHMTF_FORMAT;
    info->size_bytes = g->size_bytes;
    info->fingerprint = shmtf_layout_fingerprint();
    info->uuid[0] = h->uuid[0];
    info->uuid[1] = h->uuid[1];
    info->created_ns = (int64_t)load_relaxed(&h->s.header->created_ns);
    info->version = shmtf_commit_version(h);
    info->n_frames_bound = (uint32_t)load_acquire(&h->s.global->frames_bound);
    info->chunk_bytes = SHMTF_CHUNK_BYTES;
    info->n_chunks = g->n_chunks;
    info->n_chunks_free = arena_count_free(&h->s);
    info->readonly = h->readonly;
    return store_leave(h, SHMTF_OK, error);
}

void shmtf_get_counters(shmtf_store *h, shmtf_counters *c) {
    *c = (shmtf_counters){count_get(&h->commits), count_get(&h->aborts),  count_get(&h->helps),
                          count_get(&h->recoveries), count_get(&h->rereads), count_get(&h->restarts),
                          count_get(&h->waits),   count_get(&h->late_dropped), count_get(&h->repeats)};
}

uint64_t shmtf_commit_version(shmtf_store *h) {
    if (store_enter(h, NULL) != SHMTF_OK) return 0;
    return commit_version(load_acquire(&h->s.global->commit)); /* [E2 acquire] */
}
