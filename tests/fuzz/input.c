/* SPDX-License-Identifier: Apache-2.0
 *
 * The input as decisions, and the file under test.
 */
#define _GNU_SOURCE
#include "fuzz.h"

#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <unistd.h>

/* ---- decisions ---- */

static const uint8_t *at, *end;
static uint64_t beyond;

void take_from(const uint8_t *data, size_t size) {
    at = data;
    end = data + size;
    beyond = 0xcbf29ce484222325ull;
    for (size_t i = 0; i < size; i++) beyond = (beyond ^ data[i]) * 0x100000001b3ull;
    beyond |= 1;
}

static uint64_t next_beyond(void) {
    beyond ^= beyond << 13;
    beyond ^= beyond >> 7;
    beyond ^= beyond << 17;
    return beyond * 0x2545f4914f6cdd1dull;
}

static uint64_t take_bytes(size_t n) {
    uint64_t v = 0;
    if ((size_t)(end - at) < n) {
        at = end;
        return next_beyond() >> (64 - 8 * n);
    }
    memcpy(&v, at, n);
    at += n;
    return v;
}

uint64_t take64(void) { return take_bytes(8); }

uint32_t take(uint32_t n) {
    if (n <= 1) return 0;
    return (uint32_t)(take_bytes(n <= 256 ? 1 : 4) % n);
}

/* ---- files ---- */

static bench benches[N_WORLDS][2];

static void make_bench(bench *b, const image *i, bool with_peer) {
    shmtf_error e;
    shmtf_transform item = {shmtf_by_name("peer"), shmtf_by_name("peers child"), 1, {0, 0, 0, 0, 0, 0, 1}, 0};
    b->fd = memfd_create("shmtf-fuzz", MFD_CLOEXEC);
    if (b->fd < 0 || ftruncate(b->fd, (off_t)i->size)) abort();
    b->base = mmap(NULL, i->size, PROT_READ | PROT_WRITE, MAP_SHARED, b->fd, 0);
    if (b->base == MAP_FAILED) abort();
    if (!with_peer) return;
    memcpy(b->base, i->bytes, i->size);
    if (shmtf_attach_fd(b->fd, 0, "peer", &b->peer, &e)) abort();
    shmtf_set_transforms(b->peer, &item, 1, NULL, NULL, &e); /* whatever it says, it holds a slot now */
}

bench *bench_load(const image *i, bool with_peer) {
    bench *b = &benches[i->world][with_peer];
    if (!b->base) make_bench(b, i, with_peer);
    memcpy(b->base, i->bytes, i->size);
    return b;
}

int bench_odd_size(const image *i) {
    static const int64_t sizes[] = {0, 1, 8, 4088, 4095, 4096, 4097, 8192, -4096, -1, +1, +4096};
    int fd = memfd_create("shmtf-fuzz-odd", MFD_CLOEXEC);
    int64_t pick = take(16), size = pick < 12 ? sizes[pick] : (int64_t)take((uint32_t)i->size);
    if (pick >= 8 && pick < 12) size += (int64_t)i->size;
    if (fd < 0 || ftruncate(fd, (off_t)size)) abort();
    size_t filled = (uint64_t)size < i->size ? (size_t)size : (size_t)i->size;
    if (pwrite(fd, i->bytes, filled, 0) != (ssize_t)filled) abort();
    return fd;
}

shmtf_store *bench_attach(int fd, unsigned flags) {
    shmtf_store *h;
    shmtf_error e;
    const uint64_t may = 1ull << SHMTF_VERSION | 1ull << SHMTF_CORRUPT;
    shmtf_status st = shmtf_attach_fd(fd, flags, "fuzz", &h, &e);
    if (st == SHMTF_OK) {
        tally.attached++;
        watch_store(h);
        return h;
    }
    tally.refused[st]++;
    if ((unsigned)st >= 32 || !(may & 1ull << st) || !e.what || h) watch_failed("refused without a reason");
    return NULL;
}
