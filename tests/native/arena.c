/* SPDX-License-Identifier: Apache-2.0
 * The arena: rings never overlap, nothing leaks, dead claims are claimed again. */
#include "core/arena.h"

#include "support/check.h"
#include "support/world.h"

static world w;
static writer wr;
static uint64_t seed = 12345;

static void check_overlap(void) {
    static unsigned char used[1 << 16];
    memset(used, 0, sizeof used);
    for (uint64_t id = 1; id <= w.s.geo.max_frames; id++) {
        uint64_t ring = atomic_load(&w.s.frames[id].ring);
        if (!ring) continue;
        NEED(ring_word_valid(&w.s, ring));
        for (uint64_t c = 0; c < ring_word_chunks(ring); c++) {
            CHECK(!used[ring_word_first(ring) + c]);
            used[ring_word_first(ring) + c] = 1;
        }
    }
}

static stage_status declare(int k, unsigned log2) {
    char name[16];
    snprintf(name, sizeof name, "f%d", k);
    return declare_named(&wr, name, log2);
}

/* Rings of every size, declared and removed at random, until nothing fits; then all removed: all fits again. */
static void check_fragments(void) {
    enum { N = 40 };
    unsigned size[N] = {0};
    long full = 0;
    world_make(&w, N + 2, 14, -1, 64 << 10, 4);
    writer_make(&wr, &w, 0);
    uint64_t all = arena_count_free(&w.s);
    EQUAL(all, w.s.geo.n_chunks);
    for (int round = 0; round < 5000 && check_failures < 20; round++) {
        int k = (int)(check_random(&seed) % N);
        char name[16];
        snprintf(name, sizeof name, "f%d", k);
        if (size[k]) {
            EQUAL(declare(k, size[k]), STAGE_OK); /* again with the same size */
            EQUAL(declare(k, size[k] + 1), STAGE_DECLARED);
            EQUAL(remove_named(&wr, name), STAGE_OK);
            size[k] = 0;
        } else {
            unsigned log2 = 3 + (unsigned)(check_random(&seed) % 8);
            stage_status st = declare(k, log2);
            CHECK(st == STAGE_OK || st == STAGE_FULL_ARENA);
            full += st != STAGE_OK;
            if (st == STAGE_OK) size[k] = log2;
        }
        check_overlap();
    }
    CHECK(full);
    printf("arena: %ld refused as full\n", full);
    char name[16];
    for (int k = 0; k < N; k++) {
        snprintf(name, sizeof name, "f%d", k);
        if (size[k]) EQUAL(remove_named(&wr, name), STAGE_OK);
    }
    unsigned most = 3;
    while (ring_word_chunks(ring_word(0, most + 1)) <= all) most++;
    EQUAL(declare(0, most), STAGE_OK); /* one ring that needs nearly all: free frames gave theirs up */
    check_overlap();
    writer_free(&wr);
    world_free(&w);
}

/* A writer dies between claiming chunks and committing: the claim is nobody's. */
static void check_dead_claim(void) {
    world_make(&w, 4, 14, -1, 0, 4);
    writer victim;
    writer_make(&victim, &w, 1);
    writer_make(&wr, &w, 0);
    uint64_t all = arena_count_free(&w.s);
    for (int n = 0; n < 50; n++) {
        shmtf_transform t[2] = {edge_at("p", "a", 1, n), edge_at("p", "b", 1, n)};
        NEED(stage_begin(&victim, t, 2) == STAGE_OK);
        EQUAL(stage_transforms(&victim.g), STAGE_OK);
        CHECK(arena_count_free(&w.s) < all);
        victim.x.live_from = recover_adopt(&w.s, 1);
        memset(victim.x.entry_of, 0, (w.s.geo.max_frames + 1) * sizeof *victim.x.entry_of);
    }
    EQUAL(declare(0, 5), STAGE_OK);
    EQUAL(write_one(&wr, edge_at("p", "a", 1, 1)), STAGE_OK);
    EQUAL(write_one(&wr, edge_at("p", "b", 1, 1)), STAGE_OK);
    check_overlap();
    writer_free(&victim);
    writer_free(&wr);
    world_free(&w);
}

/* A refused write must not decide the size of a ring that is declared later. */
static void check_refused_claim(void) {
    world_make(&w, 8, 14, -1, 64 << 10, 4);
    writer_make(&wr, &w, 0);
    NEED(write_one(&wr, static_edge("a", "b", 1)) == STAGE_OK);
    EQUAL(write_one(&wr, edge_at("b", "a", 1, 1)), STAGE_CYCLE);
    EQUAL(declare_named(&wr, "a", 7), STAGE_OK);
    writer_free(&wr);
    world_free(&w);
}

/* A frame had a ring once and has none now: its claims of then are nobody's, although a transaction holds the frame. */
static void check_claims_of_before(void) {
    enum { N = 8 };
    world_make(&w, N, 14, -1, 0, 4);
    writer other;
    writer_make(&other, &w, 1);
    writer_make(&wr, &w, 0);
    unsigned most = 3;
    while (ring_word_chunks(ring_word(0, most + 1)) <= w.s.geo.n_chunks) most++;
    shmtf_transform t[N - 1];
    static const char *const names[N - 1] = {"a", "b", "c", "d", "e", "g", "h"};
    for (int i = 0; i < N - 1; i++) t[i] = edge_at("p", names[i], 1, i);
    for (int holder = 0; holder < 2; holder++) {
        EQUAL(declare(0, most), STAGE_OK);
        uint32_t id = id_of(&w, "f0");
        EQUAL(remove_named(&wr, "f0"), STAGE_OK);
        if (holder == 0) { /* this transaction itself, to which all frames are born */
            EQUAL(write_all(&wr, t, N - 1), STAGE_OK);
            for (int i = 0; i < N - 1; i++) EQUAL(remove_named(&wr, names[i]), STAGE_OK);
            EQUAL(remove_named(&wr, "p"), STAGE_OK);
        } else { /* another, which binds it to a name without a ring */
            shmtf_transform still[1] = {static_edge("p", "q", 1)};
            store_relaxed(&w.s.global->frame_hint, id - 1);
            NEED(stage_begin(&other, still, 1) == STAGE_OK && stage_transforms(&other.g) == STAGE_OK);
            CHECK(lock_owned(load_relaxed(&w.s.frames[id].lock)));
            EQUAL(write_one(&wr, edge_at("x", "y", 1, 1)), STAGE_OK);
            stage_end(&other, STAGE_OK);
        }
        check_overlap();
    }
    writer_free(&other);
    writer_free(&wr);
    world_free(&w);
}

int main(void) {
    check_fragments();
    check_claims_of_before();
    check_dead_claim();
    check_refused_claim();
    return check_result("arena");
}
