/* SPDX-License-Identifier: Apache-2.0 */
#include "core/names.h"
#include "segment/failpoint.h"

#define HINT_GEN_MASK 0xffffffull
static uint64_t hint_make(uint64_t hash, uint64_t gen, uint32_t id) { return (hash >> 48) << 48 | (gen & HINT_GEN_MASK) << 24 | id; }
static uint32_t hint_id(uint64_t hint) { return (uint32_t)(hint & 0xffffff); }
static uint64_t hint_gen(uint64_t hint) { return hint >> 24 & HINT_GEN_MASK; }

/* Multiply and fold, a word at a time: wyhash's mixing step, enough for a table that compares names anyway. */
static uint64_t hash_word(uint64_t h, uint64_t w) {
    __extension__ typedef unsigned __int128 u128;
    u128 m = (u128)(h ^ 0x2d358dccaa6c78a5ull) * (w ^ 0x8bb84b93962eacc9ull);
    return (uint64_t)m ^ (uint64_t)(m >> 64);
}

static uint64_t hash_words(const uint64_t *word, unsigned n) {
    uint64_t h = n;
    for (unsigned i = 0; i < n; i++) h = hash_word(h, word[i]);
    return hash_word(h, n);
}

/* The last, partial word of a name, without reading behind it or through memory just written. */
static uint64_t tail_word(const char *name, size_t n) {
    size_t rest = n % 8;
    uint64_t w = 0;
    if (!rest) return 0;
    if (n >= 8) {
        memcpy(&w, name + n - 8, 8);
        return w >> (8 * (8 - rest));
    }
    for (size_t i = rest; i-- > 0;) w = w << 8 | (unsigned char)name[i];
    return w;
}

const char *names_key(name_key *key, const char *name) {
    if (!name || !name[0]) return "a frame name is empty";
    if (name[0] == '/') return "a frame name starts with '/'";
    size_t n = strlen(name);
    if (n >= SHMTF_NAME_SIZE) return "a frame name is longer than 127 bytes";
    unsigned full = (unsigned)(n / 8);
    uint64_t h = full + 1;
    for (unsigned i = 0; i < full; i++) {
        memcpy(&key->word[i], name + 8 * i, 8);
        h = hash_word(h, key->word[i]);
    }
    key->word[full] = tail_word(name, n); /* the NUL included */
    key->n_words = full + 1;
    key->hash = hash_word(hash_word(h, key->word[full]), key->n_words);
    return NULL;
}

static shmtf_bucket *bucket_of(const shmtf_segment *s, uint64_t hash, uint64_t beyond) {
    return &s->buckets[(hash + beyond) & (s->geo.n_buckets - 1)];
}

static uint64_t reach_of(const shmtf_segment *s) {
    uint64_t reach = load_acquire(&s->global->reach);
    return reach < s->geo.n_buckets ? reach : s->geo.n_buckets - 1;
}

/* Does the hint's frame have this name, under an even gen that matches the hint?  *gen: that gen. */
static bool hint_matches(const shmtf_segment *s, uint64_t hint, const name_key *key, uint64_t *gen) {
    uint32_t id = hint_id(hint);
    if (!hint || (hint ^ key->hash) >> 48 || !id || id > s->geo.max_frames) return false;
    *gen = load_acquire(&s->frames[id].gen); /* [E7 acquire] */
    if ((*gen & 1) || (*gen & HINT_GEN_MASK) != hint_gen(hint)) return false;
    const shmtf_name_t *name = &s->names[id];
    for (unsigned i = 0; i < key->n_words; i++)
        if (load_relaxed(&name->word[i]) != key->word[i]) return false;
    fence_acquire(); /* [E7 acquire] */
    return load_relaxed(&s->frames[id].gen) == *gen;
}

