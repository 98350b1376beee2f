/* SPDX-License-Identifier: Apache-2.0
 * Batches: all or nothing for every reason to refuse one; births, handles, cycles, declarations. */
#include "core/stage.h"

#include <math.h>

#include "support/check.h"
#include "support/world.h"

static world w;
static writer wr;

static void begin(uint64_t frames) {
    world_make(&w, frames, 14, 100, 0, 4);
    writer_make(&wr, &w, 0);
}
static void end(void) {
    writer_free(&wr);
    world_free(&w);
}

/* Everything that a reader can see, as one number. */
static uint64_t picture(void) {
    uint64_t h = now_of(&w);
    for (uint32_t id = 0; id <= w.s.geo.max_frames; id++) {
        uint64_t lock = atomic_load(&w.s.frames[id].lock);
        CHECK(!lock_owned(lock));
        ring_record r;
        ring_status st = ring_latest(&w.s, id, now_of(&w), &r);
        h = h * 31 + st;
        if (st == RING_OK) h = h * 31 + r.version + (uint64_t)r.stamp * 7 + r.parent * 13;
    }
    return h;
}

static void refused(shmtf_transform *batch, size_t n, stage_status why, size_t item) {
    uint64_t before = picture();
    EQUAL(write_all(&wr, batch, n), why);
    CHECK(picture() == before);
    EQUAL(wr.g.item, item);
    for (size_t i = 0; i < n; i++) {
        shmtf_frame f;
        if (batch[i].child.name && find_frame(&w, now_of(&w), batch[i].child.name, &f) == RING_NONE) EQUAL(batch[i].child.frame.gen, 0);
    }
}

static void check_refusals(void) {
    begin(12);
    NEED(write_one(&wr, edge_at("r", "a", 1000, 1)) == STAGE_OK);
    NEED(write_one(&wr, edge_at("a", "b", 1000, 1)) == STAGE_OK);
    NEED(write_one(&wr, static_edge("b", "s", 1)) == STAGE_OK);
    shmtf_transform good = edge_at("r", "new", 1000, 3), bad = good;
#define BATCH(...) ((shmtf_transform[]){__VA_ARGS__})
    bad.pose.qw = 0.5;
    refused(BATCH(good, bad), 2, STAGE_BAD_POSE, 1);
    bad.pose.qw = NAN;
    refused(BATCH(good, bad), 2, STAGE_BAD_POSE, 1);
    refused(BATCH(good, edge_at("r", "", 1, 1)), 2, STAGE_BAD_NAME, 1);
    refused(BATCH(good, edge_at("/r", "x", 1, 1)), 2, STAGE_BAD_NAME, 1);
    refused(BATCH(good, edge_at("r", "\xff", 1, 1)), 2, STAGE_BAD_NAME, 1);
    refused(BATCH(good, edge_at("x", "x", 1, 1)), 2, STAGE_SELF, 1);
    refused(BATCH(good, edge_at("r", "a", 899, 1)), 2, STAGE_OLD_DATA, 1);
    EQUAL(wr.g.newest, 1000);
    refused(BATCH(good, edge_at("r", "a", 1001, 1), static_edge("r", "a", 1)), 3, STAGE_MIXED, 2);
    refused(BATCH(good, static_edge("b", "s", 2), static_edge("b", "s", 3), static_edge("b", "s", 4)), 4, STAGE_TOO_MANY, 3);
    EQUAL(wr.g.limit, 2);
    refused(BATCH(good, edge_at("r", "a", 1001, 1), edge_at("r", "a", 1002, 1), edge_at("r", "a", 1003, 1)), 4, STAGE_TOO_MANY, 3);
    refused(BATCH(edge_at("s", "r", 1, 1), good), 2, STAGE_CYCLE, 0);
    refused(BATCH(good, edge_at("b", "a", 1001, 1)), 2, STAGE_CYCLE, 1);
    EQUAL(write_all(&wr, BATCH(edge_at("p", "q", 1, 1), edge_at("q", "o", 1, 1), edge_at("o", "p", 1, 1)), 3), STAGE_CYCLE);
    shmtf_transform gone = good;
    gone.child = shmtf_by_handle((shmtf_frame){3, 77});
    refused(BATCH(good, gone), 2, STAGE_GONE, 1);
    gone = good;
    gone.parent = shmtf_by_handle((shmtf_frame){1, 77});
    refused(BATCH(good, gone), 2, STAGE_GONE, 1);
    for (uint32_t id = 0; id < 40; id += 13) {
        gone.parent = shmtf_by_handle((shmtf_frame){id, 77});
        CHECK(write_all(&wr, &gone, 1) == STAGE_GONE);
    }
    shmtf_transform many[16];
    char names[16][16];
    for (int i = 0; i < 16; i++) {
        snprintf(names[i], sizeof names[i], "n%d", i);
        many[i] = edge_at("r", names[i], 1, i);
    }
    refused(many, 16, STAGE_FULL_FRAMES, 8);
    EQUAL(write_all(&wr, many, 8), STAGE_OK);
    refused(&good, 1, STAGE_FULL_FRAMES, 0);
    end();
}

