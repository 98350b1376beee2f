/* SPDX-License-Identifier: Apache-2.0
 *
 * What is done to the store of the trials: every kind of write, and every way to take over from a dead writer.
 */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "prove.h"

enum { ARRIVAL = 1000000, MOST = 1100 };

/* Where lookups ask: before the last late stamp, at it, between records, at the newest stamp of an operation. */
const int64_t view_times[N_TIMES] = {250, 350, 560, 600};

static const shmtf_write_options waits = {.timeout_ns = -1, .arrival_ns = ARRIVAL};

const char *parent_name_of(const char *frame) {
    if (!strcmp(frame, "d")) return "a";
    return !strcmp(frame, "e") ? "d" : "root";
}

static shmtf_transform edge(const char *parent, const char *child, int64_t stamp, unsigned flags) {
    shmtf_transform t = {shmtf_by_name(parent), shmtf_by_name(child), stamp, {0, 0, 0, 0, 0, 0, 1}, flags};
    double h = 0.0005 * (double)stamp + 0.001 * child[0], norm = 1 + h * h; /* half an angle's tangent: no call into libm */
    t.pose = (shmtf_pose){.x = (double)stamp, .y = child[0], .z = child[1], .qz = 2 * h / norm, .qw = (1 - h * h) / norm};
    return t;
}
static shmtf_transform usual(const char *child, int64_t stamp) { return edge(parent_name_of(child), child, stamp, 0); }

static shmtf_status set(shmtf_store *h, shmtf_transform *t, size_t n, shmtf_error *e) {
    return shmtf_set_transforms(h, t, n, &waits, NULL, e);
}

/* u000 .. at a stamp, behind `n` transforms that are there already. */
static size_t add_extra(shmtf_transform *t, size_t n, char name[][16], uint32_t extra, int64_t stamp) {
    for (uint32_t i = 0; i < extra; i++) t[n++] = usual(world_name(CORE_FRAMES + UNBORN_FRAMES + i, name[i]), stamp);
    return n;
}

shmtf_status write_nothing(shmtf_store *h, shmtf_error *e) { return set(h, NULL, 0, e); }

shmtf_status write_base(shmtf_store *h, uint32_t extra, shmtf_error *e) {
    static shmtf_transform t[MOST];
    static char name[MOST][16];
    shmtf_transform fixed[2] = {edge("root", "s", 0, SHMTF_STATIC), edge("root", "other", 0, SHMTF_STATIC)};
    shmtf_status st = set(h, fixed, 2, e);
    for (int64_t stamp = 100; st == SHMTF_OK && stamp <= 500; stamp += 100) {
        size_t n = 0;
        for (int i = 0; i < 5; i++) t[n++] = usual((const char *const[]){"a", "b", "c", "d", "e"}[i], stamp);
        st = set(h, t, add_extra(t, n, name, extra, stamp), e);
    }
    t[0] = usual("c", 150); /* late: c has an order index from now on */
    return st == SHMTF_OK ? set(h, t, 1, e) : st;
}

shmtf_status write_again(shmtf_store *h, uint32_t extra, shmtf_error *e) {
    static const char *const core[] = {"a", "b", "c", "d"};
    static char name[MOST][16];
    static shmtf_transform t[MOST];
    size_t n = 0;
    for (int i = 0; i < 4; i++) t[n++] = usual(core[i], 700);
    return set(h, t, add_extra(t, n, name, extra > 100 ? 16 : extra, 700), e);
}

shmtf_status write_probe(shmtf_store *h, uint32_t extra, int64_t stamp, shmtf_error *e) {
    static char name[MOST][16];
    static shmtf_transform t[MOST];
    shmtf_info info;
    size_t n = 0, exist;
    char filler[8][8];
    for (uint32_t i = 1; i < CORE_FRAMES; i++) t[n++] = usual(world_name(i, name[0]), stamp);
    shmtf_status st = set(h, t, add_extra(t, n, name, extra, stamp), e);
    if (st == SHMTF_OK) st = shmtf_get_info(h, &info, e);
    if (st == SHMTF_OK) st = shmtf_frames(h, NULL, NULL, 0, &exist, e);
    if (st != SHMTF_OK) return st;
    for (n = 0; exist + n < info.config.max_frames && n < 8; n++) { /* no frame and no ring was lost */
        snprintf(filler[n], sizeof filler[n], "z%u", (unsigned)n);
        t[n] = usual(filler[n], stamp);
    }
    return set(h, t, n, e);
}

