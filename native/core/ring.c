/* SPDX-License-Identifier: Apache-2.0
 *
 * The reading side of ring.h: loads only.
 */
#include "core/ring.h"

/* A frame's head as it counts at S, and the lock word it was found under. */
typedef struct {
    const shmtf_frame_words_t *f;
    uint64_t lock, head;
    uint64_t own_tag, own_version; /* a transaction committed at S but not applied, whose staged records count */
    ring_ref ring;
} ring_view;

enum { VIEW_TRIES = 16, FLIP_HORIZON = 1 << 13 };

static ring_status view_take(const shmtf_segment *s, uint32_t id, uint64_t snapshot, ring_view *v) {
    v->f = &s->frames[id];
    for (int tries = 0; tries < VIEW_TRIES; tries++) {
        /* The lock first, the head second: whoever unlocks has put the head in force before. [E5 acquire] */
        v->lock = load_acquire(&v->f->lock);
        unsigned sel = lock_sel(v->lock), slot = lock_slot(v->lock);
        v->own_tag = v->own_version = 0;
        if (lock_owned(v->lock) && slot < s->geo.max_writers) {
            /* S was loaded before this state, as state_decided requires. [E4 acquire] */
            uint64_t state = load_acquire(&s->writers[slot].state);
            if (state_decided(snapshot, slot, state) && state_version(state) <= commit_version(snapshot)) {
                sel ^= 1;
                v->own_tag = lock_tag(v->lock);
                v->own_version = state_version(state);
            }
        }
        v->head = load_acquire(&v->f->head[sel]);
        bool bound = ring_bind(s, id, v->head, &v->ring);
        if (load_acquire(&v->f->lock) == v->lock) return bound ? RING_OK : RING_CORRUPT;
    }
    return RING_AGAIN;
}

bool ring_owned_place(const shmtf_segment *s, uint64_t snapshot, ring_place *p) {
    unsigned slot = lock_slot(p->lock);
    p->sel = lock_sel(p->lock);
    if (slot >= s->geo.max_writers) return false;
    /* S was loaded before this state, as state_decided requires; while the lock stands, it is that owner's. [E4 acquire] */
    uint64_t state = load_acquire(&s->writers[slot].state);
    bool committed = state_decided(snapshot, slot, state) && state_version(state) <= commit_version(snapshot);
    if (committed) p->sel ^= 1;
    p->tag = load_acquire(&p->f->newest_tag[p->sel]);
    if (committed && p->tag == lock_tag(p->lock)) p->tag = state_version(state);
    return p->tag - 1 < commit_version(snapshot);
}

/* Is everything at or above `lowest` still where the view found it? */
static bool view_holds(const ring_view *v, uint64_t lowest) {
    fence_acquire();
    if (load_relaxed(&v->f->lock) == v->lock) return true;
    for (int tries = 0; tries < VIEW_TRIES; tries++) {
        uint64_t lock = load_acquire(&v->f->lock), head = load_acquire(&v->f->head[lock_sel(lock)]);
        if (load_acquire(&v->f->lock) != lock) continue;
        if ((head ^ v->head) & HEAD_BIG) return false;
        /* The index half that the view used is rewritten by the second late stamp after it; flips wrap, counts don't. */
        bool ours = v->own_tag && lock_owned(lock) && lock_tag(lock) == v->own_tag;
        if ((v->head & HEAD_INDEXED) && head_flips(head) != head_flips(v->head) && !ours) return false;
        if (head_count(head) > head_count(v->head) + FLIP_HORIZON) return false;
        return head_count(head) < lowest + shmtf_ring_live(v->ring.log2);
    }
    return false;
}

typedef enum { RECORD_OK, RECORD_NEWER, RECORD_UNSTABLE, RECORD_NEVER } record_status;

static record_status record_read(const ring_view *v, uint64_t slot, uint64_t snapshot, ring_record *out) {
    const shmtf_record_head *h = &v->ring.heads[slot];
    uint64_t tag = load_acquire(&h->tag), version = tag; /* [E3 acquire] */
    if (!tag) return RECORD_NEVER;
    if (lock_owned(tag)) {
        if (tag != v->own_tag) return RECORD_UNSTABLE;
        version = v->own_version;
    }
    if (version > commit_version(snapshot)) return RECORD_NEWER;
    ring_copy(h, &v->ring.bodies[slot], out);
    fence_acquire(); /* [E3 acquire] */
    uint64_t again = load_relaxed(&h->tag);
    if (again != tag && !(tag == v->own_tag && again == v->own_version)) return RECORD_UNSTABLE;
    out->version = version;
    return RECORD_OK;
}

/* Positions in the window of a head: the first that may still be live. */
static uint64_t window_first(const ring_view *v) {
    uint64_t count = head_count(v->head), live = shmtf_ring_live(v->ring.log2);
    return count > live ? count - live + 1 : 1;
}

