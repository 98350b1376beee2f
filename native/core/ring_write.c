/* SPDX-License-Identifier: Apache-2.0
 *
 * The writing side of ring.h: staging behind the head under the frame's lock, and finishing what committed.
 *
 * A kill before the commit leaves garbage in slots that no head reaches and a lock that anybody can release.  A kill
 * after it leaves tags and a lock that anybody can finish: every store here that is not behind the head is a CAS from
 * a value that occurs once.
 */
#include "core/ring.h"
#include "segment/failpoint.h"

void ring_newest_locked(const shmtf_segment *s, const ring_writer *w, ring_record *out) {
    ring_ref r;
    uint64_t count = head_count(w->head);
    memset(out, 0, sizeof *out);
    if (!count || !ring_bind(s, w->id, w->head, &r)) return;
    uint64_t slot = ring_slot(&r, w->head, count);
    ring_copy(&r.heads[slot], &r.bodies[slot], out);
    out->version = load_relaxed(&r.heads[slot].tag);
    out->position = count;
}

_Static_assert(offsetof(shmtf_pose, qw) == 6 * sizeof(double), "a pose is seven doubles in the order of a record");
static inline void store_pose(shmtf_word word[SHMTF_POSE_WORDS], const shmtf_pose *pose) {
    uint64_t qw;
    store_double_pair(&word[0], &pose->x);
    store_double_pair(&word[2], &pose->z);
    store_double_pair(&word[4], &pose->qy);
    memcpy(&qw, &pose->qw, sizeof qw);
    store_relaxed(&word[6], qw);
}

/* Fill a slot.  The tag says "being written" before the first word changes. */
HOT_INLINE void record_write(shmtf_record_head *h, shmtf_record_body *b, uint64_t own_tag, int64_t stamp, uint64_t arrival,
                             uint64_t info, uint64_t parent, const shmtf_pose *pose) {
    store_relaxed(&h->tag, own_tag);
    fence_release(); /* [E3 release] */
    SHMTF_FAILPOINT("slot-taken");
    store_relaxed(&h->stamp, (uint64_t)stamp);
    store_relaxed(&h->arrival, arrival);
    store_relaxed(&h->info, info);
    SHMTF_FAILPOINT("half-written");
    store_pose(b->pose, pose);
    store_relaxed(&b->parent, parent);
}

HOT_INLINE void newest_write(shmtf_frame_words_t *f, unsigned sel, uint64_t tag, int64_t stamp, uint64_t edge, uint64_t search,
                             const shmtf_pose *pose) {
    store_relaxed(&f->newest_tag[sel], tag);
    store_relaxed(&f->newest_stamp[sel], (uint64_t)stamp);
    store_relaxed(&f->newest_edge[sel], edge);
    SHMTF_FAILPOINT("half-copied");
    store_relaxed(&f->newest_search[sel], search);
    store_pose(f->newest[sel].pose, pose);
}

bool ring_append_locked(const shmtf_segment *s, ring_writer *w, uint64_t upto, int64_t stamp, int64_t arrival, uint64_t parent,
                        const shmtf_pose *pose, uint16_t writer) {
    ring_ref r;
    shmtf_frame_words_t *f = &s->frames[w->id];
    const uint64_t count = head_count(w->head), edge = edge_make(parent, KIND_DYNAMIC, 0);
    unsigned next = lock_sel(w->lock) ^ 1, newest = w->used ? next : next ^ 1;
    if (w->used && !w->copied) return false;
    uint64_t was = load_relaxed(&f->newest_stamp[newest]), base = info_base(search_base(load_relaxed(&f->newest_search[newest])), count);
    if (!(w->head & HEAD_BIG) || count - 1 >= HEAD_COUNT_MASK - 1 || load_relaxed(&f->newest_tag[newest]) <= upto || (int64_t)was >= stamp ||
        load_relaxed(&f->newest_edge[newest]) != edge || !ring_bind(s, w->id, w->head, &r))
        return false;
    uint64_t slot = ring_slot(&r, w->head, count + 1), live = shmtf_ring_live(r.log2);
    if (w->used && count - head_count(w->head0) >= shmtf_ring_spare(r.log2)) return false;
    if (count + 1 - base > live) base = count + 1 - live;
    record_write(&r.heads[slot], &r.bodies[slot], lock_tag(w->lock), stamp, (uint64_t)arrival,
                 info_make(base, KIND_DYNAMIC, 0, writer), parent, pose);
    newest_write(f, next, lock_tag(w->lock), stamp, edge, search_make(base, (uint64_t)stamp - was), pose);
    w->head++; /* the count is its low part */
    w->only_tag = w->used ? NULL : &r.heads[slot].tag;
    w->used = w->copied = w->newest_is_ours = true;
    SHMTF_FAILPOINT("staged");
    return true;
}