shmtf_status write_frame(shmtf_store *h, const char *name, int64_t stamp, shmtf_error *e) {
    const shmtf_write_options at_once = {.timeout_ns = 0, .arrival_ns = ARRIVAL};
    shmtf_transform t = usual(name, stamp);
    if (!strcmp(name, "other")) t.flags = SHMTF_STATIC;
    return shmtf_set_transforms(h, &t, 1, &at_once, NULL, e);
}

/* ---- the operations ------------------------------------------------------------------------------------------- */

static shmtf_status run_one(shmtf_store *h, shmtf_error *e) { return set(h, (shmtf_transform[]){usual("a", 600)}, 1, e); }

static shmtf_status run_three(shmtf_store *h, shmtf_error *e) {
    return set(h, (shmtf_transform[]){usual("a", 600), usual("b", 350), usual("c", 600)}, 3, e);
}

static shmtf_status run_extra(shmtf_store *h, uint32_t n, shmtf_error *e) {
    static char name[MOST][16];
    static shmtf_transform t[MOST];
    return set(h, t, add_extra(t, 0, name, n, 600), e);
}
static shmtf_status run_16(shmtf_store *h, shmtf_error *e) { return run_extra(h, 16, e); }
static shmtf_status run_64(shmtf_store *h, shmtf_error *e) { return run_extra(h, 64, e); }
static shmtf_status run_80(shmtf_store *h, shmtf_error *e) { return run_extra(h, 80, e); }
static shmtf_status run_1000(shmtf_store *h, shmtf_error *e) { return run_extra(h, 1000, e); }

static shmtf_status run_late(shmtf_store *h, shmtf_error *e) { return set(h, (shmtf_transform[]){usual("b", 350)}, 1, e); }
static shmtf_status run_later(shmtf_store *h, shmtf_error *e) { return set(h, (shmtf_transform[]){usual("c", 350)}, 1, e); }

static shmtf_status run_birth(shmtf_store *h, shmtf_error *e) { return set(h, (shmtf_transform[]){edge("m", "n", 600, 0)}, 1, e); }

static shmtf_status run_reparent(shmtf_store *h, shmtf_error *e) { return set(h, (shmtf_transform[]){edge("b", "d", 600, 0)}, 1, e); }

static shmtf_status run_remove(shmtf_store *h, shmtf_error *e) { return shmtf_remove_frame(h, shmtf_by_name("a"), &waits, e); }

static shmtf_status run_clear(shmtf_store *h, shmtf_error *e) { return shmtf_clear(h, 1, &waits, e); }
static shmtf_status run_clear_all(shmtf_store *h, shmtf_error *e) { return shmtf_clear(h, 0, &waits, e); }

static shmtf_status run_static(shmtf_store *h, shmtf_error *e) {
    return set(h, (shmtf_transform[]){edge("root", "a", 0, SHMTF_STATIC), edge("root", "c", 0, SHMTF_STATIC)}, 2, e);
}
static shmtf_status run_dynamic(shmtf_store *h, shmtf_error *e) { return set(h, (shmtf_transform[]){edge("root", "s", 600, 0)}, 1, e); }

static shmtf_status run_mixture(shmtf_store *h, shmtf_error *e) {
    shmtf_transform t[] = {usual("a", 600), usual("b", 350), edge("m", "n", 600, 0), edge("root", "x", 0, SHMTF_STATIC), edge("b", "d", 600, 0)};
    return set(h, t, sizeof t / sizeof *t, e);
}

static shmtf_status run_declare(shmtf_store *h, shmtf_error *e) { return shmtf_declare_frame(h, "dd", 40, &waits, e); }

static shmtf_status run_wait(shmtf_store *h, shmtf_error *e) {
    const shmtf_ref frames[2] = {shmtf_by_name("a"), shmtf_by_name("b")};
    uint64_t seen;
    shmtf_status st = shmtf_wait_for_change(h, frames, 2, shmtf_commit_version(h), 90000000, &seen, e);
    return st == SHMTF_TIMEOUT ? SHMTF_OK : st;
}

static shmtf_status run_again(shmtf_store *h, shmtf_error *e) { return write_again(h, 0, e); }


