/* SPDX-License-Identifier: Apache-2.0 */
#define _GNU_SOURCE
#include "floor.h"

#include <sys/mman.h>
#include <unistd.h>

#include "common.h"
#include "core/pose.h"

static shmtf_record_head *heads_of(const floor_tree *f, uint32_t frame) {
    return (shmtf_record_head *)(void *)(f->rings + frame * f->ring_stride);
}
static shmtf_record_body *bodies_of(const floor_tree *f, uint32_t frame) {
    return (shmtf_record_body *)(void *)(f->rings + frame * f->ring_stride + (sizeof(shmtf_record_head) << f->log2));
}

static void store_record(shmtf_record_head *h, shmtf_record_body *b, int64_t stamp, const shmtf_pose *p, uint32_t parent) {
    uint64_t words[SHMTF_POSE_WORDS];
    memcpy(words, p, sizeof words);
    store_relaxed(&h->stamp, (uint64_t)stamp);
    store_relaxed(&h->arrival, (uint64_t)stamp);
    store_relaxed(&h->info, 0);
    for (int i = 0; i < SHMTF_POSE_WORDS; i++) store_relaxed(&b->pose[i], words[i]);
    store_relaxed(&b->parent, parent);
}

bool floor_make(floor_tree *f, uint32_t n_frames, unsigned log2, int64_t period_ns) {
    size_t lines = n_frames * sizeof(shmtf_frame_words_t);
    lines = (lines + SHMTF_CHUNK_BYTES - 1) / SHMTF_CHUNK_BYTES * SHMTF_CHUNK_BYTES;
    size_t ring = shmtf_ring_bytes(log2, sizeof(shmtf_record_body));
    *f = (floor_tree){.n_frames = n_frames, .log2 = log2, .version = 1};
    f->ring_stride = (ring + SHMTF_CHUNK_BYTES - 1) / SHMTF_CHUNK_BYTES * SHMTF_CHUNK_BYTES;
    f->size_bytes = lines + n_frames * f->ring_stride;
    int fd = memfd_create("shmtf-bench-floor", MFD_CLOEXEC);
    if (fd < 0) return false;
    f->base = ftruncate(fd, (off_t)f->size_bytes) ? MAP_FAILED
              : mmap(NULL, f->size_bytes, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_POPULATE, fd, 0);
    close(fd);
    if (f->base == MAP_FAILED) return false;
    f->frames = f->base;
    f->rings = (unsigned char *)f->base + lines;
    f->slot = (1ull << log2) / 2;
    for (uint32_t i = 0; i < n_frames; i++) {
        shmtf_frame_words_t *frame = &f->frames[i];
        store_relaxed(&frame->head[0], f->slot + 1);
        for (uint64_t k = 0; k < 1ull << log2; k++) {
            int64_t stamp = (int64_t)((k - f->slot - 1) & ((1ull << log2) - 1)) * period_ns;
            shmtf_pose p = bench_pose(i, stamp);
            store_record(&heads_of(f, i)[k], &bodies_of(f, i)[k], stamp, &p, i ? i - 1 : 0);
            store_relaxed(&heads_of(f, i)[k].tag, 1);
        }
        const shmtf_record_body *newest = &bodies_of(f, i)[f->slot];
        for (int k = 0; k < SHMTF_POSE_WORDS; k++) store_relaxed(&frame->newest[0].pose[k], load_relaxed(&newest->pose[k]));
        store_relaxed(&frame->newest_edge[0], load_relaxed(&newest->parent));
        store_relaxed(&frame->newest_tag[0], 1);
    }
    return true;
}

void floor_free(floor_tree *f) {
    munmap(f->base, f->size_bytes);
    f->base = NULL;
}

void floor_compose(const floor_tree *f, uint32_t first, uint32_t n, shmtf_pose *out) {
    shmtf_pose sum = ring_pose(f->frames[first + n].newest[0].pose), p;
    for (uint32_t i = first + n - 1; i > first; i--) {
        p = ring_pose(f->frames[i].newest[0].pose);
        sum = pose_compose(&p, &sum);
    }
    *out = sum;
}

void floor_walk(const floor_tree *f, uint32_t first, uint32_t n, shmtf_pose *out) {
    shmtf_pose sum = pose_identity(), p;
    for (uint32_t i = first + n; i != first;) {
        p = ring_pose(f->frames[i].newest[0].pose);
        sum = pose_compose(&p, &sum);
        i = (uint32_t)load_relaxed(&f->frames[i].newest_edge[0]);
    }
    *out = sum;
}

void floor_walk_seqlock(const floor_tree *f, uint32_t first, uint32_t n, shmtf_pose *out) {
    shmtf_pose sum = pose_identity(), p;
    for (uint32_t i = first + n; i != first;) {
        const shmtf_frame_words_t *frame = &f->frames[i];
        uint64_t tag, parent;
        do {
            tag = load_acquire(&frame->newest_tag[0]);
            p = ring_pose(frame->newest[0].pose);
            parent = load_relaxed(&frame->newest_edge[0]);
            fence_acquire();
        } while (load_relaxed(&frame->newest_tag[0]) != tag);
        sum = pose_compose(&p, &sum);
        i = (uint32_t)parent;
    }
    *out = sum;
}

void floor_interpolate(const floor_tree *f, uint32_t first, uint32_t n, uint32_t back, shmtf_pose *out) {
    shmtf_pose sum = pose_identity(), a, b;
    uint64_t mask = (1ull << f->log2) - 1, before = (f->slot - back) & mask, after = (before + 1) & mask;
    for (uint32_t i = first + n; i != first;) {
        const shmtf_record_head *h = heads_of(f, i);
        const shmtf_record_body *bodies = bodies_of(f, i);
        uint64_t t0, t1, parent;
        int64_t s0, s1;
        do {
            t0 = load_acquire(&h[before].tag);
            t1 = load_acquire(&h[after].tag);
            s0 = (int64_t)load_relaxed(&h[before].stamp);
            s1 = (int64_t)load_relaxed(&h[after].stamp);
            a = ring_pose(bodies[before].pose);
            b = ring_pose(bodies[after].pose);
            parent = load_relaxed(&bodies[before].parent);
            fence_acquire();
        } while (load_relaxed(&h[before].tag) != t0 || load_relaxed(&h[after].tag) != t1);
        double ratio = (double)((s1 - s0) / 2) / (double)(s1 - s0);
        shmtf_pose p = pose_interpolate(&a, &b, ratio);
        sum = pose_compose(&p, &sum);
        i = (uint32_t)parent;
    }
    *out = sum;
}

void floor_write(floor_tree *f, uint32_t first, uint32_t n, const shmtf_transform *items) {
    uint64_t mask = (1ull << f->log2) - 1, version = ++f->version;
    for (uint32_t i = 0; i < n; i++)
        while (!cas_acq_rel(&f->frames[first + 1 + i].lock, 0, 1)) cpu_relax();
    for (uint32_t i = 0; i < n; i++) {
        shmtf_frame_words_t *frame = &f->frames[first + 1 + i];
        uint64_t count = load_relaxed(&frame->head[0]), slot = count & mask;
        shmtf_record_head *h = &heads_of(f, first + 1 + i)[slot];
        store_relaxed(&h->tag, LOCK_OWNED);
        fence_release();
        store_record(h, &bodies_of(f, first + 1 + i)[slot], items[i].stamp_ns, &items[i].pose, first + i);
        store_release(&h->tag, version);
        store_relaxed(&frame->head[0], count + 1);
    }
    for (uint32_t i = 0; i < n; i++) store_release(&f->frames[first + 1 + i].lock, 0);
}