void ring_copy_newest_locked(const shmtf_segment *s, ring_writer *w) {
    ring_ref r;
    shmtf_frame_words_t *f = &s->frames[w->id];
    const uint64_t count = head_count(w->head);
    unsigned next = lock_sel(w->lock) ^ 1;
    w->copied = true;
    fence_release(); /* [E3 release] */
    if (!count || !ring_bind(s, w->id, w->head, &r)) {
        store_relaxed(&f->newest_tag[next], 0);
        return;
    }
    ring_record newest;
    uint64_t slot = ring_slot(&r, w->head, count), tag = load_relaxed(&r.heads[slot].tag), period = 0;
    ring_copy(&r.heads[slot], &r.bodies[slot], &newest);
    uint64_t base = info_base(newest.info, count);
    if (count > base) period = (uint64_t)newest.stamp - load_relaxed(&r.heads[ring_slot(&r, w->head, count - 1)].stamp);
    newest_write(f, next, tag, newest.stamp, edge_make(newest.parent, info_kind(newest.info), info_flags(newest.info)),
                 search_make(base, period), &newest.pose);
    w->newest_is_ours = tag == lock_tag(w->lock);
}

/* Move the frame to its other ring, which is emptied first: a slot of an earlier era must not pass for a record. */
static bool switch_ring(const shmtf_segment *s, ring_writer *w, bool big, ring_ref *r) {
    uint64_t head = head_make(head_count(w->head), head_flips(w->head) + 1, big ? HEAD_BIG : 0);
    if (!ring_bind(s, w->id, head, r)) return false;
    for (uint64_t i = 0; i <= ring_mask(r); i++) store_relaxed(&r->heads[i].tag, 0);
    SHMTF_FAILPOINT("ring-emptied");
    w->head = head;
    w->reindexed = false;
    return true;
}

/* Give position `q` to slot `slot` and move everything from q on up by one, in the index half not in force. */
static void index_insert(ring_writer *w, const ring_ref *r, uint64_t q, uint64_t slot) {
    uint64_t count = head_count(w->head), mask = ring_mask(r), old = w->head;
    if (!w->reindexed) {
        w->head = head_make(count, head_flips(old) + 1, (old & HEAD_BIG) | HEAD_INDEXED);
        w->reindexed = true;
    }
    shmtf_word32 *half = r->index + ((head_flips(w->head) & 1) << r->log2);
    if (old != w->head)
        for (uint64_t p = 1; p <= mask + 1; p++) store32_relaxed(&half[p - 1], (uint32_t)ring_slot(r, old, p));
    for (uint64_t p = count + 1; p > q; p--) store32_relaxed(&half[(p - 1) & mask], load32_relaxed(&half[(p - 2) & mask]));
    SHMTF_FAILPOINT("half-indexed");
    store32_relaxed(&half[(q - 1) & mask], (uint32_t)slot);
}

static bool same_pose(const shmtf_pose *a, const shmtf_pose *b) { return memcmp(a, b, sizeof *a) == 0; }

/* Where in [first, count+1] a record with this stamp belongs: behind the last one that is not later. */
static uint64_t insert_position(const ring_ref *r, uint64_t head, uint64_t first, int64_t stamp) {
    uint64_t q = head_count(head) + 1;
    while (q > first && (int64_t)load_relaxed(&r->heads[ring_slot(r, head, q - 1)].stamp) > stamp) q--;
    return q;
}

