/* SPDX-License-Identifier: Apache-2.0
 *
 * A ring of records that is history and version store at once.
 *
 * Problem.  Writers append while readers want the records as they were at one commit S, without locks, without
 * writing, and without waiting for a writer that is preempted, stopped or dead.
 *
 * Protocol.  Positions count from 1 for ever; position p lies in slot (p-1) mod R, or, once a late stamp came, in the
 * slot that an order index names for p.  Records are sorted by stamp within a *segment*; a record's `base` says where
 * its segment begins.  `head` counts the records in force.  A writer fills slots behind the head, which no reader looks
 * at, and its commit puts a new head in force; so a slot is overwritten only when it has been outside every current
 * head for `spare` positions.  A reader takes the head in force at S (the lock's transaction may be committed but not
 * yet applied: then it is the other head), goes down from the newest position past records with a version above S,
 * copies one, and checks that nothing it relied on has moved: the tag of each record (a seqlock of its own), and the
 * lock word (unchanged: the head was unchanged too).
 *
 * Why a stale read is harmless.  Every index is masked or bounded before use, so a wrong word leads to a wrong slot
 * inside the ring, and the checks at the end throw the result away.
 *
 * What it cannot do.  A reader that sleeps while its ring turns over gets RING_OLD and needs a newer S.
 */
#ifndef SHMTF_CORE_RING_H
#define SHMTF_CORE_RING_H

#include <string.h>

#include "segment/layout.h"
#include "segment/lock.h"
#include "shmtf.h"

typedef enum {
    RING_OK,
    RING_NONE,   /* nothing was there at S */
    RING_AGAIN,  /* moved under the reader: read this ring again at the same S */
    RING_OLD,    /* what S needs was overwritten: take a newer S */
    RING_CORRUPT /* an impossible word */
} ring_status;

typedef enum { KIND_NONE, KIND_ROOT, KIND_DYNAMIC, KIND_STATIC, KIND_REMOVED, KIND_CLEAR } record_kind;

/* A record, copied out. */
typedef struct {
    uint64_t version, arrival, info, parent, position;
    int64_t stamp;
    shmtf_pose pose;
} ring_record;

static inline record_kind info_kind(uint64_t info) { return (record_kind)(info >> 24 & 15); }
static inline uint64_t info_flags(uint64_t info) { return info >> 28 & 15; }
static inline uint16_t info_writer(uint64_t info) { return (uint16_t)(info >> 32); }
static inline uint16_t info_epoch(uint64_t info) { return (uint16_t)(info >> 48); }
static inline uint64_t info_make(uint64_t base, record_kind kind, uint64_t flags, uint16_t writer) {
    return (base & 0xffffff) | (uint64_t)kind << 24 | flags << 28 | (uint64_t)writer << 32;
}
/* First position of the segment of the record at `position`. */
static inline uint64_t info_base(uint64_t info, uint64_t position) { return position - ((position - info) & 0xffffff); }

static inline uint64_t parent_make(shmtf_frame f) { return (uint64_t)f.gen << 24 | f.id; }
static inline shmtf_frame parent_frame(uint64_t parent) {
    return (shmtf_frame){(uint32_t)(parent & 0xffffff), (uint32_t)(parent >> 24)};
}

/* The same in the copy beside a lock. */
#define PARENT_MASK ((1ull << 56) - 1)
static inline uint64_t edge_make(uint64_t parent, record_kind kind, uint64_t flags) { return (parent & PARENT_MASK) | (uint64_t)kind << 56 | flags << 60; }
static inline uint64_t edge_parent(uint64_t edge) { return edge & PARENT_MASK; }
static inline record_kind edge_kind(uint64_t edge) { return (record_kind)(edge >> 56 & 15); }
static inline uint64_t edge_flags(uint64_t edge) { return edge >> 60; }
static inline uint64_t search_make(uint64_t base, uint64_t period) { return (base & 0xffffff) | (period >> 40 ? 0 : period << 24); }
static inline uint64_t search_base(uint64_t search) { return search & 0xffffff; }
static inline uint64_t search_period(uint64_t search) { return search >> 24; }

/* A ring's memory. */
typedef struct {
    shmtf_record_head *heads;
    shmtf_record_body *bodies;
    shmtf_word32 *index; /* two halves of 2^log2 entries; NULL for inline rings */
    unsigned log2;
} ring_ref;