static ring_status latest_in_view(const ring_view *v, uint64_t snapshot, ring_record *out) {
    uint64_t first = window_first(v);
    bool ended = false;
    for (uint64_t p = head_count(v->head); p >= first && !ended; p--) {
        switch (record_read(v, ring_slot(&v->ring, v->head, p), snapshot, out)) {
        case RECORD_NEWER: continue;
        case RECORD_UNSTABLE: return RING_AGAIN;
        case RECORD_NEVER: ended = true; continue;
        case RECORD_OK: out->position = p; return view_holds(v, p) ? RING_OK : RING_AGAIN;
        }
    }
    /* "Nothing" is an answer about S only if no record can have left since. */
    return first == 1 && !ended && view_holds(v, 1) ? RING_NONE : RING_OLD;
}

ring_status ring_latest_any(const shmtf_segment *s, uint32_t id, uint64_t snapshot, ring_record *out) {
    for (int tries = 0; tries < VIEW_TRIES; tries++) {
        ring_view v;
        ring_status st = view_take(s, id, snapshot, &v);
        if (st == RING_OK) st = latest_in_view(&v, snapshot, out);
        if (st != RING_AGAIN) return st;
    }
    return RING_OLD; /* re-examine under a newer S instead of spinning here */
}

static int64_t stamp_in(const ring_ref *r, uint64_t head, uint64_t p) {
    return (int64_t)load_relaxed(&r->heads[ring_slot(r, head, p)].stamp);
}
static int64_t stamp_at(const ring_view *v, uint64_t p) { return stamp_in(&v->ring, v->head, p); }

/* Gallops from the guess, then halves. */
uint64_t ring_last_not_after(const ring_ref *r, uint64_t head, uint64_t lo, uint64_t hi, uint64_t guess, int64_t t) {
    uint64_t left = lo - 1, right = hi, step = 1, p = guess;
    if (hi <= lo) return left;
    if (stamp_in(r, head, p) > t) {
        right = p;
        while (right > lo) {
            p = right - (step < right - lo ? step : right - lo);
            if (stamp_in(r, head, p) <= t) {
                left = p;
                break;
            }
            right = p;
            step *= 2;
        }
    } else {
        left = p;
        while (left + 1 < right) {
            p = step < right - 1 - left ? left + step : right - 1;
            if (stamp_in(r, head, p) > t) {
                right = p;
                break;
            }
            left = p;
            step *= 2;
        }
    }
    while (right - left > 1) {
        uint64_t middle = left + (right - left) / 2;
        if (stamp_in(r, head, middle) > t) right = middle;
        else left = middle;
    }
    return left;
}

/* The same in a view, with the period of the two newest as a guess: a steady sensor costs a few probes at any age. */
static uint64_t last_not_after(const ring_view *v, uint64_t lo, uint64_t hi, int64_t t) {
    if (hi <= lo) return lo - 1;
    int64_t newest = stamp_at(v, hi);
    uint64_t period = (uint64_t)newest - (uint64_t)stamp_at(v, hi - 1);
    return ring_last_not_after(&v->ring, v->head, lo, hi, ring_guess(lo, hi, newest, period, t), t);
}

/* First position of the segment that is in force at S, as far as it still lives. */
static uint64_t segment_first(const ring_view *v, const ring_record *newest) {
    uint64_t base = info_base(newest->info, newest->position), window = window_first(v);
    return base > window ? base : window;
}

/* Going down from p, the first record visible at S. */
static record_status visible_down(const ring_view *v, uint64_t snapshot, uint64_t p, uint64_t first, ring_record *out) {
    for (; p >= first; p--) {
        record_status k = record_read(v, ring_slot(&v->ring, v->head, p), snapshot, out);
        out->position = p;
        if (k != RECORD_NEWER) return k;
    }
    return RECORD_NEWER;
}

/* Going up from p, the first visible record, or the last visible one with the same stamp. */
static record_status visible_up(const ring_view *v, uint64_t snapshot, uint64_t p, uint64_t last, ring_record *out) {
    record_status found = RECORD_NEWER;
    for (; p <= last; p++) {
        if (found == RECORD_OK && stamp_at(v, p) != out->stamp) return RECORD_OK;
        ring_record r;
        record_status k = record_read(v, ring_slot(&v->ring, v->head, p), snapshot, &r);
        if (k == RECORD_NEWER) continue;
        if (k != RECORD_OK) return k;
        *out = r;
        out->position = p;
        found = RECORD_OK;
    }
    return found;
}

/* Has any record come since S?  Then "before the oldest" may be about records that S still had. */
static bool moved_since(const ring_view *v, uint64_t snapshot) {
    for (uint64_t p = window_first(v); p <= head_count(v->head); p++) {
        uint64_t tag = load_acquire(&v->ring.heads[ring_slot(&v->ring, v->head, p)].tag);
        if (tag == v->own_tag) continue;
        if (lock_owned(tag) || tag > commit_version(snapshot)) return true;
    }
    return false;
}

