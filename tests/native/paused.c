/* SPDX-License-Identifier: Apache-2.0
 * A reader is held up before each of its shared accesses in turn, while others commit: once, twice, and until its ring has
 * turned over, in order, late, or as static records.  Whatever it then says is about the commit it was asked for, or that
 * this commit is too old to tell.  The answers are compared with a plain sorted list.  Tier: test. */
#include "core/lookup.h"

#include "segment/failpoint.h"
#include "support/check.h"
#include "support/world.h"

enum { MOST = 32, TICK = 10 };
typedef enum { IN_ORDER, LATE, STATIC_AND_BACK, KINDS } burst_kind;

typedef struct {
    int n, live;
    int64_t stamp[MOST];
    double value[MOST];
} list;

static world w;
static writer other;
static unsigned char *image;
static list at_version[MOST];
static int hold_at = -1; /* steps until the reader is held up; negative: never */
static int burst;
static burst_kind kind;
static int64_t now_stamp;
static long held, too_old;

static void commit_many(void);

#ifdef SHMTF_STEPS
void shmtf_step(int of, const void *word) {
    (void)of, (void)word;
    if (hold_at >= 0 && hold_at-- == 0) commit_many();
}
void shmtf_failpoint(const char *name) { (void)name; }
#endif

static void commit_many(void) {
    held++;
    for (int i = 0; i < burst; i++) {
        shmtf_transform t = edge_at("p", "f", now_stamp + (i + 1) * TICK, 1000 + i);
        if (kind == LATE) t.stamp_ns = now_stamp - 1 - i % 4 * TICK;
        if (kind == STATIC_AND_BACK && i % 3 == 1) t.flags = SHMTF_STATIC;
        if (write_one(&other, t) != STAGE_OK) abort();
    }
}

/* The list after one more record. */
static list with(list l, int64_t stamp, double value) {
    int at = l.n++;
    for (; at > 0 && l.stamp[at - 1] > stamp; at--) {
        l.stamp[at] = l.stamp[at - 1];
        l.value[at] = l.value[at - 1];
    }
    l.stamp[at] = stamp;
    l.value[at] = value;
    for (; l.n > l.live; l.n--)
        for (int i = 1; i < l.n; i++) l.stamp[i - 1] = l.stamp[i], l.value[i - 1] = l.value[i];
    return l;
}

/* A frame whose ring holds `records` records, every third of them late; at_version says what each commit had. */
static void prepare(int records) {
    writer wr;
    world_make(&w, 8, 6, -1, 0, 4);
    writer_make(&wr, &w, 0);
    at_version[0] = (list){.live = (int)shmtf_ring_live(w.s.geo.default_log2)};
    for (int i = 1; i <= records; i++) {
        int64_t stamp = i * TICK - (i % 3 == 0 ? 2 * TICK + 1 : 0);
        NEED(write_one(&wr, edge_at("p", "f", stamp, i)) == STAGE_OK);
        NEED(commit_version(now_of(&w)) == (uint64_t)i);
        at_version[i] = with(at_version[i - 1], stamp, i);
    }
    now_stamp = records * TICK;
    image = malloc(w.s.geo.size_bytes);
    NEED(image);
    memcpy(image, w.memory, w.s.geo.size_bytes);
    writer_free(&wr);
}

/* The segment and the other process's memory as they were; false: the last read ended before it was held up. */
static bool again(int at) {
    bool was_held = hold_at < 0;
    hold_at = -1;
    if (at && !was_held) return false;
    memcpy(w.memory, image, w.s.geo.size_bytes);
    memset(w.depth, 0, (w.s.geo.max_frames + 1) * sizeof *w.depth);
    memset(w.above, 0, (w.s.geo.max_frames + 1) * sizeof *w.above);
    writer_free(&other);
    writer_make(&other, &w, 1);
    hold_at = at;
    return true;
}

static bool answered(ring_status st, const list *want) {
    if (st == RING_OLD || st == RING_AGAIN) return too_old++, false;
    EQUAL(st, want->n ? RING_OK : RING_NONE);
    return st == RING_OK && want->n;
}

