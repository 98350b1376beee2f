/* SPDX-License-Identifier: Apache-2.0
 * The name table: what a name may be, crowded buckets, and names that come and go, read at every commit. */
#include "core/names.h"

#include "support/check.h"
#include "support/world.h"

static world w;
static writer wr;
static uint64_t seed = 0xdeadbeefcafef00dull;

static void check_utf8(void) {
    static const char *const good[] = {"a", "base_link", "r\xc3\xa4umlich", "\xe6\x9c\xba", "\xf0\x9f\xa4\x96", "\xef\xbf\xbf", "\xf4\x8f\xbf\xbf", "\x7f", ""};
    static const char *const bad[] = {"\x80", "\xc3", "\xc3(", "\xc0\x80", "\xe0\x80\x80", "\xe6\x9c", "\xed\xa0\x80", "\xf0\x8f\xbf\xbf",
                                      "\xf4\x90\x80\x80", "\xf8\x88\x80\x80\x80", "\xff", "ok\xe6"};
    for (size_t i = 0; i < sizeof good / sizeof *good; i++) CHECK(find_utf8(good[i]));
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) CHECK(!find_utf8(bad[i]));
}

static void check_keys(void) {
    name_key a, b;
    char name[140];
    CHECK(names_key(&a, NULL) && names_key(&a, "") && names_key(&a, "/base"));
    for (size_t n = 1; n < 130; n++) {
        memset(name, 'x', n);
        name[n] = 0;
        CHECK((names_key(&a, name) == NULL) == (n <= 127));
        if (n > 127) continue;
        name[n - 1] = 'y';
        CHECK(!names_key(&b, name) && a.hash != b.hash && a.n_words == n / 8 + 1);
    }
    CHECK(!names_key(&a, "a/b") && !names_key(&b, "a"));
}

/* Names that all hash to one bucket. */
static void crowd(char (*names)[24], size_t n, uint64_t n_buckets) {
    name_key key;
    for (size_t found = 0, i = 0; found < n; i++) {
        snprintf(names[found], 24, "n%zu", i);
        if (names_key(&key, names[found])) abort();
        found += (key.hash & (n_buckets - 1)) == n_buckets - 1; /* the last: neighbours wrap around */
    }
}

static void check_overflow(void) {
    enum { N = 40 };
    char names[N + 1][24];
    shmtf_frame frame;
    world_make(&w, 64, 8, -1, 0, 4);
    writer_make(&wr, &w, 0);
    crowd(names, N + 1, w.s.geo.n_buckets);
    for (int i = 0; i < N; i++) {
        EQUAL(find_frame(&w, now_of(&w), names[i], &frame), RING_NONE);
        EQUAL(write_one(&wr, edge_at("root", names[i], 1, i)), STAGE_OK);
        for (int k = 0; k <= i; k++) EQUAL(find_frame(&w, now_of(&w), names[k], &frame), RING_OK);
    }
    CHECK(atomic_load(&w.s.global->reach) >= N / SHMTF_BUCKET_HINTS);
    for (int round = 0; round < 300; round++) {
        int i = (int)(check_random(&seed) % N);
        EQUAL(remove_named(&wr, names[i]), STAGE_OK);
        EQUAL(find_frame(&w, now_of(&w), names[i], &frame), RING_NONE);
        EQUAL(find_frame(&w, now_of(&w), names[N], &frame), RING_NONE);
        EQUAL(write_one(&wr, edge_at("root", names[i], 1, round)), STAGE_OK);
        for (int k = 0; k < N; k++) EQUAL(find_frame(&w, now_of(&w), names[k], &frame), RING_OK);
    }
    uint64_t full = 0;
    for (uint64_t b = 0; b < w.s.geo.n_buckets; b++)
        for (int i = 0; i < SHMTF_BUCKET_HINTS; i++) full += atomic_load(&w.s.buckets[b].hint[i]) != 0;
    CHECK(full <= w.s.geo.max_frames + SHMTF_BUCKET_HINTS); /* garbage is written over */
    writer_free(&wr);
    world_free(&w);
}

enum { POOL = 24, FRAMES = 9, ROUNDS = 4000, BACK = 8 };

typedef struct {
    shmtf_frame alive[POOL]; /* gen 0: no such frame */
} past;
static past history[ROUNDS + 64];
static shmtf_frame handles[POOL * 4];

