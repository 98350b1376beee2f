/* SPDX-License-Identifier: Apache-2.0
 *
 * A transform between two frames, from records of one commit.
 *
 * Problem.  Walk from both frames to their common ancestor and not a step further, without marks, without memory, and
 * without trusting anything that is not read at S.
 *
 * Algorithm.  If the depths of both frames were known, climbing the deeper side first would meet exactly at the lowest
 * common ancestor.  Depths are process-local hints from earlier walks: a wrong hint costs a second walk, never a wrong
 * answer, because a walk that overshot is recognised (both sides arrive over the same edge) and one that did not meet
 * proves nothing.  The second walk measures: it climbs both sides to their ends at S, which gives exact depths and
 * says whether the ends are one.  Two chains at the same S and time that meet go on together, so different ends mean
 * that no path exists.
 */
#ifndef SHMTF_CORE_LOOKUP_H
#define SHMTF_CORE_LOOKUP_H

#include "core/run.h"

typedef struct {
    const shmtf_segment *s;
    local_hint *depth; /* per frame id: 1 + edges to the root, or 0: unknown */
    local_hint *above; /* per frame id: its parent's id when last seen */
    uint64_t snapshot;
    bool at_time; /* else the newest record of every edge */
    bool poseless; /* `pose` is not wanted */
    int64_t time;
    shmtf_frame target, source;
    shmtf_edge *edges; /* NULL, or room for max_edges */
    uint32_t max_edges;
    /* out */
    shmtf_pose pose;
    int64_t oldest, newest; /* of the dynamic records used; valid if n_dynamic */
    uint32_t n_edges, n_dynamic;
    /* out, on failure */
    shmtf_frame failed, failed_parent;
    int64_t edge_oldest, edge_newest;
    tree_clears clears;
} lookup;

typedef enum {
    LOOKUP_OK,
    LOOKUP_NO_TARGET,
    LOOKUP_NO_SOURCE,
    LOOKUP_DISCONNECTED,
    LOOKUP_BACKWARD,
    LOOKUP_FORWARD,
    LOOKUP_SINGLE, /* one record only, at another time */
    LOOKUP_LOOP,   /* a loop in the past */
    LOOKUP_OLD,    /* take a newer S */
    LOOKUP_CORRUPT
} lookup_status;

lookup_status lookup_run(lookup *l);

/* One step up at l->time, into r (pose interpolated, parent of the older record).  Sets the failure fields. */
lookup_status lookup_step_at(lookup *l, shmtf_frame frame, ring_record *r, tree_step *step);

#endif
