/* SPDX-License-Identifier: Apache-2.0
 *
 * The store of the trials, its images, and processes that cannot outlive a watchdog.
 */
#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include "prove.h"
#include "segment/layout.h"
#include "segment/lock.h"
#include "segment/peer.h"

enum { BELL_PAGE = 4096 };

void die(const char *format, ...) {
    va_list more;
    va_start(more, format);
    vfprintf(stderr, format, more);
    va_end(more);
    fputc('\n', stderr);
    _exit(FAILED);
}

void must(shmtf_status st, const shmtf_error *e, const char *what) {
    char text[256];
    if (st != SHMTF_OK) die("%s: %s", what, shmtf_error_message(e, text, sizeof text));
}

int64_t now_ns(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (int64_t)t.tv_sec * 1000000000 + t.tv_nsec;
}

void *shared_memory(uint64_t size) {
    void *p = mmap(NULL, size, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
    if (p == MAP_FAILED) die("no memory: %s", strerror(errno));
    return p;
}

static unsigned char *map_file_at(const char *path, uint64_t size, int *fd) {
    *fd = open(path, O_RDWR | O_CLOEXEC);
    void *p = *fd < 0 ? MAP_FAILED : mmap(NULL, size, PROT_READ | PROT_WRITE, MAP_SHARED, *fd, 0);
    if (p == MAP_FAILED) die("%s: %s", path, strerror(errno));
    return p;
}

static shmtf_config config_of(uint32_t extra) {
    return (shmtf_config){.max_frames = CORE_FRAMES + UNBORN_FRAMES + extra + 4,
                          .history = extra > 100 ? 6 : 14,
                          .cache_time_ns = -1,
                          .stream_bytes = 8192,
                          .max_writers = 4};
}

shmtf_store *attach_or_die(const world *w, unsigned flags, const char *writer) {
    shmtf_store *h;
    shmtf_error e;
    must(shmtf_attach(w->store, flags, writer, 0, &h, &e), &e, "attach");
    return h;
}

void world_make(world *w, const char *store, uint32_t extra) {
    shmtf_error e;
    shmtf_info info;
    int bell_fd;
    memset(w, 0, sizeof *w);
    snprintf(w->store, sizeof w->store, "%s", store);
    snprintf(w->path, sizeof w->path, "/dev/shm/%s", store);
    w->extra = extra;
    w->n_names = CORE_FRAMES + UNBORN_FRAMES + extra;
    const shmtf_config c = config_of(extra);
    must(shmtf_create(store, &c, 0600, &e), &e, "create");
    shmtf_store *h = attach_or_die(w, 0, "base");
    must(write_base(h, extra, &e), &e, "write the tree");
    must(shmtf_get_info(h, &info, &e), &e, "info");
    shmtf_close(h);
    snprintf(w->bell, sizeof w->bell, "/dev/shm/.shmtf-bell-%016llx%016llx", (unsigned long long)info.uuid[0], (unsigned long long)info.uuid[1]);
    w->size = info.size_bytes;
    w->memory = map_file_at(w->path, w->size, &w->fd);
    w->bell_page = map_file_at(w->bell, BELL_PAGE, &bell_fd);
    close(bell_fd);
}

void world_drop(world *w) {
    world_hold_first_slot(w, false);
    munmap(w->memory, w->size);
    munmap(w->bell_page, BELL_PAGE);
    close(w->fd);
    shmtf_unlink(w->store, NULL);
}

unsigned char *world_new_image(const world *w) { return shared_memory(w->size + BELL_PAGE); }

void world_save(const world *w, unsigned char *image) {
    memcpy(image, w->memory, w->size);
    memcpy(image + w->size, w->bell_page, BELL_PAGE);
}

void world_restore(const world *w, const unsigned char *image) {
    memcpy(w->memory, image, w->size);
    memcpy(w->bell_page, image + w->size, BELL_PAGE);
}

uint64_t world_version(const world *w) {
    uint64_t word;
    memcpy(&word, w->memory + SHMTF_PAGE, sizeof word); /* the commit word is the first behind the header */
    return commit_version(word);
}

void world_hold_first_slot(world *w, bool hold) {
    unsigned slot;
    if (hold == (w->first_slot != NULL)) return;
    if (!hold) {
        peer_release(w->first_slot);
        w->first_slot = NULL;
    } else if (peer_claim(w->fd, 4, 0, &slot, &w->first_slot) || slot) {
        die("slot 0 is taken: a process was left behind");
    }
}

const char *world_name(uint32_t i, char buffer[16]) {
    static const char *const names[CORE_FRAMES + UNBORN_FRAMES] = {"root", "a", "b", "c", "d", "e", "s", "other", "m", "n", "x", "dd"};
    if (i < CORE_FRAMES + UNBORN_FRAMES) return names[i];
    snprintf(buffer, 16, "u%03u", (unsigned)(i - CORE_FRAMES - UNBORN_FRAMES) % 10000);
    return buffer;
}

pid_t start_process(void (*run)(void *), void *argument) {
    fflush(NULL);
    pid_t parent = getpid(), pid = fork();
    if (pid < 0) die("fork: %s", strerror(errno));
    if (pid) return pid;
    prctl(PR_SET_PDEATHSIG, SIGKILL);
    if (getppid() != parent) _exit(FAILED);
    alarm(WATCHDOG_S);
    run(argument);
    _exit(0);
}

int wait_for(pid_t pid, int options) {
    int status;
    while (waitpid(pid, &status, options) < 0)
        if (errno != EINTR) die("waitpid: %s", strerror(errno));
    return status;
}
