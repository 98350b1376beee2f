/* SPDX-License-Identifier: Apache-2.0
 *
 * A file that is cut short under a living mapping.
 *
 * Problem.  Whoever may write a store may also truncate its file.  The next access to a page that is gone raises SIGBUS,
 * which ends the process, although nothing it did was wrong.
 *
 * Means.  All mappings are listed.  A handler of SIGBUS that finds the address in one of them puts private zeros in the place
 * of the whole mapping, marks its handle as lost, and lets the access go on; any other SIGBUS goes to the handler that was
 * there before.  It is the whole mapping, so that no read mixes what it saw before with zeros: its last check looks at
 * a lock word that was not zero.  From then on nothing that the handle does reaches the file; calls that are under way go on
 * in the zeros, and look at the mark at last.  To take a mapping out waits for the handlers that run.
 *
 * What it cannot do.  A thread that blocks SIGBUS is ended by the kernel.  Where zeros cannot be mapped (RLIMIT_DATA, strict
 * overcommit) the signal goes on as if it were foreign.  Hole punching raises no signal: the holes read as zeros.
 */
#ifndef SHMTF_SEGMENT_GUARD_H
#define SHMTF_SEGMENT_GUARD_H

#include <stddef.h>
#include <stdint.h>

#include "segment/atomic.h"

#define GUARD_LOST UINT32_MAX

/* Install the handler, once for the process: 0 or an errno value. */
int guard_install(void);

/* List a mapping that forked children do not inherit: 0 or ENOMEM.  When it is lost, *mark becomes GUARD_LOST (NULL: nobody
 * is told); the mark must live as long as the mapping.  Take it out before it is unmapped. */
int guard_add(void *base, uint64_t size_bytes, int writable, local_hint *mark);
void guard_remove(const void *base);

/* Around fork: the list is whole in the child, and empty. */
void guard_before_fork(void);
void guard_after_fork(bool in_child);

#endif