ring_status names_alive(const shmtf_segment *s, uint64_t snapshot, shmtf_frame frame) {
    ring_record r;
    if (!frame.id || frame.id > s->geo.max_frames) return RING_NONE;
    const shmtf_frame_words_t *f = &s->frames[frame.id];
    ring_status st = ring_latest(s, frame.id, snapshot, &r);
    if (st == RING_CORRUPT && (uint32_t)load_acquire(&f->gen) != frame.gen) st = RING_NONE;
    fence_acquire(); /* [E7 acquire] */
    bool same = (uint32_t)load_acquire(&f->gen) == frame.gen; /* and the floor after it */
    if (load_acquire(&f->floor) > commit_version(snapshot)) return names_unborn_at(f, snapshot) ? RING_NONE : RING_OLD;
    if (!same) return RING_NONE;
    if (st == RING_OK && info_kind(r.info) == KIND_REMOVED) return RING_NONE;
    return st;
}

ring_status names_find(const shmtf_segment *s, uint64_t snapshot, const name_key *key, shmtf_frame *out) {
    uint64_t reach = reach_of(s), gen;
    for (uint64_t b = 0; b <= reach; b++)
        for (int i = 0; i < SHMTF_BUCKET_HINTS; i++) {
            uint64_t hint = load_acquire(&bucket_of(s, key->hash, b)->hint[i]); /* [E8 acquire] */
            if (!hint_matches(s, hint, key, &gen)) continue;
            *out = (shmtf_frame){hint_id(hint), (uint32_t)gen};
            ring_status st = names_alive(s, snapshot, *out);
            if (st != RING_NONE) return st;
        }
    /* A miss speaks about S only if nothing was bound or unbound here since. */
    fence_acquire();
    for (uint64_t b = 0; b <= reach; b++)
        if (load_acquire(&bucket_of(s, key->hash, b)->floor) > commit_version(snapshot)) return RING_OLD;
    return reach_of(s) > reach ? RING_AGAIN : RING_NONE; /* an impossible reach is the same the next time */
}

bool names_guess(const shmtf_segment *s, const name_key *key, shmtf_frame *out) {
    const shmtf_bucket *bucket = bucket_of(s, key->hash, 0);
    for (int i = 0; i < SHMTF_BUCKET_HINTS; i++)
        if (names_leads(s, load_acquire(&bucket->hint[i]), key, out)) return true; /* [E8 acquire] */
    return false;
}

void names_ask(const shmtf_segment *s, const name_key *key) { __builtin_prefetch(bucket_of(s, key->hash, 0)); }

uint64_t names_hint(const shmtf_segment *s, const name_key *key) {
    const shmtf_bucket *bucket = bucket_of(s, key->hash, 0);
    for (int i = 0; i < SHMTF_BUCKET_HINTS; i++) {
        uint64_t hint = load_acquire(&bucket->hint[i]); /* [E8 acquire] */
        if (!hint || (hint ^ key->hash) >> 48 || hint_id(hint) > s->geo.max_frames) continue;
        __builtin_prefetch(&s->names[hint_id(hint)]);
        __builtin_prefetch(&s->frames[hint_id(hint)]);
        return hint;
    }
    return 0;
}

bool names_leads(const shmtf_segment *s, uint64_t hint, const name_key *key, shmtf_frame *out) {
    uint64_t gen;
    if (!hint_matches(s, hint, key, &gen)) return false;
    *out = (shmtf_frame){hint_id(hint), (uint32_t)gen};
    return true;
}

bool names_find_bound_by(const shmtf_segment *s, const name_key *key, uint64_t own_tag, shmtf_frame *out) {
    uint64_t reach = reach_of(s), gen;
    for (uint64_t b = 0; b <= reach; b++)
        for (int i = 0; i < SHMTF_BUCKET_HINTS; i++) {
            uint64_t hint = load_acquire(&bucket_of(s, key->hash, b)->hint[i]);
            if (!hint_matches(s, hint, key, &gen)) continue;
            if (lock_tag(load_acquire(&s->frames[hint_id(hint)].lock)) != own_tag) continue;
            *out = (shmtf_frame){hint_id(hint), (uint32_t)gen};
            return true;
        }
    return false;
}