const operation operations[] = {
    {.name = "one", .what = "a single frame", .run = run_one, .frames = {"a"}, .leaves_records = true},
    {.name = "one-woken", .what = "a single frame somebody waits for", .run = run_one, .frames = {"a"}, .leaves_records = true, .wakes = true},
    {.name = "three", .what = "three frames, one late", .run = run_three, .frames = {"a", "b", "c"}, .leaves_records = true},
    {.name = "sixteen", .what = "16 frames", .extra = 16, .run = run_16, .frames = {"u000", "u007", "u015"}, .leaves_records = true},
    {.name = "64", .what = "64 frames", .extra = 64, .run = run_64, .frames = {"u000", "u031", "u063"}, .leaves_records = true},
    {.name = "80", .what = "80 frames: tags after the commit", .extra = 80, .run = run_80, .frames = {"u000", "u040", "u079"}, .leaves_records = true},
    {.name = "thousand", .what = "1,000 frames", .extra = 1000, .run = run_1000, .frames = {"u000", "u500", "u999"}, .leaves_records = true},
    {.name = "late", .what = "the first late stamp of a frame", .run = run_late, .frames = {"b"}, .leaves_records = true},
    {.name = "late-again", .what = "another late stamp", .run = run_later, .frames = {"c"}, .leaves_records = true},
    {.name = "birth", .what = "a new frame and its new parent", .run = run_birth, .frames = {"a"}},
    {.name = "reparent", .what = "a frame gets another parent", .run = run_reparent, .frames = {"d"}},
    {.name = "remove", .what = "remove a frame with a child", .run = run_remove, .frames = {"a"}},
    {.name = "clear", .what = "clear all but static records", .run = run_clear, .frames = {"a"}},
    {.name = "clear-all", .what = "clear everything", .run = run_clear_all, .frames = {"a"}},
    {.name = "static", .what = "two dynamic frames become static", .run = run_static, .frames = {"a", "c"}},
    {.name = "dynamic", .what = "a static frame becomes dynamic", .run = run_dynamic, .frames = {"s"}},
    {.name = "mixture", .what = "all kinds in one transaction", .run = run_mixture, .frames = {"a", "b", "d"}, .wakes = true},
    {.name = "declare", .what = "a new frame with a ring of its own", .run = run_declare, .frames = {"a"}},
    {.name = "claim", .what = "attach, claim a slot, intern a name", .run = write_nothing, .frames = {"a"}, .cold = true},
    {.name = "wait", .what = "announce a wait", .run = run_wait, .frames = {"a"}},
    {.name = "adopt-undecided", .what = "adopt: died with locks", .run = run_again, .frames = {"a", "b"}, .cold = true,
     .first = "three", .died = DIED_UNDECIDED},
    {.name = "adopt-prepared", .what = "adopt: died before the commit", .run = run_again, .frames = {"a", "b"}, .cold = true,
     .first = "mixture", .died = DIED_PREPARED},
    {.name = "adopt-committed", .what = "adopt: died after the commit", .run = run_again, .frames = {"a", "b"}, .cold = true,
     .first = "mixture", .died = DIED_COMMITTED},
    {.name = "adopt-unlocking", .what = "adopt: died while unlocking", .run = run_again, .frames = {"a", "b"}, .cold = true,
     .first = "three", .died = DIED_HALF_UNLOCKED},
    {.name = "meet-undecided", .what = "undo: died with locks", .run = run_again, .frames = {"a", "b"}, .first = "three",
     .died = DIED_UNDECIDED, .meets = true},
    {.name = "meet-prepared", .what = "undo: died before the commit", .run = run_again, .frames = {"a", "b"}, .first = "mixture",
     .died = DIED_PREPARED, .meets = true},
    {.name = "meet-committed", .what = "help: died after the commit", .run = run_again, .frames = {"a", "b"}, .first = "mixture",
     .died = DIED_COMMITTED, .meets = true},
    {.name = "meet-unlocking", .what = "help: died while unlocking", .run = run_again, .frames = {"a", "b"}, .first = "three",
     .died = DIED_HALF_UNLOCKED, .meets = true},
};
const unsigned n_operations = sizeof operations / sizeof *operations;

const operation *operation_named(const char *name) {
    for (unsigned i = 0; i < n_operations; i++)
        if (!strcmp(operations[i].name, name)) return &operations[i];
    return NULL;
}