/* A swap of parent and child within one batch is no cycle. */
static void check_swaps(void) {
    lookup l;
    begin(8);
    NEED(write_one(&wr, edge_at("r", "a", 1, 1)) == STAGE_OK);
    NEED(write_one(&wr, edge_at("a", "b", 1, 2)) == STAGE_OK);
    EQUAL(write_all(&wr, BATCH(edge_at("b", "a", 2, 5), edge_at("r", "b", 2, 7)), 2), STAGE_OK);
    EQUAL(look_up(&w, now_of(&w), "r", "a", NULL, &l), LOOKUP_OK);
    CHECK(l.pose.x == 12);
    EQUAL(write_one(&wr, edge_at("a", "r", 3, 1)), STAGE_CYCLE);
    EQUAL(write_one(&wr, edge_at("a", "b", 1, 9)), STAGE_OK); /* late: the newest parent of b stays r */
    EQUAL(write_one(&wr, edge_at("a", "b", 3, 9)), STAGE_CYCLE);
    end();
}

/* A new frame takes the id of a removed parent: whoever hung below that is no ancestor of the new one. */
static void check_reused_parent(void) {
    lookup l;
    begin(3);
    NEED(write_one(&wr, edge_at("r", "x", 1, 1)) == STAGE_OK);
    NEED(write_one(&wr, edge_at("x", "c", 1, 1)) == STAGE_OK);
    uint32_t id = id_of(&w, "x");
    EQUAL(remove_named(&wr, "x"), STAGE_OK);
    EQUAL(write_one(&wr, edge_at("c", "y", 1, 4)), STAGE_OK);
    EQUAL(id_of(&w, "y"), id);
    EQUAL(look_up(&w, now_of(&w), "c", "y", NULL, &l), LOOKUP_OK);
    EQUAL(look_up(&w, now_of(&w), "r", "y", NULL, &l), LOOKUP_DISCONNECTED);
    EQUAL(write_one(&wr, edge_at("y", "c", 2, 4)), STAGE_CYCLE);
    end();
}

/* An id bound anew in the batch that also moves the orphan: the overlay is of the new life. */
static void check_reused_in_batch(void) {
    begin(3);
    NEED(write_one(&wr, edge_at("r", "x", 1, 1)) == STAGE_OK);
    NEED(write_one(&wr, edge_at("x", "c", 10, 1)) == STAGE_OK);
    EQUAL(remove_named(&wr, "x"), STAGE_OK);
    EQUAL(write_all(&wr, BATCH(edge_at("c", "y", 1, 4), edge_at("r", "c", 5, 1)), 2), STAGE_OK); /* c's newest parent is still x */
    EQUAL(write_one(&wr, edge_at("y", "r", 2, 4)), STAGE_OK);
    end();
}

