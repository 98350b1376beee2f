/* SPDX-License-Identifier: Apache-2.0
 *
 * The world of the long run: which frames there are, and what a value must be, given its frame and stamp.  So a reader
 * needs no memory of what was written to know that an answer is right.
 *
 *   g0..47    singles: x = (i + 1) t, y = t, turning evenly: at every time, between records too
 *   c0..16    a chain, always written as a whole: every edge x = t
 *   b0..999   always written as a whole: x = t, y = i
 *   e0..7     always written as a whole: all x equal;  s0..7  the same: the x sum to 0
 *   r0..3     hang below "left" (x = 1000) or "right" (x = -1000), and are at the same place seen from the root
 *   k0..3     hang below each other or the root, as it comes: never in a circle
 *   f0..3     static and dynamic in turns;  d0..3, n0..63  come and go
 *
 * The second store has the e and s alone, and is cleared now and then: all of a group are there, or none.
 */
#ifndef SHMTF_SOAK_WORLD_H
#define SHMTF_SOAK_WORLD_H

#include "board.h"

enum { CHAIN = 16, BIG = 1000, GROUP = 8, ARMS = 4, KNOTS = 4, FLIPS = 4, DECLARED = 4, GUESTS = 64, MOST_FRAMES = 1160, PLACE = 1000 };

extern char single_name[SINGLES][8], chain_name[CHAIN + 1][8], big_name[BIG][8], equal_name[GROUP][8], sum_name[GROUP][8];
extern char arm_name[ARMS][8], knot_name[KNOTS][8], flip_name[FLIPS][8], declared_name[DECLARED][8], guest_name[GUESTS][8];

typedef struct {
    shmtf_store *main, *second;
    uint64_t random;
    shmtf_counters counted[2];
} member;

void world_names(void);
/* Everything at stamp 1.  The stores are empty. */
void world_build(member *m);

static inline uint64_t chance(member *m, uint64_t n) {
    m->random ^= m->random << 13;
    m->random ^= m->random >> 7;
    m->random ^= m->random << 17;
    return m->random % n;
}

shmtf_pose single_pose(int i, int64_t t);
/* Near enough, with what interpolation and composition cost. */
bool same_pose(const shmtf_pose *a, const shmtf_pose *b);
void fill_chain(shmtf_transform t[CHAIN], int64_t stamp);
void fill_groups(shmtf_transform t[2 * GROUP], int64_t stamp);
void fill_big(shmtf_transform t[BIG], int64_t stamp);
shmtf_transform arm_edge(int i, bool right, int64_t stamp);
static inline double place_of(int64_t t) { return (double)(t % 100003); }

/* What a member does until the run is over. */
void write_singles(member *m);
void write_batches(member *m);
void write_big(member *m);
void change_shape(member *m);
void clear_second(member *m);
void read_everything(member *m);
void read_second(member *m);
void wait_for_singles(member *m);

#endif
