/* SPDX-License-Identifier: Apache-2.0
 *
 * Changes that know what a word means: a lock names a slot and a transaction near those that exist, a head counts near
 * what is there, a parent is a frame, a ring word leads into the arena.  Random bits are refused early, plausible lies
 * go deep.
 */
#include "fuzz.h"

typedef struct {
    uint64_t from, to;
    unsigned weight;
} region;

static uint64_t word_at(const unsigned char *at) {
    uint64_t v;
    memcpy(&v, at, sizeof v);
    return v;
}

static void put_word(unsigned char *at, uint64_t v) { atomic_store_explicit((shmtf_word *)(void *)at, v, memory_order_relaxed); }

/* Where a change behind the header goes: the bytes of one structure. */
static void choose_region(const shmtf_geometry *g, uint64_t *from, uint64_t *to) {
    const uint64_t arena_end = g->off_arena + g->n_chunks * SHMTF_CHUNK_BYTES;
    const region regions[] = {{SHMTF_PAGE, g->off_writers, 14},       {g->off_writers, g->off_authorities, 12},
                              {g->off_authorities, g->off_authorities + 512, 3}, {g->off_buckets, g->off_frames, 10},
                              {g->off_frames, g->off_names, 30},      {g->off_names, g->off_inline, 6},
                              {g->off_inline, g->off_chunks, 10},     {g->off_chunks, g->off_arena, 5},
                              {g->off_arena, arena_end, 10}};
    uint32_t at = take(100);
    for (size_t i = 0; i < sizeof regions / sizeof *regions; i++) {
        *from = regions[i].from;
        *to = regions[i].to;
        if (at < regions[i].weight) return;
        at -= regions[i].weight;
    }
}

static unsigned char *any_word(unsigned char *base, const shmtf_geometry *g) {
    uint64_t from, to;
    choose_region(g, &from, &to);
    return base + from + 8ull * take((uint32_t)((to - from) / 8));
}

/* Lock words and states near the transactions that exist. */
static uint64_t owner_like(const unsigned char *base, const shmtf_geometry *g) {
    unsigned slot = take(8) ? take((uint32_t)g->max_writers) : take(1024);
    const unsigned char *writer = base + g->off_writers + (slot % g->max_writers) * sizeof(shmtf_writer);
    uint64_t number = word_at(writer + offsetof(shmtf_writer, txn)) + take(5) - 2;
    uint64_t version = (commit_version(word_at(base + SHMTF_PAGE)) + take(5) - 2) & VERSION_MASK;
    uint64_t bit = take(2);
    switch (take(5)) {
    case 0: return lock_released(lock_make(slot, number)) | bit << 62;
    case 1: return STATE_PREPARED | bit * STATE_TOPOLOGY | version;
    case 2: return STATE_COMMITTED | bit * STATE_TOPOLOGY | version;
    case 3: return commit_make(slot, version);
    default: return lock_make(slot, number) | bit << 62;
    }
}

static uint64_t record_like(const shmtf_geometry *g) {
    uint32_t a = take(64), b = take(8), c = take(4); /* in this order, on every compiler */
    uint64_t bits = (c & 1 ? HEAD_BIG : 0) | (c & 2 ? HEAD_INDEXED : 0);
    shmtf_frame frame = {take((uint32_t)g->max_frames + 2), b};
    switch (take(6)) {
    case 0: return head_make(a, b, bits);
    case 1: return head_make(take64(), b, bits);
    case 2: return ring_word(take((uint32_t)g->n_chunks), a & 31);
    case 3: return info_make(a, (record_kind)b, c, (uint16_t)(a * 5));
    case 4: return parent_make(frame);
    default: return edge_make(parent_make(frame), (record_kind)(a & 7), c);
    }
}

static uint64_t new_value(unsigned char *base, const shmtf_geometry *g, uint64_t old) {
    switch (take(16)) {
    case 0: return 0;
    case 1: return UINT64_MAX;
    case 2: return 1ull << take(64);
    case 3: return take(256);
    case 4: return old ^ 1ull << take(64);
    case 5: return old + 1;
    case 6: return old - 1 - take(32);
    case 7: return take64();
    case 8: return take64() >> take(64);
    case 9: return ~old;
    case 10:
    case 11: return word_at(any_word(base, g));
    case 12:
    case 13: return owner_like(base, g);
    default: return record_like(g);
    }
}

void mutate_word(unsigned char *base, const shmtf_geometry *g, unsigned char *word) {
    unsigned char *at = word ? word : any_word(base, g);
    put_word(at, new_value(base, g, word_at(at)));
}

/* Fields that hold the same thing in two frames, or two lines of anything, change places; or one is copied. */
static void mutate_block(unsigned char *base, const shmtf_geometry *g) {
    static const uint64_t sizes[] = {8, 64, 128, 256, 512};
    uint64_t size = sizes[take(5)], from, to;
    choose_region(g, &from, &to);
    if (to - from < 2 * size) return;
    unsigned char *a = base + from + take((uint32_t)((to - from) / size)) * size;
    unsigned char *b = base + from + take((uint32_t)((to - from) / size)) * size;
    unsigned char kept[512];
    memcpy(kept, a, size);
    switch (take(4)) {
    case 0: memmove(a, b, size); break;
    case 1: memset(a, take(2) ? 0 : 0xff, size); break;
    case 2:
        for (uint64_t i = 0; i < size; i += 8) put_word(a + i, take64());
        break;
    default:
        memmove(a, b, size);
        memcpy(b, kept, size);
    }
}

/* Parents that lead around: the newest records of two frames name each other, or one names itself. */
static void mutate_cycle(unsigned char *base, const shmtf_geometry *g) {
    uint32_t a = 1 + take((uint32_t)g->max_frames), b = take(3) ? 1 + take((uint32_t)g->max_frames) : a;
    shmtf_segment s;
    shmtf_layout_bind(&s, g, base);
    for (int i = 0; i < 2; i++) {
        shmtf_frame_words_t *f = &s.frames[i ? a : b];
        const shmtf_frame other = {i ? b : a, (uint32_t)word_at((unsigned char *)&s.frames[i ? b : a].gen)};
        uint64_t edge = edge_make(parent_make(other), KIND_DYNAMIC, 0);
        put_word((unsigned char *)&f->newest_edge[0], edge);
        put_word((unsigned char *)&f->newest_edge[1], edge);
        ring_ref r;
        uint64_t head = word_at((unsigned char *)&f->head[take(2)]);
        if (ring_bind(&s, i ? a : b, head, &r))
            for (uint64_t k = 0; k <= ring_mask(&r); k++) put_word((unsigned char *)&r.bodies[k].parent, parent_make(other));
    }
}

static void mutate_header(unsigned char *base, const shmtf_geometry *g) {
    unsigned char *at = base + 8ull * take(sizeof(shmtf_header) / 8);
    if (one_in(4)) put_word(at, word_at(base + 8ull * take(sizeof(shmtf_header) / 8)));
    else put_word(at, new_value(base, g, word_at(at)));
}

void mutate_some(unsigned char *base, const shmtf_geometry *g) {
    static const uint32_t most[] = {1, 1, 1, 1, 4, 4, 4, 32, 32, 300};
    uint32_t n = 1 + take(most[take(10)]);
    if (one_in(16)) mutate_header(base, g);
    if (one_in(8)) mutate_cycle(base, g);
    for (uint32_t i = 0; i < n; i++) {
        if (one_in(8)) mutate_block(base, g);
        else mutate_word(base, g, NULL);
    }
}
