/* SPDX-License-Identifier: Apache-2.0
 *
 * Memory for rings: equal chunks, one word each that names a frame and an attempt.
 *
 * A chunk is in use if the ring of the frame it names covers it, or if that frame is locked (its owner may be about to
 * say so).  Nothing is ever freed: a frame that gives up its ring leaves chunks that are covered by nothing.  So a kill
 * between any two stores leaks nothing, and there is no free list to tear.
 */
#ifndef SHMTF_CORE_ARENA_H
#define SHMTF_CORE_ARENA_H

#include "core/ring.h"

/* Claim neighbouring chunks for a ring of 2^log2 records, for frame `id`, whose lock word is `lock` and the caller's.
 * Returns the ring word, to be stored in the frame; 0: no room. */
uint64_t arena_claim_locked(const shmtf_segment *s, uint32_t id, uint64_t lock, unsigned log2);

/* Chunks that nothing covers, at this moment. */
uint64_t arena_count_free(const shmtf_segment *s);

#endif