bool names_copy(const shmtf_segment *s, shmtf_frame frame, char out[SHMTF_NAME_SIZE]) {
    uint64_t word[SHMTF_NAME_WORDS];
    out[0] = 0;
    if (!frame.id || frame.id > s->geo.max_frames) return false;
    uint64_t gen = load_acquire(&s->frames[frame.id].gen); /* [E7 acquire] */
    if ((uint32_t)gen != frame.gen || (gen & 1)) return false;
    for (int i = 0; i < SHMTF_NAME_WORDS; i++) word[i] = load_relaxed(&s->names[frame.id].word[i]);
    fence_acquire(); /* [E7 acquire] */
    if (load_relaxed(&s->frames[frame.id].gen) != gen) return false;
    memcpy(out, word, sizeof word);
    out[SHMTF_NAME_SIZE - 1] = 0;
    return true;
}

bool names_frame_free(const shmtf_segment *s, uint32_t id) {
    const shmtf_frame_words_t *f = &s->frames[id];
    uint64_t lock = load_acquire(&f->lock), head = load_acquire(&f->head[lock_sel(lock)]), count = head_count(head);
    if (!count) return true;
    if (head & HEAD_BIG) return false;
    ring_ref r;
    ring_bind(s, id, head, &r);
    return info_kind(load_relaxed(&r.heads[ring_slot(&r, head, count)].info)) == KIND_REMOVED;
}

/* The old name's bucket must not answer "absent" for commits at which the old life was alive. */
static void raise_old_floor(const shmtf_segment *s, uint32_t id, uint64_t version) {
    uint64_t word[SHMTF_NAME_WORDS];
    for (int i = 0; i < SHMTF_NAME_WORDS; i++) word[i] = load_relaxed(&s->names[id].word[i]);
    if (!word[0]) return;
    unsigned n = 0;
    while (n < SHMTF_NAME_WORDS - 1 && memchr(&word[n], 0, 8) == NULL) n++;
    uint64_t hash = hash_words(word, n + 1), reach = reach_of(s);
    for (uint64_t b = 0; b <= reach; b++) raise_to(&bucket_of(s, hash, b)->floor, version);
}

/* Is this hint's frame bound under another gen by now? */
static bool hint_is_garbage(const shmtf_segment *s, uint64_t hint) {
    uint32_t id = hint_id(hint);
    return !id || id > s->geo.max_frames || (load_acquire(&s->frames[id].gen) & HINT_GEN_MASK) != hint_gen(hint);
}

static bool publish_hint(const shmtf_segment *s, const name_key *key, uint64_t hint) {
    for (uint64_t b = 0; b < s->geo.n_buckets; b++) {
        shmtf_bucket *bucket = bucket_of(s, key->hash, b);
        raise_to(&s->global->reach, b);
        for (int i = 0; i < SHMTF_BUCKET_HINTS; i++) {
            uint64_t old = load_acquire(&bucket->hint[i]); /* whose gen is looked at next [E8 acquire] */
            if ((!old || hint_is_garbage(s, old)) && cas_acq_rel(&bucket->hint[i], old, hint)) return true; /* [E8 release] */
        }
    }
    return false;
}

bool names_bind_locked(const shmtf_segment *s, uint32_t id, const name_key *key, bool keep_ring, shmtf_frame *out) {
    shmtf_frame_words_t *f = &s->frames[id];
    uint64_t gen = load_relaxed(&f->gen) & ~1ull, version = commit_version(load_acquire(&s->global->commit));
    if (!(uint32_t)(gen + 2)) gen += 2; /* a handle has its low half, and 0 there means that there is none */
    raise_to(&f->floor, version);
    SHMTF_FAILPOINT("floor-raised");
    raise_old_floor(s, id, version);
    SHMTF_FAILPOINT("buckets-raised");
    if (!load_relaxed(&f->first)) store_release(&f->first, version + 1);
    store_release(&f->gen, gen + 1); /* [E7 release] */
    fence_release();                 /* [E7 release] */
    SHMTF_FAILPOINT("bound-odd");
    for (unsigned i = 0; i < SHMTF_NAME_WORDS; i++) store_relaxed(&s->names[id].word[i], i < key->n_words ? key->word[i] : 0);
    SHMTF_FAILPOINT("name-written");
    if (!keep_ring) store_relaxed(&f->ring, 0);
    store_release(&f->gen, gen + 2); /* [E7 release] */
    *out = (shmtf_frame){id, (uint32_t)(gen + 2)};
    SHMTF_FAILPOINT("bound-even");
    return publish_hint(s, key, hint_make(key->hash, gen + 2, id));
}
