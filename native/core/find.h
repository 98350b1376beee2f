/* SPDX-License-Identifier: Apache-2.0
 *
 * The names of a batch, to handles.
 *
 * A name leads to the frame that most likely has it.  Under that frame's lock, or at the commit, it turns out whether the
 * frame is alive; only if it was not, names are looked up with care.  In chains each name is given twice, and is looked
 * up once.
 */
#ifndef SHMTF_CORE_FIND_H
#define SHMTF_CORE_FIND_H

#include "core/txn.h"

typedef enum {
    FIND_OK,
    FIND_RETRY,    /* the tree changed meanwhile */
    FIND_CORRUPT,
    FIND_GONE,     /* a handle without a name that no frame has */
    FIND_BAD_NAME  /* finder.what */
} find_status;

typedef struct {
    const txn *x;
    bool careful;     /* a handle that a name led to was of an ended life: hints are not enough */
    size_t item;      /* the item at hand */
    const char *what; /* why a name is refused */
} finder;

/* Handles for the names of all items, as far as their frames exist; names that nobody has are checked. */
find_status find_names(finder *f, shmtf_transform *items, size_t n);
find_status find_name(finder *f, shmtf_ref *ref);
find_status find_key(finder *f, const shmtf_ref *ref, name_key *key);
bool find_same_name(const shmtf_ref *a, const shmtf_ref *b);
/* Is a text UTF-8, by RFC 3629? */
bool find_utf8(const char *text);

#endif