static void check_history(uint64_t now, long *old) {
    for (uint64_t back = 0; back < BACK && back < now; back++) {
        const past *p = &history[now - back];
        uint64_t snapshot = commit_make(0, now - back);
        for (int k = 0; k < POOL; k++) {
            char name[24];
            shmtf_frame f;
            snprintf(name, sizeof name, "frame-%d", k);
            ring_status st = find_frame(&w, snapshot, name, &f);
            if (st == RING_OLD && back) {
                (*old)++;
                continue;
            }
            EQUAL(st, p->alive[k].gen ? RING_OK : RING_NONE);
            if (st == RING_OK) CHECK(f.id == p->alive[k].id && f.gen == p->alive[k].gen);
        }
        for (size_t h = 0; h < sizeof handles / sizeof *handles; h++) {
            bool alive = false;
            for (int k = 0; k < POOL; k++) alive |= p->alive[k].gen && p->alive[k].id == handles[h].id && p->alive[k].gen == handles[h].gen;
            ring_status st = names_alive(&w.s, snapshot, handles[h]);
            if (st == RING_OLD && back) continue;
            EQUAL(st, alive ? RING_OK : RING_NONE);
        }
    }
}

/* Births and removals in a store with fewer frames than names; some births are aborted after their binding. */
static void check_life(void) {
    long old = 0, full = 0, aborted = 0;
    world_make(&w, FRAMES, 8, -1, 0, 4);
    writer_make(&wr, &w, 0);
    NEED(write_one(&wr, static_edge("root", "frame-0", 0)) == STAGE_OK);
    past p = {0};
    find_frame(&w, now_of(&w), "frame-0", &p.alive[0]);
    history[1] = p;
    int alive = 1, n_handles = 0;
    for (int round = 0; round < ROUNDS && check_failures < 20; round++) {
        int k = (int)(check_random(&seed) % POOL);
        char name[24];
        snprintf(name, sizeof name, "frame-%d", k);
        if (p.alive[k].gen) {
            EQUAL(remove_named(&wr, name), STAGE_OK);
            p.alive[k] = (shmtf_frame){0, 0};
            alive--;
        } else if (check_random(&seed) % 4 == 0) {
            shmtf_transform t = edge_at("root", name, 1, round);
            NEED(stage_begin(&wr, &t, 1) == STAGE_OK);
            stage_status st = stage_transforms(&wr.g);
            CHECK(st == STAGE_OK || st == STAGE_FULL_FRAMES);
            txn_abort(&wr.x);
            stage_forget_unborn(&wr.g);
            EQUAL(t.child.frame.gen, 0);
            aborted++;
        } else {
            shmtf_transform t = check_random(&seed) % 2 ? edge_at("root", name, 1, round) : static_edge("root", name, round);
            stage_status st = write_all(&wr, &t, 1);
            EQUAL(st, alive < FRAMES - 1 ? STAGE_OK : STAGE_FULL_FRAMES);
            full += st != STAGE_OK;
            if (st == STAGE_OK) {
                p.alive[k] = t.child.frame;
                handles[n_handles++ % (POOL * 4)] = t.child.frame;
                alive++;
            }
        }
        uint64_t now = commit_version(now_of(&w));
        history[now] = p;
        check_history(now, &old);
    }
    printf("names: %ld answers too old, %ld refused as full, %ld aborted births\n", old, full, aborted);
    CHECK(full && aborted);
    writer_free(&wr);
    world_free(&w);
}

static void check_copy(void) {
    char name[SHMTF_NAME_SIZE], longest[SHMTF_NAME_SIZE];
    memset(longest, 'z', sizeof longest - 1);
    longest[sizeof longest - 1] = 0;
    world_make(&w, 4, 8, -1, 0, 4);
    writer_make(&wr, &w, 0);
    NEED(write_one(&wr, edge_at("12345678", longest, 1, 1)) == STAGE_OK);
    shmtf_frame f;
    EQUAL(find_frame(&w, now_of(&w), longest, &f), RING_OK);
    CHECK(names_copy(&w.s, f, name) && !strcmp(name, longest));
    EQUAL(find_frame(&w, now_of(&w), "12345678", &f), RING_OK);
    CHECK(names_copy(&w.s, f, name) && !strcmp(name, "12345678"));
    CHECK(!names_copy(&w.s, (shmtf_frame){f.id, f.gen + 2}, name) && !names_copy(&w.s, (shmtf_frame){0, 2}, name));
    CHECK(!names_copy(&w.s, (shmtf_frame){99, 2}, name) && !name[0]);
    writer_free(&wr);
    world_free(&w);
}

int main(void) {
    check_utf8();
    check_keys();
    check_overflow();
    check_life();
    check_copy();
    return check_result("names");
}