static void check_latest(uint32_t id, uint64_t snapshot, const list *want) {
    for (int at = 0; again(at); at++) {
        ring_record r;
        if (answered(ring_latest(&w.s, id, snapshot, &r), want)) CHECK(r.stamp == want->stamp[want->n - 1] && r.pose.x == want->value[want->n - 1]);
    }
}

static void check_around(uint32_t id, uint64_t snapshot, const list *want, int64_t t) {
    for (int at = 0; again(at); at++) {
        ring_around_result a;
        if (!answered(ring_around(&w.s, id, snapshot, t, &a), want)) continue;
        int before = want->n - 1;
        while (before >= 0 && want->stamp[before] > t) before--;
        EQUAL(a.has_before, before >= 0);
        if (before >= 0 && a.has_before) CHECK(a.before.pose.x == want->value[before]);
        if (a.has_after) CHECK(before + 1 < want->n && a.after.pose.x == want->value[before + 1]);
        if (before < 0 || t > want->stamp[want->n - 1]) EQUAL(a.alone, want->n == 1);
    }
}

/* The fast part of the walk included. */
static void check_lookup(uint64_t snapshot, const list *want, const int64_t *t) {
    shmtf_frame p, f;
    again(0);
    hold_at = -1;
    NEED(find_frame(&w, now_of(&w), "p", &p) == RING_OK && find_frame(&w, now_of(&w), "f", &f) == RING_OK);
    for (int at = 0; again(at); at++) {
        lookup l = {.s = &w.s, .depth = w.depth, .above = w.above, .snapshot = snapshot, .at_time = t != NULL, .time = t ? *t : 0,
                    .target = p, .source = f};
        lookup_status st = lookup_run(&l);
        if (st == LOOKUP_OLD) {
            too_old++;
            continue;
        }
        EQUAL(st, LOOKUP_OK);
        int which = want->n - 1;
        while (t && want->stamp[which] > *t) which--;
        CHECK(l.pose.x == want->value[which]); /* t is a stamp */
    }
}

static void check_list(uint32_t id, uint64_t snapshot, const list *want) {
    for (int at = 0; again(at); at++) {
        ring_record out[MOST];
        size_t n;
        if (!answered(ring_list(&w.s, id, snapshot, out, MOST, &n), want)) continue;
        CHECK(n > 0 && n <= (size_t)want->n); /* what was overwritten is not listed */
        for (size_t i = 0; i < n && i < (size_t)want->n; i++) CHECK(out[i].pose.x == want->value[want->n - 1 - (int)i]);
    }
}

static void check_commit(uint32_t id, int version) {
    const list *want = &at_version[version];
    uint64_t snapshot = version == (int)commit_version(now_of(&w)) ? now_of(&w) : commit_make(0, (uint64_t)version);
    check_latest(id, snapshot, want);
    check_list(id, snapshot, want);
    if (!want->n) return;
    check_lookup(snapshot, want, NULL);
    check_around(id, snapshot, want, want->stamp[0] - 1);
    check_around(id, snapshot, want, want->stamp[want->n - 1] + 1);
    for (int i = 0; i < want->n; i += 2) {
        check_around(id, snapshot, want, want->stamp[i] + 1);
        check_lookup(snapshot, want, &want->stamp[i]);
    }
}

int main(void) {
#ifndef SHMTF_STEPS
    (void)commit_many;
    printf("paused: skipped, built without steps\n");
    return 0;
#endif
    static const int bursts[] = {1, 2, 3, 6, 9, 20};
    for (int records = 1; records <= 11; records += 2) {
        prepare(records);
        uint32_t id = id_of(&w, "f");
        for (size_t b = 0; b < sizeof bursts / sizeof *bursts; b++)
            for (kind = IN_ORDER; kind < KINDS; kind++) {
                burst = bursts[b];
                for (int version = records > 4 ? records - 4 : 0; version <= records; version++) check_commit(id, version);
            }
        free(image);
        writer_free(&other);
        memset(&other, 0, sizeof other);
        world_free(&w);
    }
    printf("paused: held up %ld times, %ld answers too old\n", held, too_old);
    CHECK(held && too_old < held);
    return check_result("paused");
}
