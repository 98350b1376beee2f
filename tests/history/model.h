/* SPDX-License-Identifier: Apache-2.0
 *
 * What a store should hold after each commit: names, and a plain sorted list of records for each.
 *
 * It is written from shmtf.h, not from the core: no versions, no rings, no hints.  The one number it takes from there is how many
 * records a ring keeps.
 */
#ifndef SHMTF_TESTS_MODEL_H
#define SHMTF_TESTS_MODEL_H

#include <stdbool.h>

#include "history.h"

typedef struct model model;

model *model_make(uint64_t live, int64_t cache_time_ns);
void model_free(model *m);

/* Do what a commit did, as `version`.  False: it was not allowed to, or did not find what it says it read; see model_why. */
bool model_commit(model *m, const history_entry *e, uint64_t version);

/* Is this the right answer in the state as it is?  learn: it is known to be about this state, so that it also tells which
 * handle belongs to which life of a name. */
bool model_answers(model *m, const history_entry *e, bool learn);

const char *model_why(const model *m);
/* Answers that were not judged: lookups in a past with a loop. */
uint64_t model_unjudged(const model *m);

#endif