/* A frame's ring word: offset in the arena, a multiple of the chunk size | used:1 (bit 5) | log2:5. */
enum { RING_USED = 1 << 5 };
static inline uint64_t ring_word(uint64_t first_chunk, unsigned log2) { return first_chunk * SHMTF_CHUNK_BYTES | RING_USED | log2; }
static inline unsigned ring_word_log2(uint64_t word) { return (unsigned)word & 31; }
static inline uint64_t ring_word_offset(uint64_t word) { return word & ~(uint64_t)(SHMTF_CHUNK_BYTES - 1); }
static inline uint64_t ring_word_first(uint64_t word) { return word / SHMTF_CHUNK_BYTES; }
static inline uint64_t ring_word_chunks(uint64_t word) {
    return (shmtf_ring_bytes(ring_word_log2(word), sizeof(shmtf_record_body)) + SHMTF_CHUNK_BYTES - 1) / SHMTF_CHUNK_BYTES;
}
/* Does the word name a ring inside the arena? */
HOT_INLINE bool ring_word_valid(const shmtf_segment *s, uint64_t word) {
    return (word & RING_USED) && ring_word_offset(word) < s->ring_limit[ring_word_log2(word)];
}

/* The ring that `head` is about.  False: the frame's ring word is impossible, or changing. */
static inline bool ring_bind(const shmtf_segment *s, uint32_t id, uint64_t head, ring_ref *r) {
    if (!(head & HEAD_BIG)) {
        shmtf_inline_ring *in = &s->inlines[id];
        *r = (ring_ref){in->head, in->body, NULL, SHMTF_INLINE_LOG2};
        return true;
    }
    uint64_t word = load_relaxed(&s->frames[id].ring);
    if (!ring_word_valid(s, word)) return false;
    unsigned log2 = ring_word_log2(word);
    unsigned char *at = s->arena + ring_word_offset(word);
    r->heads = (shmtf_record_head *)(void *)at;
    r->bodies = (shmtf_record_body *)(void *)(at + (sizeof(shmtf_record_head) << log2));
    r->index = (shmtf_word32 *)(void *)(at + ((sizeof(shmtf_record_head) + sizeof(shmtf_record_body)) << log2));
    r->log2 = log2;
    return true;
}

static inline uint64_t ring_mask(const ring_ref *r) { return (1ull << r->log2) - 1; }

static inline uint64_t ring_slot(const ring_ref *r, uint64_t head, uint64_t position) {
    uint64_t mask = ring_mask(r), at = (position - 1) & mask;
    if (!(head & HEAD_INDEXED) || !r->index) return at;
    return load32_relaxed(&r->index[((head_flips(head) & 1) << r->log2) + at]) & mask;
}

HOT_INLINE shmtf_pose ring_pose(const shmtf_word pose[SHMTF_POSE_WORDS]) {
    return (shmtf_pose){load_double(&pose[0]), load_double(&pose[1]), load_double(&pose[2]), load_double(&pose[3]),
                        load_double(&pose[4]), load_double(&pose[5]), load_double(&pose[6])};
}

HOT_INLINE void ring_copy(const shmtf_record_head *h, const shmtf_record_body *b, ring_record *out) {
    out->stamp = (int64_t)load_relaxed(&h->stamp);
    out->arrival = load_relaxed(&h->arrival);
    out->info = load_relaxed(&h->info);
    out->parent = load_relaxed(&b->parent);
    out->pose = ring_pose(b->pose);
}

/* The general case of ring_latest: the frame is locked, or its newest record is newer than S. */
ring_status ring_latest_any(const shmtf_segment *s, uint32_t id, uint64_t snapshot, ring_record *out);

/* A frame's newest record, as its copy beside the lock says. */
typedef struct {
    const shmtf_frame_words_t *f;
    uint64_t lock, tag;
    unsigned sel; /* which copy */
} ring_place;
static inline int64_t place_stamp(const ring_place *p) { return (int64_t)load_relaxed(&p->f->newest_stamp[p->sel]); }
static inline uint64_t place_edge(const ring_place *p) { return load_relaxed(&p->f->newest_edge[p->sel]); }

/* The same where somebody owns the lock. */
bool ring_owned_place(const shmtf_segment *s, uint64_t snapshot, ring_place *p);

