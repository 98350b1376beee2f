/* SPDX-License-Identifier: Apache-2.0
 * A writer dies right after its commit, having changed more frames than get their versions before it.  Who finishes one of
 * these frames is held up before each of its shared accesses in turn, while others finish the frame, too, and write it until its
 * ring has turned over.  What the late helper still does must do no harm: every commit keeps its answer.  Tier: test. */
#include <setjmp.h>

#include "core/recover.h"
#include "segment/failpoint.h"
#include "support/check.h"
#include "support/world.h"

enum { FRAMES = 70, MOST_BURST = 20, FIRST = 100 };
static world w;
static writer dead, other;
static unsigned char *image;
static char names[FRAMES][8];
static int hold_at = -1, burst;
static bool dies;
static jmp_buf death;
static long held;

static void commit_many(void) {
    held++;
    for (int i = 1; i <= burst; i++)
        if (write_one(&other, edge_at("p", names[0], FIRST + i, FIRST + i)) != STAGE_OK) abort();
}

#ifdef SHMTF_STEPS
void shmtf_step(int kind, const void *word) {
    (void)kind, (void)word;
    if (hold_at >= 0 && hold_at-- == 0) commit_many();
}
void shmtf_failpoint(const char *name) {
    if (dies && !strcmp(name, "half-unlocked")) longjmp(death, 1);
}
#endif

static stage_status write_frames(int64_t stamp) {
    shmtf_transform t[FRAMES];
    for (int i = 0; i < FRAMES; i++) t[i] = edge_at("p", names[i], stamp, (double)stamp);
    return write_all(&dead, t, FRAMES);
}

/* Commits 1 and 2 are whole; the writer of 3 dies before it unlocks anything. */
static void prepare(void) {
    world_make(&w, FRAMES + 8, 6, -1, 1 << 20, 4);
    writer_make(&dead, &w, 0);
    for (int i = 0; i < FRAMES; i++) snprintf(names[i], sizeof names[i], "f%d", i);
    for (int i = 1; i <= 2; i++) NEED(write_frames(FIRST - 3 + i) == STAGE_OK);
    dies = true;
    if (!setjmp(death)) write_frames(FIRST);
    dies = false;
    NEED(commit_version(now_of(&w)) == 3);
    image = malloc(w.s.geo.size_bytes);
    NEED(image);
    memcpy(image, w.memory, w.s.geo.size_bytes);
}

/* False: the last helper was through before it was held up. */
static bool again(int at) {
    bool was_held = hold_at < 0;
    hold_at = -1;
    if (at && !was_held) return false;
    memcpy(w.memory, image, w.s.geo.size_bytes);
    writer_free(&other);
    writer_make(&other, &w, 1);
    return true;
}

/* Commit v is of the record FIRST - 3 + v. */
static void check_every_commit(uint32_t id) {
    uint64_t now = commit_version(now_of(&w));
    ring_record r, all[2 * MOST_BURST];
    size_t n;
    for (uint64_t v = 1; v <= now; v++) {
        ring_status st = ring_latest(&w.s, id, v == now ? now_of(&w) : commit_make(0, v), &r);
        CHECK(st == RING_OK || (v < now && st == RING_OLD));
        if (st == RING_OK) CHECK(r.version == v && r.pose.x == (double)(FIRST - 3 + (int)v));
    }
    EQUAL(ring_list(&w.s, id, now_of(&w), all, 2 * MOST_BURST, &n), RING_OK);
    CHECK(n >= 1);
    for (size_t i = 0; i < n; i++) CHECK(all[i].version == now - i && all[i].pose.x == (double)(FIRST - 3 + (int)(now - i)));
}

int main(void) {
#ifndef SHMTF_STEPS
    (void)commit_many;
    printf("paused_helper: skipped, built without steps\n");
    return 0;
#endif
    prepare();
    uint32_t id = id_of(&w, names[0]);
    for (burst = 1; burst <= MOST_BURST; burst++)
        for (int at = 0; again(at); at++) {
            bool helped, recovered;
            uint64_t lock = atomic_load(&w.s.frames[id].lock);
            NEED(lock_owned(lock));
            hold_at = at;
            EQUAL(recover_resolve(&w.s, id, lock, &helped, &recovered), RESOLVED);
            int left = hold_at;
            hold_at = -1;
            if (left < 0) EQUAL(commit_version(now_of(&w)), 3 + burst);
            check_every_commit(id);
            hold_at = left;
        }
    writer_free(&dead);
    writer_free(&other);
    free(image);
    world_free(&w);
    printf("paused_helper: held up %ld times\n", held);
    CHECK(held > 0);
    return check_result("paused_helper");
}
