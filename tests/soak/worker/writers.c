/* SPDX-License-Identifier: Apache-2.0
 *
 * The writers of the long run.  A commit of which its writer was told is put on the board: from then on, everybody must
 * see it.
 */
#define _GNU_SOURCE
#include <stdlib.h>

#include "world.h"

static int64_t next_stamp(void) { return atomic_fetch_add(&board->stamp, 1); }

/* 1 of 16 does not wait, 1 of 32 has priority.  False: a frame was busy, which only the first may say. */
static bool put(member *m, shmtf_store *h, shmtf_transform *t, size_t n, uint64_t *version, shmtf_error *e) {
    const shmtf_write_options options = {.timeout_ns = chance(m, 16) ? -1 : 0, .priority = chance(m, 32) == 0};
    stopwatch w = watch_start();
    shmtf_status st = shmtf_set_transforms(h, t, n, &options, version, e);
    watch_write(&w);
    board_counters(h, &m->counted[h == m->second]);
    if (st == SHMTF_OK) {
        raise_word(&board->version[h == m->second], (long long)*version);
        return true;
    }
    if (options.timeout_ns || (st != SHMTF_BUSY && st != SHMTF_CONFLICT)) return false;
    e->status = SHMTF_BUSY;
    count_op(OP_BUSY);
    return false;
}

static bool must_put(member *m, shmtf_store *h, shmtf_transform *t, size_t n, uint64_t *version) {
    shmtf_error e;
    if (put(m, h, t, n, version, &e)) return true;
    if (e.status != SHMTF_BUSY) violation("a write was refused", &e);
    return false;
}

void write_singles(member *m) {
    while (!over()) {
        int i = (int)chance(m, SINGLES);
        uint64_t version;
        int64_t stamp = next_stamp(), late = chance(m, 8) ? 0 : (int64_t)chance(m, 400);
        stamp = stamp > late + 2 ? stamp - late : stamp;
        shmtf_transform t = {shmtf_by_name("root"), shmtf_by_name(single_name[i]), stamp, single_pose(i, stamp), 0};
        uint64_t repeats = m->counted[0].repeats;
        if (!must_put(m, m->main, &t, 1, &version)) continue;
        raise_word(&board->single_stamp[i], stamp);
        /* what was there already, or is older than all that is kept, is no change */
        if (!late && repeats == m->counted[0].repeats) raise_word(&board->single_version[i], (long long)version);
        count_op(late ? OP_LATE : OP_SINGLE);
    }
}

void write_batches(member *m) {
    shmtf_transform t[2 * GROUP];
    uint64_t version;
    while (!over()) {
        int64_t stamp = next_stamp();
        if (chance(m, 8) == 0) stamp -= (int64_t)chance(m, 50);
        bool chain = chance(m, 2);
        if (chain) fill_chain(t, stamp);
        else fill_groups(t, stamp);
        if (!must_put(m, m->main, t, chain ? CHAIN : 2 * GROUP, &version)) continue;
        if (chain) raise_word(&board->chain_stamp, stamp);
        count_op(chain ? OP_CHAIN : OP_GROUPS);
    }
}

void write_big(member *m) {
    shmtf_transform *t = calloc(BIG, sizeof *t);
    uint64_t version;
    if (!t) violation("no memory", NULL);
    while (!over()) {
        int64_t stamp = next_stamp();
        fill_big(t, stamp);
        if (!must_put(m, m->main, t, BIG, &version)) continue;
        raise_word(&board->big_stamp, stamp);
        count_op(OP_BIG);
    }
    free(t);
}

static const shmtf_write_options wait_long = {.timeout_ns = -1};

/* Births, removals, and lives of other sizes: names and ids are used again. */
static void come_and_go(member *m) {
    uint64_t version;
    shmtf_error e;
    bool declared = chance(m, 4) == 0;
    const char *name = declared ? declared_name[chance(m, DECLARED)] : guest_name[chance(m, GUESTS)];
    int64_t stamp = next_stamp();
    if (chance(m, 2)) {
        shmtf_status st = shmtf_remove_frame(m->main, shmtf_by_name(name), &wait_long, &e);
        if (st && st != SHMTF_LOOKUP) violation("a removal", &e);
        if (!st) count_op(OP_REMOVE);
        return;
    }
    if (declared) {
        shmtf_status st = shmtf_declare_frame(m->main, name, (uint32_t)(10u << chance(m, 5)), &wait_long, &e);
        if (st && st != SHMTF_INVALID_ARGUMENT && st != SHMTF_FULL) violation("a declaration", &e);
        if (!st) count_op(OP_DECLARE);
    }
    const char *parent = chance(m, 4) ? "root" : guest_name[chance(m, GUESTS)];
    shmtf_transform t = {shmtf_by_name(parent), shmtf_by_name(name), stamp, {place_of(stamp), (double)stamp, 0, 0, 0, 0, 1}, 0};
    if (chance(m, 2)) t.flags = SHMTF_STATIC;
    if (put(m, m->main, &t, 1, &version, &e)) count_op(OP_BIRTH);
    else if (e.status == SHMTF_CYCLE) count_op(OP_CYCLE);
    else if (e.status != SHMTF_BUSY && e.status != SHMTF_FULL && e.status != SHMTF_INVALID_ARGUMENT) violation("a birth", &e);
}

/* Below another knot or the root: refused where it would make a circle. */
static void hang_knot(member *m) {
    uint64_t version, i = chance(m, KNOTS), below = chance(m, KNOTS + 1);
    shmtf_error e;
    const char *parent = below == KNOTS || below == i ? "root" : knot_name[below];
    shmtf_transform t = {shmtf_by_name(parent), shmtf_by_name(knot_name[i]), next_stamp(), {0, 0, 0, 0, 0, 0, 1}, 0};
    if (put(m, m->main, &t, 1, &version, &e)) count_op(OP_REPARENT);
    else if (e.status == SHMTF_CYCLE) count_op(OP_CYCLE);
    else if (e.status != SHMTF_BUSY) violation("a new parent", &e);
}

void change_shape(member *m) {
    uint64_t version;
    while (!over()) {
        int64_t stamp = next_stamp();
        uint64_t what = chance(m, 8);
        if (what < 3) {
            come_and_go(m);
        } else if (what < 5) {
            hang_knot(m);
        } else if (what < 7) {
            shmtf_transform t = arm_edge((int)chance(m, ARMS), chance(m, 2), stamp);
            if (must_put(m, m->main, &t, 1, &version)) count_op(OP_REPARENT);
        } else {
            const char *name = flip_name[chance(m, FLIPS)];
            shmtf_transform t = {shmtf_by_name("root"), shmtf_by_name(name), stamp, {place_of(stamp), (double)stamp, 0, 0, 0, 0, 1}, 0};
            if (chance(m, 2)) t.flags = SHMTF_STATIC;
            if (must_put(m, m->main, &t, 1, &version)) count_op(OP_FLIP);
        }
    }
}

void clear_second(member *m) {
    shmtf_transform t[2 * GROUP];
    uint64_t version;
    shmtf_error e;
    while (!over()) {
        if (chance(m, 8) == 0) {
            if (shmtf_clear(m->second, (int)chance(m, 2), &wait_long, &e)) violation("a clear", &e);
            count_op(OP_CLEAR);
            continue;
        }
        fill_groups(t, next_stamp());
        if (must_put(m, m->second, t, 2 * GROUP, &version)) count_op(OP_GROUPS);
    }
}
