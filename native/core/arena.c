/* SPDX-License-Identifier: Apache-2.0 */
#include "core/arena.h"
#include "segment/failpoint.h"

/* A value that no other attempt to claim a chunk for this frame leaves behind: attempt:40 | id:24. */
static uint64_t claim_make(uint32_t id, uint64_t lock) {
    return ((uint64_t)lock_slot(lock) << 30 | (lock_txn(lock) & 0x3fffffff)) << 24 | id;
}

/* May `word`, found in chunk c, be replaced?  *next: the first chunk that may be different. */
static bool chunk_is_free(const shmtf_segment *s, uint64_t c, uint64_t word, uint64_t mine, uint64_t *next) {
    uint32_t id = (uint32_t)(word & 0xffffff);
    *next = c + 1;
    if (!word) return true;
    if (word == mine || id > s->geo.max_frames) return false;
    /* The chunk's word was loaded first, then the lock, then the ring: a claimer locks, claims, says so, unlocks.  If the
     * lock is another transaction's than the claim, the claimer is done. */
    uint64_t lock = load_acquire(&s->frames[id].lock), ring = load_acquire(&s->frames[id].ring);
    if (ring_word_valid(s, ring)) {
        uint64_t first = ring_word_first(ring), end = first + ring_word_chunks(ring);
        if (c >= first && c < end) return *next = end, false;
    }
    return !lock_owned(lock) || word != claim_make(id, lock);
}

static bool claim_run(const shmtf_segment *s, uint64_t first, uint64_t n, uint64_t mine) {
    for (uint64_t c = first; c < first + n; c++) {
        uint64_t next, word = load_acquire(&s->chunks[c]);
        SHMTF_FAILPOINT("chunk-claimed");
        if (chunk_is_free(s, c, word, mine, &next) && cas_acq_rel(&s->chunks[c], word, mine)) continue;
        while (c-- > first) cas_acq_rel(&s->chunks[c], mine, 0);
        return false;
    }
    return true;
}

/* The first chunk of a claimed run within [from, to), or to. */
static uint64_t claim_between(const shmtf_segment *s, uint64_t from, uint64_t to, uint64_t n, uint64_t mine) {
    uint64_t run = 0, next;
    for (uint64_t c = from; c < to; c = next) {
        if (!chunk_is_free(s, c, load_acquire(&s->chunks[c]), mine, &next)) {
            run = 0;
        } else if (++run == n) {
            if (claim_run(s, c + 1 - n, n, mine)) return c + 1 - n;
            run = 0;
        }
    }
    return to;
}

uint64_t arena_claim_locked(const shmtf_segment *s, uint32_t id, uint64_t lock, unsigned log2) {
    uint64_t n = ring_word_chunks(ring_word(0, log2)), all = s->geo.n_chunks, mine = claim_make(id, lock);
    uint64_t start = load_relaxed(&s->global->chunk_hint) % all;
    uint64_t first = claim_between(s, start, all, n, mine);
    if (first == all) {
        uint64_t to = start + n < all ? start + n : all;
        first = claim_between(s, 0, to, n, mine);
        if (first == to) return 0;
    }
    store_relaxed(&s->global->chunk_hint, (first + n) % all);
    return ring_word(first, log2);
}

uint64_t arena_count_free(const shmtf_segment *s) {
    uint64_t n = 0, next;
    for (uint64_t c = 0; c < s->geo.n_chunks; c = next) n += chunk_is_free(s, c, load_acquire(&s->chunks[c]), 0, &next);
    return n;
}
