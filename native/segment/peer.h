/* SPDX-License-Identifier: Apache-2.0
 *
 * Who is alive: a question that only the kernel answers.
 *
 * Problem.  A lock must outlive neither its owner nor be taken from a living one, although owners are killed, stopped
 * in debuggers, live in other PID namespaces, and pids are used again.
 *
 * Means.  A writer slot is claimed by an open-file-description lock (F_OFD_SETLK) on one byte of the segment's file,
 * on a description of its own, which only a one-page mapping keeps open.  The kernel drops the lock when the last
 * thread that can touch that memory is gone, not before: a stopped process holds it, a killed one does not, exec and
 * munmap drop it, closing descriptors does not.  MADV_DONTFORK keeps it from forked children.
 *
 * A wrong answer must be "alive": that costs somebody a BUSY, never data.
 */
#ifndef SHMTF_SEGMENT_PEER_H
#define SHMTF_SEGMENT_PEER_H

#include <stdbool.h>

#include "segment/map.h"

/* Claim the first free slot from `hint` on, among n_slots.  *anchor keeps it until peer_release.  0, EAGAIN: all
 * slots taken, or an errno value.  fd: any descriptor of the segment. */
int peer_claim(int fd, unsigned n_slots, unsigned hint, unsigned *slot, void **anchor);
void peer_release(void *anchor);
/* Is the slot claimed?  fd must be a read-only descriptor of `file`; if it is not any more, the answer is yes. */
bool peer_alive(int fd, const map_file *file, unsigned slot);

/* The creator of a segment in place holds this from before the file has a size until it closes `fd`. */
int peer_hold_creation(int fd);
bool peer_creator_alive(int fd);

/* Forks are counted, and kept out of the moments in which a child would inherit a claim. */
void peer_fork_guard(void);
unsigned peer_fork_count(void);
void peer_fork_lock(void);
void peer_fork_unlock(void);

#endif
