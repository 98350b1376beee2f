/* SPDX-License-Identifier: Apache-2.0
 * Transactions of several writers in one thread: conflicts, deaths at each phase, helping, adoption, wishes. */
#include "core/txn.h"

#include "core/arena.h"
#include "support/check.h"
#include "support/world.h"

enum { AGED_FRAMES = 6 };
static world w;
static writer a, b, c, heir; /* heir: of a dead writer's slot */

static void begin(uint64_t frames) {
    world_make(&w, frames, 14, -1, 0, 4);
    writer_make(&a, &w, 0);
    writer_make(&b, &w, 1);
    writer_make(&c, &w, 2);
}
static void end(void) {
    writer_free(&a);
    writer_free(&b);
    writer_free(&c);
    world_free(&w);
}

/* How far a writer came before it died. */
typedef enum { STAGED, HEADS, TAGGED, PREPARED, COMMITTED, FINISHED, HALF_APPLIED, N_PHASES } phase;

/* txn_commit up to a phase; then the writer never does anything again. */
static void die_at(writer *wr, phase until) {
    txn *x = &wr->x;
    shmtf_writer *slot = &w.s.writers[x->slot];
    uint64_t g = now_of(&w), version = commit_version(g) + 1, shape = x->reshapes ? STATE_TOPOLOGY : 0;
    if (until >= HEADS)
        for (size_t i = 0; i < x->n; i++) {
            ring_writer *e = &x->entries[i].w;
            if (!e->copied) ring_copy_newest_locked(&w.s, e);
            atomic_store(&w.s.frames[e->id].head[lock_sel(e->lock) ^ 1], e->head);
        }
    if (until >= TAGGED)
        for (size_t i = 0; i < x->n; i++) ring_tag_staged(&w.s, &x->entries[i].w, version);
    if (until >= PREPARED) atomic_store(&slot->state, STATE_PREPARED | shape | version);
    if (until >= COMMITTED) NEED(atomic_compare_exchange_strong(&w.s.global->commit, &g, commit_make(x->slot, version)));
    if (until >= FINISHED) {
        if (shape) raise_to(&w.s.global->topology, version);
        atomic_store(&slot->state, STATE_COMMITTED | shape | version);
    }
    if (until >= HALF_APPLIED) ring_apply(&w.s, x->entries[0].w.id, x->entries[0].w.lock, version);
}

static double value_of(const char *child) {
    lookup l;
    return look_up(&w, now_of(&w), "p", child, NULL, &l) == LOOKUP_OK ? l.pose.x : -1;
}

static uint64_t locks_held(void) {
    uint64_t n = 0;
    for (uint32_t id = 0; id <= w.s.geo.max_frames; id++) n += lock_owned(atomic_load(&w.s.frames[id].lock));
    return n;
}

static void stage_two(writer *wr, double x) {
    static shmtf_transform t[2];
    t[0] = edge_at("p", "f", 10, x);
    t[1] = edge_at("p", "g", 10, x);
    NEED(stage_begin(wr, t, 2) == STAGE_OK && stage_transforms(&wr->g) == STAGE_OK);
}

