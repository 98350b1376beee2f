/* SPDX-License-Identifier: Apache-2.0
 *
 * Frame names: a lock-free table from name to frame, whose entries are only hints.
 *
 * Problem.  Names come and go while others look them up, readers write nothing, and a binder may die at any store.
 *
 * Protocol.  A frame that holds no live record is free.  Whoever holds its lock may *bind* it to a name: raise the
 * frame's floor and the floors of the old name's buckets to the current version; gen odd; name; gen even; publish a
 * hint.  Binding makes nothing visible: a frame exists at S if its newest record at S says so, and its first
 * record comes with the binder's commit.  So an aborted or killed binder leaves a free frame and a garbage hint.
 * Entries are never moved or marked: an entry whose gen is not its frame's is garbage and may be overwritten.
 *
 * A reader compares the name under an unchanged even gen.  A floor above its S says that the frame's, or the bucket's,
 * state at S is no longer known: it needs a newer S.  It never waits for an odd gen: a frame being bound exists for
 * nobody, and its old name's bucket has its floor raised already.
 *
 * Why only the old name's floor.  If a name was alive at S, then either its frame's gen still stands, and with it the hint,
 * which is not garbage and hence not overwritten; or the frame was bound again, and that binder raised the floor of this
 * very bucket before it changed the gen, which whoever finds the hint garbage, or overwritten, has seen change.
 *
 * Uniqueness.  Two binders of one name bind two frames; the commit of the second is refused because the tree's shape
 * changed, and its next attempt finds the first one's frame.
 */
#ifndef SHMTF_CORE_NAMES_H
#define SHMTF_CORE_NAMES_H

#include "core/ring.h"

/* A name as words, with its hash. */
typedef struct {
    uint64_t hash;
    uint64_t word[SHMTF_NAME_WORDS];
    unsigned n_words; /* that are not zero */
} name_key;

/* NULL, or why the name is refused. */
const char *names_key(name_key *key, const char *name);

/* The frame that has this name at S.  RING_NONE: no frame has it. */
ring_status names_find(const shmtf_segment *s, uint64_t snapshot, const name_key *key, shmtf_frame *out);

/* The first frame bound to this name, alive or not: a hint for a caller that finds out about its life by itself, and
 * asks names_find if it has none. */
bool names_guess(const shmtf_segment *s, const name_key *key, shmtf_frame *out);

/* A search in steps, so that several may wait for memory together: ask for the bucket; the hint in it that most likely
 * leads to the name, or 0, asking for its frame; and whether it does. */
void names_ask(const shmtf_segment *s, const name_key *key);
uint64_t names_hint(const shmtf_segment *s, const name_key *key);
bool names_leads(const shmtf_segment *s, uint64_t hint, const name_key *key, shmtf_frame *out);

/* Among frames locked with `lock_tag`, the one being bound to this name; false if there is none. */
bool names_find_bound_by(const shmtf_segment *s, const name_key *key, uint64_t own_tag, shmtf_frame *out);

/* Copy a frame's name out; false if the handle is stale or the name is being changed. */
bool names_copy(const shmtf_segment *s, shmtf_frame frame, char out[SHMTF_NAME_SIZE]);

/* Bind the frame `id`, whose lock the caller holds and which is free, to a name.  keep_ring: its ring, if it has one,
 * stays.  False: the name table is full around this name. */
bool names_bind_locked(const shmtf_segment *s, uint32_t id, const name_key *key, bool keep_ring, shmtf_frame *out);

/* Is the frame free, as its lock's owner or a hopeful binder sees it? */
bool names_frame_free(const shmtf_segment *s, uint32_t id);

/* No life of this frame had begun at S: `first` is written once, before its first. */
static inline bool names_unborn_at(const shmtf_frame_words_t *f, uint64_t snapshot) {
    uint64_t first = load_acquire(&f->first);
    return !first || commit_version(snapshot) < first;
}

/* Is this handle's frame alive at S?  RING_OK: yes; RING_NONE: removed, or not yet there. */
ring_status names_alive(const shmtf_segment *s, uint64_t snapshot, shmtf_frame frame);

static inline uint32_t names_gen(const shmtf_segment *s, uint32_t id) { return (uint32_t)load_acquire(&s->frames[id].gen); }

#endif