/* The common case: the frame's newest record is not newer than S.  False: nothing is known, ask ring_latest_any.
 * Whatever is read at the place, of the frame, and of its ring as the head p->sel says, counts if, after an acquire fence,
 * the lock word is still the same: no lock word occurs twice, so one owner at most was there, and an owner changes only
 * what is not in force.  (That a writer's lock is seen by whoever saw its data is what its release fence is for.) */
HOT_INLINE bool ring_newest_place(const shmtf_segment *s, uint32_t id, uint64_t snapshot, ring_place *p) {
    p->f = &s->frames[id];
    p->lock = load_acquire(&p->f->lock); /* [E5 acquire] */
    if (__builtin_expect(lock_owned(p->lock), 0)) return ring_owned_place(s, snapshot, p);
    p->sel = lock_sel(p->lock);
    p->tag = load_acquire(&p->f->newest_tag[p->sel]);
    return p->tag - 1 < commit_version(snapshot); /* neither 0, nor an owner's tag, nor newer than S */
}

/* Without writer and time of arrival, which the copy does not hold. */
HOT_INLINE bool ring_latest_quick(const shmtf_segment *s, uint32_t id, uint64_t snapshot, ring_record *out) {
    ring_place p;
    if (!ring_newest_place(s, id, snapshot, &p)) return false;
    uint64_t edge = place_edge(&p);
    out->version = p.tag;
    out->stamp = place_stamp(&p);
    out->arrival = 0;
    out->info = info_make(search_base(load_relaxed(&p.f->newest_search[p.sel])), edge_kind(edge), edge_flags(edge), 0);
    out->parent = edge_parent(edge);
    out->pose = ring_pose(p.f->newest[p.sel].pose);
    out->position = head_count(load_relaxed(&p.f->head[p.sel]));
    fence_acquire(); /* [E3 acquire] */
    return load_relaxed(&p.f->lock) == p.lock;
}

/* The newest record (greatest stamp; of equals the last commit) as of the commit word `snapshot`. */
static inline ring_status ring_latest(const shmtf_segment *s, uint32_t id, uint64_t snapshot, ring_record *out) {
    return ring_latest_quick(s, id, snapshot, out) ? RING_OK : ring_latest_any(s, id, snapshot, out);
}

/* Around a time. */
typedef struct {
    ring_record newest;        /* of the segment that is in force at S */
    ring_record before, after; /* before: last with stamp <= t.  after: of the first stamp > t, the last commit */
    bool has_before, has_after;
    bool alone;                /* S has no other record; set where t is not between two records */
    int64_t oldest_stamp;      /* of what can still be read at S; set where t is not between two records */
} ring_around_result;

/* RING_OK: `newest` is set, and the neighbours that exist and have not expired.  Records more than `cache_time_ns`
 * (negative: any) behind the newest do not exist. */
ring_status ring_around(const shmtf_segment *s, uint32_t id, uint64_t snapshot, int64_t t, ring_around_result *out);

/* How far t is from one stamp to the next, 0 to 1: before <= t < after, differences beyond int64 included. */
static inline double ring_ratio(int64_t t, int64_t before, int64_t after) {
    int64_t part = (int64_t)((uint64_t)t - (uint64_t)before), whole = (int64_t)((uint64_t)after - (uint64_t)before);
    if (whole > 0) return (double)part / (double)whole;
    return (double)(uint64_t)part / (double)(uint64_t)whole;
}
/* Where in [lo, hi), which is not empty, the last stamp <= t is likely to be; `newest` > t is the stamp at hi. */
static inline uint64_t ring_guess(uint64_t lo, uint64_t hi, int64_t newest, uint64_t period, int64_t t) {
    uint64_t age = (uint64_t)newest - (uint64_t)t, back = period ? (age - 1) / period + 1 : 1;
    return back < hi - lo ? hi - back : lo;
}
/* The last position in [lo, hi) with a stamp <= t, or lo - 1; the stamp at hi is > t.  `guess` in [lo, hi): where to
 * begin; a right guess costs two probes. */
uint64_t ring_last_not_after(const ring_ref *r, uint64_t head, uint64_t lo, uint64_t hi, uint64_t guess, int64_t t);

/* Copy up to `max` readable records of the segment in force at S, newest first; *n: how many. */
ring_status ring_list(const shmtf_segment *s, uint32_t id, uint64_t snapshot, ring_record *out, size_t max, size_t *n);

