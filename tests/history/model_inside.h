/* SPDX-License-Identifier: Apache-2.0
 * What the two halves of the model share: model.c, what writes do, and answers.c, what reads should find. */
#ifndef SHMTF_TESTS_MODEL_INSIDE_H
#define SHMTF_TESTS_MODEL_INSIDE_H

#include "model.h"
#include "shmtf.h"

enum { NOBODY = -1, MOST_LIVE = 64 };

typedef struct {
    int64_t stamp;
    double x, y;
    uint64_t version;
    int parent; /* a life */
} model_record;

/* From a name's birth to its removal. */
typedef struct {
    int name;
    uint64_t handle; /* 0: not known yet */
    bool alive;
    enum { A_ROOT, A_MOVING, A_STATIC } kind;
    int n;
    model_record *r; /* sorted by stamp; of equal ones the last counts */
} model_life;

typedef struct {
    int life;
    model_life was;
    model_record r[MOST_LIVE];
} saved_life;

struct model {
    int live;
    int64_t cache;
    int of_name[N_NAMES];
    model_life *lives;
    int n_lives, room;
    int *buckets; /* 1 + life, by handle */
    uint64_t n_buckets, n_handles;
    bool changed, trying;
    saved_life saved[2 * MOST_ITEMS];
    int n_saved;
    const char *why;
    char text[64];
    uint64_t unjudged;
};

int model_life_of(model *m, uint64_t handle);
/* Can this be the life's handle? */
bool model_is(model *m, int life, uint64_t handle, bool learn);
/* Of the newest record; NOBODY: a root, or the parent's life has ended. */
int model_parent(const model *m, int life);
/* What a write would be told, and whether it would change anything. */
shmtf_status model_try(model *m, const history_entry *e, bool *changed);

#endif
