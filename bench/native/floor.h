/* SPDX-License-Identifier: Apache-2.0
 *
 * The floor: what the machine needs for the arithmetic and the memory traffic alone, over records laid out like the
 * store's, in shared memory of the same page size, without names, snapshots, histories, generations or errors.
 */
#ifndef SHMTF_BENCH_FLOOR_H
#define SHMTF_BENCH_FLOOR_H

#include <stddef.h>

#include "core/ring.h"

typedef struct {
    shmtf_frame_words_t *frames; /* lock, the count in head[0], and one copy of the newest record, which writes leave as it is */
    unsigned char *rings;
    size_t ring_stride, size_bytes;
    void *base;
    uint32_t n_frames;
    unsigned log2;
    uint64_t slot; /* of every frame's newest record */
    uint64_t version;
} floor_tree;

/* A snake with full rings of 2^log2 records, `period_ns` apart.  False: no memory. */
bool floor_make(floor_tree *f, uint32_t n_frames, unsigned log2, int64_t period_ns);
void floor_free(floor_tree *f);

/* Compose the newest records, beside the locks, of the n edges above frame `first + n`, up to frame `first`. */
void floor_compose(const floor_tree *f, uint32_t first, uint32_t n, shmtf_pose *out);         /* by index */
void floor_walk(const floor_tree *f, uint32_t first, uint32_t n, shmtf_pose *out);            /* by parent words */
void floor_walk_seqlock(const floor_tree *f, uint32_t first, uint32_t n, shmtf_pose *out);    /* and tags, rechecked */
/* Interpolate each edge half-way between the record `back` before the newest and the one after it; tags rechecked. */
void floor_interpolate(const floor_tree *f, uint32_t first, uint32_t n, uint32_t back, shmtf_pose *out);
/* Lock n frames from first + 1 on, write a record behind each head, unlock. */
void floor_write(floor_tree *f, uint32_t first, uint32_t n, const shmtf_transform *items);

#endif