/* Is there a record of the frame with a version above `since`, and at most S's? */
ring_status ring_changed_since(const shmtf_segment *s, uint32_t id, uint64_t snapshot, uint64_t since, bool *changed);

/* The state a writer finds and builds, under the frame's lock.  `head` moves as records are staged. */
typedef struct {
    uint32_t id;
    uint64_t lock;       /* our word in the frame's lock */
    uint64_t head0;      /* in force before */
    uint64_t head;       /* in force if this commits */
    bool used;           /* something was staged */
    bool copied;         /* the copy of the newest record is as `head` says */
    bool newest_is_ours; /* and that record was staged by this transaction */
    shmtf_word *only_tag; /* of the staged record, if it is the only one; else NULL */
    bool reindexed;      /* this transaction has written the index half that is not in force */
} ring_writer;

/* The newest record by stamp as the lock's owner sees it, staged ones included; KIND_NONE if there is none. */
void ring_newest_locked(const shmtf_segment *s, const ring_writer *w, ring_record *out);

/* Ask for the lines that the next record of a frame will go to. */
static inline void ring_announce_write(const shmtf_segment *s, uint32_t id) {
    const shmtf_frame_words_t *f = &s->frames[id];
    uint64_t head = load_relaxed(&f->head[lock_sel(load_relaxed(&f->lock))]);
    ring_ref r;
    if (!ring_bind(s, id, head, &r)) return;
    uint64_t slot = head_count(head) & ring_mask(&r); /* where no late stamp came; elsewhere it is a guess */
    __builtin_prefetch(&r.heads[slot], 1);
    __builtin_prefetch(&r.bodies[slot], 1);
}

/* Append in the plain case: a dynamic record under the same parent, later than the newest, which has a version above
 * `upto`.  False: nothing was done, ring_put_locked knows what to do. */
bool ring_append_locked(const shmtf_segment *s, ring_writer *w, uint64_t upto, int64_t stamp, int64_t arrival, uint64_t parent,
                        const shmtf_pose *pose, uint16_t writer);

/* Before the commit, where w->copied is not set: the copy of the newest record as `head` says. */
void ring_copy_newest_locked(const shmtf_segment *s, ring_writer *w);

typedef enum { PUT_OK, PUT_REPEAT, PUT_DROPPED, PUT_TOO_MANY, PUT_CORRUPT } put_status;
/* Stage a record behind the head.  rec: stamp, arrival, info (base is filled in), parent, pose.  start: the record
 * begins a segment (nothing before it counts).  big: into the big ring, which must exist.  own_tag: lock_tag(w->lock).
 * PUT_REPEAT: the same record is there already, PUT_DROPPED: older than all that a full ring keeps; nothing staged. */
put_status ring_put_locked(const shmtf_segment *s, ring_writer *w, const ring_record *rec, bool start, bool big);

/* The slots of the staged records still carry the owner's tag: give them a version. */
void ring_tag_all_staged(const shmtf_segment *s, const ring_writer *w, uint64_t version);
static inline void ring_tag_staged(const shmtf_segment *s, const ring_writer *w, uint64_t version) {
    if (w->only_tag) store_relaxed(w->only_tag, version);
    else if (w->used) ring_tag_all_staged(s, w, version);
    if (w->newest_is_ours) store_relaxed(&s->frames[w->id].newest_tag[lock_sel(w->lock) ^ 1], version);
}
/* Finish what a committed lock holder staged: tags, then unlock with the other head in force.  Idempotent; for any
 * number of helpers, dead or stalled at any point. */
void ring_apply(const shmtf_segment *s, uint32_t id, uint64_t lock, uint64_t version);
/* The same by the owner, whose tags are in place already. */
static inline void ring_unlock(const shmtf_segment *s, const ring_writer *w) {
    cas_acq_rel(&s->frames[w->id].lock, w->lock, lock_applied(w->lock)); /* [E5 release] */
}

/* Smallest stamp that has not expired beside a newest stamp. */
static inline int64_t ring_horizon(const shmtf_segment *s, int64_t newest) {
    if (s->geo.cache_time_ns < 0 || newest < INT64_MIN + s->geo.cache_time_ns) return INT64_MIN;
    return newest - s->geo.cache_time_ns;
}

#endif
