/* SPDX-License-Identifier: Apache-2.0
 *
 * Edges in a row: found and composed one after another, and checked together afterwards.
 *
 * Problem.  Which line to read next depends on a record that is still being read: a chain of cache misses.
 *
 * Algorithm.  The parent last seen for a frame is remembered (a process-local hint), so the frames above are known before
 * any record is read.  Their lines are asked for first; at a time, then the lines around the position where the record
 * should lie; then the records are read, each deciding itself who the next frame is.  A wrong hint ends the run, or
 * costs a wasted prefetch; it is never believed.
 *
 * Only the plain case is taken: the frame's newest record is not newer than S.  The rest is the general walk's
 * (lookup.c).
 */
#ifndef SHMTF_CORE_RUN_H
#define SHMTF_CORE_RUN_H

#include "core/tree.h"

enum { RUN_MOST = 32 };

/* A chain on its way up: pose is T_cur_start, where has_pose. */
typedef struct {
    shmtf_frame cur, last; /* last: the frame below cur */
    shmtf_pose pose;
    bool has_pose;
    int64_t oldest, newest; /* stamps of the dynamic records used */
    uint32_t n_dynamic;
    shmtf_edge *edge; /* where the next edge goes, those after it `stride` apart */
    uint32_t room;    /* for that many */
    int stride;
} edge_chain;

typedef struct {
    const shmtf_segment *s;
    uint64_t snapshot;
    const tree_clears *clears;
    local_hint *above; /* per frame id: its parent's id when last seen */
    bool at_time;      /* else the newest record of every edge */
    bool poseless;     /* whether there is an answer is all that is asked */
    int64_t time;
    edge_chain chain;
    /* to be checked */
    const shmtf_frame_words_t *frame[RUN_MOST];
    uint64_t lock[RUN_MOST];
} edge_run;

/* Up to `most` <= RUN_MOST edges on.  Returns how many were composed and hold at S; 0: nothing is known, and
 * what the run says is void. */
uint32_t run_edges(edge_run *run, uint32_t most);

/* After how many steps two chains of equal depth are likely to meet, by the hints; at least 1, at most RUN_MOST. */
uint32_t run_meeting(const shmtf_segment *s, const local_hint *above, uint32_t a, uint32_t b);

#endif
