/* SPDX-License-Identifier: Apache-2.0
 *
 * What the lock protocols have in common, so that they differ in concurrency control alone: memory, names, rings, the
 * checks of what is written, the walk, the arithmetic.  Names, record layout, ring sizes and poses are the store's own.
 *
 * What is left out is what locks make unnecessary (tags, snapshots, owners), and what a snake does not need: frames are
 * never removed or hung elsewhere, so the name table only grows and a frame's depth is a number, and both are read
 * without a lock.  A protocol guards a frame's count and records; it has one word of the frame's line for that.
 */
#ifndef SHMTF_BENCH_BASELINE_H
#define SHMTF_BENCH_BASELINE_H

#include <pthread.h>

#include "core/pose.h"
#include "core/ring.h"
#include "protocol.h"

typedef struct {
    shmtf_word lock;  /* the protocol's */
    shmtf_word count; /* records written: the newest lies in slot (count - 1) mod ring size */
    uint64_t parent, depth; /* fixed */
    uint64_t pad[4];
} baseline_frame;

typedef struct {
    pthread_mutex_t mutex; /* of the giants */
    uint64_t size_bytes;
    uint32_t n_frames, n_buckets, log2;
} baseline_header;

typedef struct {
    uint64_t hash, word[SHMTF_NAME_WORDS], pad[7];
} baseline_name;

typedef struct {
    int64_t stamp;
    uint64_t parent;
    shmtf_pose pose;
} baseline_record;

typedef struct {
    uint32_t id;
    shmtf_pose pose;
} baseline_item;

/* What a lookup has locked or seen, edge by edge. */
typedef struct {
    baseline_frame *frame;
    uint64_t version;
} baseline_seen;

struct bench_client {
    baseline_header *h;
    uint64_t *buckets; /* upper half of the hash | frame + 1; open addressing */
    baseline_frame *frames;
    baseline_name *names;
    unsigned char *rings;
    size_t ring_bytes;
    uint64_t mask; /* of a ring's slots */
    bench_shape shape;
    char (*texts)[BENCH_NAME_SIZE];
    shmtf_pose poses[BENCH_POSES];
    uint32_t *above;      /* per frame: its parent when last seen, as in lookup.h */
    baseline_item *items; /* of the update, in the order given */
    baseline_seen *seen;  /* the first n_seen of read_len */
    uint32_t n_seen;
    uint64_t read_retries, write_retries;
};

bool baseline_create(char place[BENCH_PLACE_SIZE], const bench_shape *shape, char error[BENCH_ERROR_SIZE]);
void baseline_remove(const char *place);
bench_client *baseline_attach(const char *place, const bench_shape *shape, char error[BENCH_ERROR_SIZE]);
void baseline_detach(bench_client *c);
void baseline_retries(bench_client *c, uint64_t *reads, uint64_t *writes);

/* Both ends of a lookup. */
bool baseline_ends(const bench_client *c, uint32_t first, uint32_t *target, uint32_t *source, char error[BENCH_ERROR_SIZE]);
/* Resolve, check and normalise an update into c->items. */
bool baseline_prepare(bench_client *c, uint32_t first, bool opposite, char error[BENCH_ERROR_SIZE]);
/* Write a record; the caller keeps everybody else from writing this frame. */
void baseline_put(const bench_client *c, const baseline_item *item, int64_t stamp, int64_t arrival);

static inline shmtf_record_head *baseline_heads(const bench_client *c, uint64_t frame) {
    return (shmtf_record_head *)(void *)(c->rings + frame * c->ring_bytes);
}
static inline shmtf_record_body *baseline_bodies(const bench_client *c, uint64_t frame) {
    return (shmtf_record_body *)(void *)(c->rings + frame * c->ring_bytes + (c->mask + 1) * sizeof(shmtf_record_head));
}

/* The newest record.  Word by word and relaxed: with optimistic readers a writer may be at work. */
HOT_INLINE void baseline_copy(const bench_client *c, uint32_t frame, baseline_record *out) {
    uint64_t slot = (load_relaxed(&c->frames[frame].count) - 1) & c->mask;
    const shmtf_record_body *b = &baseline_bodies(c, frame)[slot];
    out->stamp = (int64_t)load_relaxed(&baseline_heads(c, frame)[slot].stamp);
    out->parent = load_relaxed(&b->parent);
    out->pose = ring_pose(b->pose);
}

/* Copy a frame's newest record as the protocol does. */
typedef void baseline_edge(bench_client *c, uint32_t frame, baseline_record *out);

typedef struct {
    uint32_t cur;
    uint64_t depth;
    bool moved;
    shmtf_pose pose; /* T_cur_start */
} baseline_chain;

/* Frames are below c->h->n_frames whatever a record says: with optimistic readers it may say anything. */
HOT_INLINE bool baseline_climb(bench_client *c, baseline_chain *s, uint32_t k, int64_t *stamps, baseline_edge *edge) {
    uint32_t seen = c->above[s->cur], next = opaque32(seen);
    baseline_record r;
    if (k >= c->shape.read_len) return false;
    edge(c, s->cur, &r);
    if (stamps) stamps[c->shape.read_len - 1 - k] = r.stamp;
    if (r.parent != seen) {
        if (r.parent >= c->h->n_frames) return false;
        c->above[s->cur] = next = (uint32_t)r.parent;
    }
    s->pose = s->moved ? pose_compose(&r.pose, &s->pose) : r.pose;
    s->moved = true;
    s->cur = next;
    s->depth--;
    return true;
}

/* T_target_source: both chains climb to where they meet, the deeper first.  `edge` is a constant and is inlined.
 * False: there is no path, or it changed while it was walked. */
HOT_INLINE bool baseline_walk(bench_client *c, uint32_t target, uint32_t source, int64_t *stamps, shmtf_pose *out,
                              baseline_edge *edge) {
    uint32_t k = 0;
    baseline_chain s = {source, c->frames[source].depth, false, pose_identity()};
    baseline_chain t = {target, c->frames[target].depth, false, pose_identity()};
    c->n_seen = 0;
    while (s.cur != t.cur)
        if (!baseline_climb(c, s.depth >= t.depth ? &s : &t, k++, stamps, edge)) return false;
    if (t.moved) {
        shmtf_pose up = pose_inverse(&t.pose);
        s.pose = pose_compose(&up, &s.pose);
    }
    *out = s.pose;
    pose_renormalise(out);
    return true;
}

/* How to wait for somebody who holds a lock: a while by spinning, then by leaving the CPU to him. */
void baseline_pause(unsigned *turn);

#endif