static void check_births(void) {
    begin(8);
    shmtf_transform batch[3] = {edge_at("p", "a", 1, 1), edge_at("a", "b", 1, 1), edge_at("p", "c", 1, 1)};
    EQUAL(write_all(&wr, batch, 3), STAGE_OK);
    EQUAL(wr.version, 1);
    CHECK(batch[0].parent.frame.id == batch[2].parent.frame.id && batch[1].parent.frame.id == batch[0].child.frame.id);
    ring_record r;
    EQUAL(ring_latest(&w.s, batch[0].parent.frame.id, now_of(&w), &r), RING_OK);
    EQUAL(info_kind(r.info), KIND_ROOT);
    EQUAL(ring_latest(&w.s, batch[0].child.frame.id, commit_make(0, 0), &r), RING_NONE);
    uint64_t before = now_of(&w);
    EQUAL(write_all(&wr, batch, 3), STAGE_OK); /* the same again is nothing */
    EQUAL(now_of(&w), before);
    EQUAL(wr.x.repeats, 3);
    EQUAL(declare_named(&wr, "b", 4), STAGE_OK);
    EQUAL(declare_named(&wr, "b", 5), STAGE_DECLARED);
    EQUAL(now_of(&w), before);
    EQUAL(declare_named(&wr, "", 4), STAGE_BAD_NAME);
    EQUAL(remove_named(&wr, "none"), STAGE_GONE);
    end();
}

/* Handles in items go stale: found again by name, refused without one. */
static void check_handles(void) {
    begin(4);
    shmtf_transform t = edge_at("p", "a", 1, 1), u = edge_at("a", "b", 1, 1);
    EQUAL(write_all(&wr, &t, 1), STAGE_OK);
    EQUAL(write_all(&wr, &u, 1), STAGE_OK);
    shmtf_frame old = t.child.frame;
    EQUAL(remove_named(&wr, "a"), STAGE_OK);
    t.stamp_ns = u.stamp_ns = 2;
    shmtf_transform by_handle = t;
    by_handle.child = shmtf_by_handle(old);
    EQUAL(write_all(&wr, &by_handle, 1), STAGE_GONE);
    EQUAL(write_all(&wr, &u, 1), STAGE_OK); /* makes a parent "a" anew */
    EQUAL(write_all(&wr, &t, 1), STAGE_OK);
    CHECK(t.child.frame.gen != old.gen || t.child.frame.id != old.id);
    EQUAL(write_all(&wr, &by_handle, 1), STAGE_GONE);
    lookup l;
    EQUAL(look_up(&w, now_of(&w), "p", "b", NULL, &l), LOOKUP_OK);
    end();
}

/* What a refused batch has seen counts for nothing: a parent that ended stays ended. */
static void check_refused_parents(void) {
    begin(8);
    NEED(write_all(&wr, BATCH(edge_at("o", "c", 1000, 1), edge_at("r", "p", 1000, 1), edge_at("r", "z", 1000, 1)), 3) == STAGE_OK);
    shmtf_frame ended;
    NEED(find_frame(&w, now_of(&w), "o", &ended) == RING_OK);
    EQUAL(remove_named(&wr, "o"), STAGE_OK);
    shmtf_transform below = edge_at("o", "c", 1001, 1);
    below.parent = shmtf_by_handle(ended);
    EQUAL(write_all(&wr, &below, 1), STAGE_GONE);
    refused(BATCH(edge_at("p", "c", 1002, 1), edge_at("p", "c", 1003, 1), edge_at("r", "z", 1, 1)), 3, STAGE_OLD_DATA, 2);
    below.stamp_ns = 1004;
    EQUAL(write_all(&wr, &below, 1), STAGE_GONE);
    end();
}