put_status ring_put_locked(const shmtf_segment *s, ring_writer *w, const ring_record *rec, bool start, bool big) {
    ring_ref r;
    uint64_t count = head_count(w->head), base = count + 1, q = base;
    bool is_big = (w->head & HEAD_BIG) != 0;
    if (is_big != big) {
        if (!switch_ring(s, w, big, &r)) return PUT_CORRUPT;
        start = true;
    } else if (!ring_bind(s, w->id, w->head, &r)) {
        return PUT_CORRUPT;
    }
    uint64_t live = shmtf_ring_live(r.log2);
    if (count - head_count(w->head0) >= shmtf_ring_spare(r.log2)) return PUT_TOO_MANY;
    if (count == HEAD_COUNT_MASK) return PUT_CORRUPT; /* positions are used up */
    if (!start && count) {
        uint64_t window = count >= live ? count - live + 1 : 1;
        base = info_base(load_relaxed(&r.heads[ring_slot(&r, w->head, count)].info), count);
        if (base < window) base = window;
        q = insert_position(&r, w->head, base, rec->stamp);
        if (count >= live && q <= count + 1 - live) return PUT_DROPPED;
        if (q > base) { /* compare with the last record of this stamp */
            ring_record before;
            uint64_t slot = ring_slot(&r, w->head, q - 1);
            ring_copy(&r.heads[slot], &r.bodies[slot], &before);
            if (before.stamp == rec->stamp && before.parent == rec->parent && same_pose(&before.pose, &rec->pose))
                return PUT_REPEAT;
        }
    }
    uint64_t slot = ring_slot(&r, w->head, count + 1);
    uint64_t info = info_make(base, info_kind(rec->info), info_flags(rec->info), info_writer(rec->info));
    record_write(&r.heads[slot], &r.bodies[slot], lock_tag(w->lock), rec->stamp, rec->arrival, info, rec->parent, &rec->pose);
    if (q <= count) index_insert(w, &r, q, slot);
    w->head = head_make(count + 1, head_flips(w->head), w->head & (HEAD_BIG | HEAD_INDEXED));
    w->only_tag = w->used ? NULL : &r.heads[slot].tag;
    w->used = true;
    w->copied = false;
    SHMTF_FAILPOINT("staged");
    return PUT_OK;
}

/* The mapping under which a transaction's slots were taken: the old head's, or a fresh ring's. */
static uint64_t staging_head(uint64_t before, uint64_t after) {
    return (before ^ after) & HEAD_BIG ? after & ~HEAD_INDEXED : before;
}

void ring_tag_all_staged(const shmtf_segment *s, const ring_writer *w, uint64_t version) {
    ring_ref r;
    uint64_t head = staging_head(w->head0, w->head);
    if (!ring_bind(s, w->id, head, &r)) return;
    for (uint64_t p = head_count(w->head0) + 1; p <= head_count(w->head); p++)
        store_relaxed(&r.heads[ring_slot(&r, head, p)].tag, version);
}

void ring_apply(const shmtf_segment *s, uint32_t id, uint64_t lock, uint64_t version) {
    shmtf_frame_words_t *f = &s->frames[id];
    unsigned sel = lock_sel(lock);
    uint64_t before = load_acquire(&f->head[sel]), after = load_acquire(&f->head[sel ^ 1]);
    if (load_acquire(&f->lock) != lock) return;
    ring_ref r;
    uint64_t head = staging_head(before, after), first = head_count(before) + 1;
    if (ring_bind(s, id, head, &r))
        for (uint64_t p = first; p <= head_count(after) && p < first + shmtf_ring_spare(r.log2); p++) {
            shmtf_word *tag = &r.heads[ring_slot(&r, head, p)].tag;
            if (load_relaxed(tag) == lock_tag(lock)) cas_acq_rel(tag, lock_tag(lock), version);
        }
    shmtf_word *newest = &f->newest_tag[sel ^ 1];
    if (load_relaxed(newest) == lock_tag(lock)) cas_acq_rel(newest, lock_tag(lock), version);
    SHMTF_FAILPOINT("tagged");
    cas_acq_rel(&f->lock, lock, lock_applied(lock)); /* [E5 release] */
}
