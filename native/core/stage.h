/* SPDX-License-Identifier: Apache-2.0
 *
 * From transforms to staged records: names to frames, locks in order, births, and every check that may refuse a batch.
 * Nothing is visible until txn_commit; whatever is not STAGE_OK must be followed by txn_abort.
 */
#ifndef SHMTF_CORE_STAGE_H
#define SHMTF_CORE_STAGE_H

#include "core/find.h"

typedef enum {
    STAGE_OK,
    STAGE_HELD,    /* see txn.blocked_id */
    STAGE_RETRY,   /* the tree changed meanwhile: begin again */
    STAGE_CORRUPT,
    STAGE_FULL_FRAMES,
    STAGE_FULL_NAMES,
    STAGE_FULL_ARENA,
    STAGE_BAD_NAME,  /* stage.what */
    STAGE_BAD_POSE,  /* stage.what, stage.value */
    STAGE_SELF,      /* parent and child are one */
    STAGE_GONE,      /* a handle without a name, and its frame was removed */
    STAGE_MIXED,     /* one frame static and dynamic in one batch */
    STAGE_TOO_MANY,  /* more records for one frame than a transaction may write; stage.limit */
    STAGE_OLD_DATA,  /* stage.newest */
    STAGE_CYCLE,
    STAGE_DECLARED   /* the frame has a ring of another size, or records; stage.limit */
} stage_status;

typedef struct {
    txn *x;
    finder names;
    shmtf_transform *items;
    size_t n;
    uint32_t *order; /* room for n */
    int64_t arrival_ns;
    uint16_t writer;
    bool has_unborn; /* names that no frame had */
    /* why it was refused */
    size_t item;
    const char *what;
    double value;
    int64_t newest;
    uint64_t limit;
    shmtf_frame frame;
} stage;

stage_status stage_transforms(stage *g);
/* After an abort: items with names must not keep the handles of frames that were bound but not born. */
void stage_forget_unborn(stage *g);
stage_status stage_declare(stage *g, const char *name, unsigned ring_log2);
stage_status stage_remove(stage *g, shmtf_ref *frame);
stage_status stage_clear(stage *g, bool keep_static);
/* Check the arguments of all items; changes nothing but brings poses into the stored form. */
stage_status stage_check(stage *g);

#endif