/* Where an item has a handle, its name says nothing; and what a caller left in a reference without one does not either. */
static void check_handle_before_name(void) {
    lookup l;
    shmtf_frame c;
    begin(8);
    NEED(write_all(&wr, BATCH(edge_at("w", "b", 1, 1), edge_at("w", "c", 1, 10)), 2) == STAGE_OK);
    NEED(find_frame(&w, now_of(&w), "c", &c) == RING_OK);
    shmtf_transform batch[2] = {edge_at("w", "b", 2, 20), edge_at("b", "d", 2, 100)};
    batch[0].child.frame = c;
    batch[1].parent.frame = (shmtf_frame){UINT32_MAX, 0};
    EQUAL(write_all(&wr, batch, 2), STAGE_OK);
    EQUAL(look_up(&w, now_of(&w), "w", "d", NULL, &l), LOOKUP_OK);
    CHECK(l.pose.x == 101);
    EQUAL(look_up(&w, now_of(&w), "w", "c", NULL, &l), LOOKUP_OK);
    CHECK(l.pose.x == 20);
    for (uint32_t id = UINT32_MAX; id >= UINT32_MAX - 1; id--) {
        shmtf_transform one = edge_at("w", "e", 3, 5);
        one.parent.frame = (shmtf_frame){id, 0};
        EQUAL(write_all(&wr, &one, 1), STAGE_OK);
    }
    end();
}

static void check_kinds(void) {
    lookup l;
    int64_t t = 12345;
    begin(4);
    for (int i = 0; i < 40; i++) {
        EQUAL(write_one(&wr, static_edge("p", "a", i)), STAGE_OK);
        EQUAL(look_up(&w, now_of(&w), "p", "a", &t, &l), LOOKUP_OK);
        CHECK(l.pose.x == i && l.n_dynamic == 0);
        EQUAL(write_one(&wr, edge_at("p", "a", 500 - i, i + 0.5)), STAGE_OK); /* a new segment: its stamps start over */
        EQUAL(look_up(&w, now_of(&w), "p", "a", NULL, &l), LOOKUP_OK);
        CHECK(l.pose.x == i + 0.5 && l.oldest == 500 - i);
        EQUAL(look_up(&w, now_of(&w), "p", "a", &t, &l), LOOKUP_SINGLE);
    }
    end();
}

/* Several records of one frame in a batch: the newest counts, whichever way it was staged. */
static void check_several_records(void) {
    lookup l;
    begin(8);
    for (int i = 1; i <= 3; i++) NEED(write_one(&wr, edge_at("r", "a", i, 1)) == STAGE_OK);
    NEED(write_one(&wr, edge_at("r", "b", 1, 50)) == STAGE_OK);
    NEED(write_one(&wr, edge_at("r", "a", 4, 1)) == STAGE_OK);
    EQUAL(write_all(&wr, BATCH(edge_at("r", "a", 10, 2), edge_at("b", "a", 11, 3)), 2), STAGE_OK);
    EQUAL(look_up(&w, now_of(&w), "r", "a", NULL, &l), LOOKUP_OK);
    CHECK(l.pose.x == 53 && l.newest == 11);
    NEED(write_one(&wr, edge_at("b", "a", 12, 4)) == STAGE_OK);
    EQUAL(write_all(&wr, BATCH(edge_at("b", "a", 20, 5), edge_at("b", "a", 15, 6)), 2), STAGE_OK);
    EQUAL(look_up(&w, now_of(&w), "b", "a", NULL, &l), LOOKUP_OK);
    CHECK(l.pose.x == 5 && l.newest == 20);
    NEED(write_one(&wr, edge_at("b", "a", 21, 7)) == STAGE_OK); /* behind a late stamp */
    EQUAL(look_up(&w, now_of(&w), "b", "a", NULL, &l), LOOKUP_OK);
    CHECK(l.pose.x == 7 && l.newest == 21);
    end();
}

int main(void) {
    check_several_records();
    check_refusals();
    check_swaps();
    check_reused_parent();
    check_reused_in_batch();
    check_births();
    check_handles();
    check_refused_parents();
    check_handle_before_name();
    check_kinds();
    return check_result("stage");
}