/* Dead at each phase; found by a reader, then by a writer who knows, or by who adopts the slot. */
static void check_deaths(void) {
    for (int phase_ = 0; phase_ < N_PHASES; phase_++)
        for (int way = 0; way < 3; way++) {
            begin(8);
            NEED(write_one(&a, edge_at("p", "f", 5, 1)) == STAGE_OK && write_one(&a, edge_at("p", "g", 5, 1)) == STAGE_OK);
            uint64_t before = now_of(&w);
            stage_two(&b, 2);
            die_at(&b, (phase)phase_);
            double want = phase_ >= COMMITTED ? 2 : 1;
            CHECK(value_of("f") == want && value_of("g") == want);
            lookup l;
            EQUAL(look_up(&w, before, "p", "f", NULL, &l), LOOKUP_OK);
            CHECK(l.pose.x == 1);
            if (way == 0) { /* another writer meets it, alive: helps what is decided, is refused what is not */
                stage_status st = write_one(&a, edge_at("p", "g", 20, 3));
                EQUAL(st, phase_ >= COMMITTED ? STAGE_OK : STAGE_HELD);
                if (st == STAGE_HELD) {
                    EQUAL(lock_slot(a.x.blocked_by), 1);
                    recover_dead(&w.s, a.x.blocked_id, a.x.blocked_by);
                    EQUAL(write_one(&a, edge_at("p", "g", 20, 3)), STAGE_OK);
                }
                CHECK(value_of("f") == want && value_of("g") == 3);
            }
            if (way == 1) { /* others commit first, so that the commit word has moved on */
                for (int i = 0; i < 3; i++) EQUAL(write_one(&a, static_edge("p", "z", i)), STAGE_OK);
                CHECK(value_of("f") == want && value_of("g") == want);
            }
            writer_make(&heir, &w, 1);
            EQUAL(locks_held(), 0);
            CHECK(value_of("f") == want && (way == 0 || value_of("g") == want));
            EQUAL(write_all(&heir, (shmtf_transform[]){edge_at("p", "f", 30, 4), edge_at("p", "g", 30, 4)}, 2), STAGE_OK);
            CHECK(value_of("f") == 4 && value_of("g") == 4);
            writer_free(&heir);
            EQUAL(txn_begin(&b.x), TXN_LOST); /* it was not dead after all: it must notice */
            end();
        }
}

static void check_stolen_commit(void) {
    begin(8);
    NEED(write_one(&a, edge_at("p", "f", 5, 1)) == STAGE_OK && write_one(&a, edge_at("p", "g", 5, 1)) == STAGE_OK);
    stage_two(&b, 2);
    recover_dead(&w.s, b.x.entries[0].w.id, b.x.entries[0].w.lock);
    uint64_t version;
    EQUAL(txn_commit(&b.x, &version), TXN_LOST);
    CHECK(value_of("f") == 1 && value_of("g") == 1);
    EQUAL(locks_held(), 0);
    end();
}

/* A frame whose removal was committed is free, also while its remover's lock stands. */
static void check_free_frame_of_the_dead(void) {
    for (int phase_ = COMMITTED; phase_ <= FINISHED; phase_++) {
        begin(2);
        NEED(write_one(&a, edge_at("p", "f", 5, 1)) == STAGE_OK);
        shmtf_ref ref = shmtf_by_name("f");
        NEED(stage_begin(&b, NULL, 0) == STAGE_OK && stage_remove(&b.g, &ref) == STAGE_OK);
        die_at(&b, (phase)phase_);
        EQUAL(write_one(&a, edge_at("p", "h", 5, 2)), STAGE_OK);
        CHECK(value_of("h") == 2);
        end();
    }
}

/* A writer dies with a free frame in its hands, at each phase. */
static void check_dead_births(void) {
    for (int phase_ = 0; phase_ < N_PHASES; phase_++) {
        begin(3);
        shmtf_transform t = edge_at("p", "f", 5, 1);
        NEED(stage_begin(&b, &t, 1) == STAGE_OK && stage_transforms(&b.g) == STAGE_OK);
        die_at(&b, (phase)phase_);
        CHECK(value_of("f") == (phase_ >= COMMITTED ? 1 : -1));
        writer_make(&heir, &w, 1);
        writer_free(&heir);
        EQUAL(locks_held(), 0);
        EQUAL(write_one(&a, edge_at("p", "f", 6, 2)), STAGE_OK);
        EQUAL(write_one(&a, edge_at("p", "g", 6, 3)), STAGE_OK);
        CHECK(value_of("f") == 2 && value_of("g") == 3);
        EQUAL(write_one(&a, edge_at("p", "h", 6, 3)), STAGE_FULL_FRAMES);
        end();
    }
}

