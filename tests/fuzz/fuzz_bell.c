/* SPDX-License-Identifier: Apache-2.0
 *
 * The bell beside a store is anything: of another size, another kind of file, or full of garbage that changes.  Waits end
 * when their time is over, and commits that ring it go through.
 */
#define _GNU_SOURCE
#include "fuzz.h"

#include <fcntl.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/stat.h>
#include <unistd.h>

const char *const fuzz_target = "fuzz_bell";

static char path[64];

static void remove_bell(void) {
    if (unlink(path)) rmdir(path);
}

static void on_end(int number) {
    remove_bell();
    signal(number, SIG_DFL);
    raise(number);
}

/* One bell per process, whatever the image. */
static void name_bell(bench *b) {
    shmtf_header *h = (shmtf_header *)(void *)b->base;
    const uint64_t uuid[2] = {0xfee1fee1fee1fee1, (uint64_t)getpid()};
    store_relaxed(&h->uuid[0], uuid[0]);
    store_relaxed(&h->uuid[1], uuid[1]);
    if (path[0]) return;
    snprintf(path, sizeof path, "/dev/shm/.shmtf-bell-%016llx%016llx", (unsigned long long)uuid[0], (unsigned long long)uuid[1]);
    atexit(remove_bell);
    signal(SIGTERM, on_end);
    signal(SIGINT, on_end);
}

static void make_bell_file(void) {
    static const off_t sizes[] = {0, 1, 2048, 4095, 4097, 1 << 16};
    unsigned char page[4096];
    remove_bell();
    switch (take(16)) {
    case 0: return;
    case 1: (void)!mkdir(path, 0700); return;
    case 2: (void)!mkfifo(path, 0600); return;
    case 3: (void)!symlink("/dev/zero", path); return;
    default: break;
    }
    int fd = open(path, O_RDWR | O_CREAT | O_EXCL | O_CLOEXEC, one_in(16) ? 0000 : 0600);
    if (fd < 0 || ftruncate(fd, one_in(8) ? sizes[take(6)] : 4096)) abort();
    for (size_t i = 0; i < sizeof page; i += 8) {
        uint64_t v = one_in(3) ? take64() : take(2) ? UINT64_MAX : 0;
        memcpy(page + i, &v, sizeof v);
    }
    if (take(4) && pwrite(fd, page, sizeof page, 0) < 0) abort();
    close(fd);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    const image *i = images_begin(data, size);
    shmtf_geometry geo;
    bench *b = bench_load(i, false);
    image_geometry(i->world, &geo);
    name_bell(b);
    make_bell_file();
    if (one_in(4)) mutate_word(b->base, &geo, NULL);
    shmtf_store *h = bench_attach(b->fd, one_in(4) ? SHMTF_READONLY : 0);
    if (!h) return 0;
    for (uint32_t k = 0; k < 3; k++) {
        call_waits(h);
        if (!h->readonly) call_write(h);
        if (h->bell_map && one_in(2)) {
            unsigned char *word = (unsigned char *)h->bell_map + 8ull * take(512);
            uint64_t v = take64();
            memcpy(word, &v, sizeof v);
        }
    }
    watch_nothing();
    shmtf_close(h);
    return 0;
}