static ring_status around_in_view(const shmtf_segment *s, const ring_view *v, uint64_t snapshot, int64_t t,
                                  ring_around_result *out) {
    ring_status st = latest_in_view(v, snapshot, &out->newest);
    out->has_before = out->has_after = false;
    if (st != RING_OK || info_kind(out->newest.info) != KIND_DYNAMIC) return st;
    const ring_record *newest = &out->newest;
    uint64_t first = segment_first(v, newest), at = newest->position;
    int64_t horizon = ring_horizon(s, newest->stamp);
    if (t < newest->stamp) at = last_not_after(v, first, newest->position, t);
    record_status k = visible_down(v, snapshot, at, first, &out->before);
    if (k == RECORD_UNSTABLE || k == RECORD_NEVER) return RING_AGAIN;
    bool found = k == RECORD_OK;
    if (found && out->before.stamp > t) return RING_AGAIN;
    out->has_before = found && out->before.stamp >= horizon;
    if (t < newest->stamp && !(out->has_before && out->before.stamp == t)) {
        k = visible_up(v, snapshot, at + 1, newest->position, &out->after);
        if (k != RECORD_OK || out->after.stamp <= t) return RING_AGAIN;
        out->has_after = true;
    }
    uint64_t lowest = found ? out->before.position : first;
    if (!out->has_before || t > newest->stamp) { /* the caller reports a failure and wants the range */
        ring_record oldest;
        uint64_t p = first <= newest->position && stamp_at(v, first) < horizon
                         ? last_not_after(v, first, newest->position, horizon - 1) + 1 : first;
        if (visible_up(v, snapshot, p, newest->position, &oldest) != RECORD_OK) return RING_AGAIN;
        out->oldest_stamp = oldest.stamp;
        if (p < lowest) lowest = p;
        k = visible_down(v, snapshot, newest->position - 1, first, &oldest);
        if (k == RECORD_UNSTABLE || k == RECORD_NEVER) return RING_AGAIN;
        out->alone = k != RECORD_OK;
        /* What has left since may have been older than the newest at S, or later than S. */
        if (out->alone && first > info_base(newest->info, newest->position)) return RING_OLD;
        if (!out->alone && oldest.position < lowest) lowest = oldest.position;
    }
    if (!found && first > info_base(newest->info, newest->position) && moved_since(v, snapshot)) return RING_OLD;
    return view_holds(v, lowest) ? RING_OK : RING_AGAIN;
}

ring_status ring_around(const shmtf_segment *s, uint32_t id, uint64_t snapshot, int64_t t, ring_around_result *out) {
    for (int tries = 0; tries < VIEW_TRIES; tries++) {
        ring_view v;
        ring_status st = view_take(s, id, snapshot, &v);
        if (st == RING_OK) st = around_in_view(s, &v, snapshot, t, out);
        if (st != RING_AGAIN) return st;
    }
    return RING_OLD;
}

static ring_status list_in_view(const shmtf_segment *s, const ring_view *v, uint64_t snapshot, ring_record *out, size_t max,
                                size_t *n) {
    ring_record newest;
    ring_status st = latest_in_view(v, snapshot, &newest);
    *n = 0;
    if (st != RING_OK || max == 0) return st;
    out[(*n)++] = newest;
    if (info_kind(newest.info) != KIND_DYNAMIC) return RING_OK;
    uint64_t first = segment_first(v, &newest);
    int64_t horizon = ring_horizon(s, newest.stamp);
    uint64_t p = newest.position;
    while (p > first && *n < max) {
        ring_record *r = &out[*n];
        record_status k = record_read(v, ring_slot(&v->ring, v->head, --p), snapshot, r);
        if (k == RECORD_NEWER) continue;
        if (k != RECORD_OK) return RING_AGAIN;
        if (r->stamp < horizon) break;
        r->position = p;
        if (r->stamp != out[*n - 1].stamp) (*n)++; /* of equal stamps the last commit was seen first */
    }
    return view_holds(v, p) ? RING_OK : RING_AGAIN;
}

ring_status ring_list(const shmtf_segment *s, uint32_t id, uint64_t snapshot, ring_record *out, size_t max, size_t *n) {
    for (int tries = 0; tries < VIEW_TRIES; tries++) {
        ring_view v;
        ring_status st = view_take(s, id, snapshot, &v);
        if (st == RING_OK) st = list_in_view(s, &v, snapshot, out, max, n);
        if (st != RING_AGAIN) return st;
    }
    return RING_OLD;
}

ring_status ring_changed_since(const shmtf_segment *s, uint32_t id, uint64_t snapshot, uint64_t since, bool *changed) {
    ring_view v;
    ring_status st = view_take(s, id, snapshot, &v);
    *changed = false;
    if (st != RING_OK) return st;
    /* Positions follow stamps, not commits: a late stamp may be anywhere.  What was evicted is older than what is here. */
    for (uint64_t p = head_count(v.head); p >= window_first(&v) && !*changed; p--) {
        uint64_t tag = load_acquire(&v.ring.heads[ring_slot(&v.ring, v.head, p)].tag);
        uint64_t version = tag && tag == v.own_tag ? v.own_version : tag;
        *changed = !lock_owned(version) && version > since && version <= commit_version(snapshot);
    }
    return view_holds(&v, 0) || *changed ? RING_OK : RING_AGAIN;
}
