/* SPDX-License-Identifier: Apache-2.0
 *
 * What the tree is after each commit, told by the commits themselves and by nothing that is read from the segment.
 */
#ifndef SHMTF_TESTS_GHOST_H
#define SHMTF_TESTS_GHOST_H

#include "core/stage.h"

enum { GHOST_NAMES = 6, GHOST_VERSIONS = 64, GHOST_RECORDS = 8 };

typedef struct {
    int64_t stamp;
    double value;
    uint64_t version, parent; /* parent as in a record */
} ghost_record;

typedef struct {
    shmtf_frame handle; /* gen 0: no such frame */
    record_kind kind;   /* ROOT, DYNAMIC, STATIC */
    int n;
    ghost_record r[GHOST_RECORDS]; /* by stamp; of equals in order of commit */
} ghost_frame;

typedef struct {
    ghost_frame f[GHOST_NAMES]; /* named "a", "b", ... */
    uint64_t shape;             /* version of the last commit that changed the tree's shape */
    int writer;                 /* who committed */
} ghost_state;

typedef enum { OP_SET, OP_REMOVE, OP_CLEAR } ghost_op;
/* What a transaction will have done if it commits. */
typedef struct {
    ghost_op op;
    shmtf_transform *items;
    size_t n;
    shmtf_ref *ref;
    bool keep_static;
} ghost_intent;

extern ghost_state ghost[GHOST_VERSIONS];
extern uint64_t ghost_top;

static inline int ghost_index(const char *name) { return name[0] - 'a'; }

/* The next commit, by this thread.  NULL, or what is wrong with it. */
const char *ghost_commit(int thread, const ghost_intent *intent, int live);
/* Has this thread committed since the setup? */
bool ghost_wrote(int thread);
/* Sum of the values from a frame up to its root; false: a loop. */
bool ghost_climb(const ghost_state *g, int frame, double *sum, int *root);
int ghost_by_handle(const ghost_state *g, uint64_t parent);

#endif