/* What was checked under one shape must not be committed under another. */
static void check_validation(void) {
    begin(8);
    NEED(write_one(&a, edge_at("p", "f", 5, 1)) == STAGE_OK && write_one(&a, edge_at("p", "g", 5, 1)) == STAGE_OK);
    shmtf_transform up = edge_at("g", "f", 6, 1), down = edge_at("f", "g", 6, 1), born = edge_at("p", "n", 6, 1), child = edge_at("n", "m", 6, 1);
    NEED(stage_begin(&b, &up, 1) == STAGE_OK && stage_transforms(&b.g) == STAGE_OK);
    NEED(stage_begin(&c, &down, 1) == STAGE_OK && stage_transforms(&c.g) == STAGE_OK);
    EQUAL(stage_end(&b, STAGE_OK), STAGE_OK);
    EQUAL(stage_end(&c, STAGE_OK), STAGE_RETRY);
    EQUAL(write_all(&c, &down, 1), STAGE_CYCLE);
    shmtf_transform same = born;
    NEED(stage_begin(&b, &born, 1) == STAGE_OK && stage_transforms(&b.g) == STAGE_OK);
    NEED(stage_begin(&c, &same, 1) == STAGE_OK && stage_transforms(&c.g) == STAGE_OK);
    CHECK(born.child.frame.id != same.child.frame.id);
    EQUAL(stage_end(&c, STAGE_OK), STAGE_OK);
    EQUAL(stage_end(&b, STAGE_OK), STAGE_RETRY);
    EQUAL(born.child.frame.gen, 0);
    NEED(stage_begin(&b, &child, 1) == STAGE_OK && stage_transforms(&b.g) == STAGE_OK);
    EQUAL(remove_named(&a, "n"), STAGE_OK);
    EQUAL(stage_end(&b, STAGE_OK), STAGE_RETRY);
    EQUAL(write_all(&b, &child, 1), STAGE_OK); /* makes n anew */
    NEED(stage_begin(&b, &child, 1) == STAGE_OK);
    child.stamp_ns = 7;
    NEED(stage_transforms(&b.g) == STAGE_OK);
    EQUAL(clear_all(&a, true), STAGE_OK);
    EQUAL(stage_end(&b, STAGE_OK), STAGE_RETRY);
    EQUAL(locks_held(), 0);
    end();
}

/* A batch of which everything is there already says as of which commit: one that has it. */
static void check_repeats(void) {
    begin(8);
    shmtf_transform t = edge_at("p", "f", 5, 1), again = t;
    NEED(write_one(&a, edge_at("p", "f", 4, 0)) == STAGE_OK);
    NEED(stage_begin(&a, &again, 1) == STAGE_OK);
    NEED(write_one(&b, t) == STAGE_OK);
    EQUAL(stage_end(&a, stage_transforms(&a.g)), STAGE_OK);
    EQUAL(a.x.repeats, 1);
    EQUAL(a.as_of, b.version);
    EQUAL(commit_version(now_of(&w)), b.version);
    NEED(stage_begin(&a, &again, 1) == STAGE_OK);
    NEED(clear_all(&b, false) == STAGE_OK);
    EQUAL(stage_end(&a, stage_transforms(&a.g)), STAGE_RETRY); /* it was there once, and is not now */
    EQUAL(locks_held(), 0);
    end();
}

/* A cycle of an older edge and a newer one never was. */
static void check_cycles_of_two_commits(void) {
    begin(8);
    const char *child[] = {"a", "c", "d"}, *parent[] = {"r", "r", "a"};
    for (int i = 0; i < 3; i++) NEED(write_one(&a, edge_at(parent[i], child[i], 10, 1)) == STAGE_OK);
    shmtf_transform batch[] = {edge_at("r", "a", 5, 2), edge_at("d", "c", 20, 2)};
    NEED(stage_begin(&a, batch, 2) == STAGE_OK);
    NEED(write_one(&b, edge_at("r", "d", 11, 3)) == STAGE_OK);
    NEED(write_one(&b, edge_at("c", "a", 12, 3)) == STAGE_OK);
    EQUAL(stage_end(&a, stage_transforms(&a.g)), STAGE_RETRY);
    EQUAL(write_all(&a, batch, 2), STAGE_OK);
    NEED(write_one(&b, edge_at("c", "r", 13, 3)) == STAGE_CYCLE);
    EQUAL(locks_held(), 0);
    end();
}

static void check_wants(void) {
    begin(8);
    NEED(write_one(&a, edge_at("p", "f", 5, 1)) == STAGE_OK);
    uint32_t id = id_of(&w, "f");
    NEED(txn_begin(&b.x) == TXN_OK);
    txn_want(&b.x, id);
    a.x.yields = true;
    EQUAL(write_one(&a, edge_at("p", "f", 6, 2)), STAGE_HELD);
    CHECK(a.x.blocked_id == id && a.x.blocked_by == b.x.own);
    a.x.yields = false;
    EQUAL(write_one(&a, edge_at("p", "f", 6, 2)), STAGE_OK);
    a.x.yields = true;
    EQUAL(write_one(&b, edge_at("p", "f", 7, 3)), STAGE_OK); /* its next transaction: the wish is over */
    EQUAL(write_one(&a, edge_at("p", "f", 8, 4)), STAGE_OK);
    NEED(txn_begin(&b.x) == TXN_OK);
    txn_want(&b.x, id);
    txn_unwant(&b.x, id);
    EQUAL(write_one(&a, edge_at("p", "f", 9, 5)), STAGE_OK);
    NEED(txn_begin(&b.x) == TXN_OK);
    txn_want(&b.x, id);
    recover_adopt(&w.s, 1);
    EQUAL(write_one(&a, edge_at("p", "f", 10, 6)), STAGE_OK);
    end();
}

/* A wish with priority takes the place of another, is kept from those who defer to it, and each defers to it once. */
static void check_wants_with_priority(void) {
    begin(8);
    NEED(write_one(&a, edge_at("p", "f", 5, 1)) == STAGE_OK);
    uint32_t id = id_of(&w, "f");
    NEED(txn_begin(&a.x) == TXN_OK && txn_begin(&b.x) == TXN_OK);
    b.x.priority = true;
    txn_want(&a.x, id);
    txn_want(&b.x, id);
    uint64_t wish = load_relaxed(&w.s.frames[id].want);
    CHECK(wish_first(wish) && lock_tag(wish) == b.x.own);
    txn_want(&a.x, id); /* does not take it back */
    txn_unwant(&a.x, id);
    EQUAL(load_relaxed(&w.s.frames[id].want), wish);
    a.x.defers = true;
    EQUAL(write_one(&a, edge_at("p", "f", 6, 2)), STAGE_HELD);
    CHECK(a.x.blocked_by == wish && a.x.wished);
    a.x.deferred_to = wish;
    EQUAL(write_one(&a, edge_at("p", "f", 6, 2)), STAGE_OK);
    a.x.priority = true;
    a.x.deferred_to = 0;
    EQUAL(write_one(&a, edge_at("p", "f", 7, 3)), STAGE_OK); /* among equals nobody gives way */
    a.x.priority = false;
    txn_unwant(&b.x, id);
    EQUAL(load_relaxed(&w.s.frames[id].want), 0);
    EQUAL(write_one(&a, edge_at("p", "f", 8, 4)), STAGE_OK);
    NEED(txn_begin(&b.x) == TXN_OK);
    txn_want(&b.x, id);
    recover_adopt(&w.s, 1);
    EQUAL(write_one(&a, edge_at("p", "f", 9, 5)), STAGE_OK); /* of a dead writer */
    EQUAL(load_relaxed(&w.s.frames[id].want), 0);
    end();
}

/* Rings of free frames are taken when no other memory is left. */
static void check_reclaim(void) {
    begin(AGED_FRAMES);
    char name[16];
    for (int i = 1; i < AGED_FRAMES; i++) {
        snprintf(name, sizeof name, "f%d", i);
        NEED(write_one(&a, edge_at("p", name, 5, 1)) == STAGE_OK);
    }
    EQUAL(arena_count_free(&w.s), ring_word_chunks(ring_word(0, w.s.geo.default_log2)));
    for (int i = 1; i < AGED_FRAMES; i++) {
        snprintf(name, sizeof name, "f%d", i);
        EQUAL(remove_named(&a, name), STAGE_OK);
    }
    EQUAL(declare_named(&a, "big", w.s.geo.default_log2 + 2), STAGE_OK);
    EQUAL(locks_held(), 0);
    end();
}

int main(void) {
    check_deaths();
    check_stolen_commit();
    check_free_frame_of_the_dead();
    check_dead_births();
    check_validation();
    check_repeats();
    check_cycles_of_two_commits();
    check_wants();
    check_wants_with_priority();
    check_reclaim();
    return check_result("txn");
}
