/* SPDX-License-Identifier: Apache-2.0 */
#define _GNU_SOURCE
#include "world.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>

char single_name[SINGLES][8], chain_name[CHAIN + 1][8], big_name[BIG][8], equal_name[GROUP][8], sum_name[GROUP][8];
char arm_name[ARMS][8], knot_name[KNOTS][8], flip_name[FLIPS][8], declared_name[DECLARED][8], guest_name[GUESTS][8];

static void number(char names[][8], int n, char letter) {
    for (int i = 0; i < n; i++) snprintf(names[i], 8, "%c%d", letter, i % 1000);
}

void world_names(void) {
    number(single_name, SINGLES, 'g');
    number(chain_name, CHAIN + 1, 'c');
    number(big_name, BIG, 'b');
    number(equal_name, GROUP, 'e');
    number(sum_name, GROUP, 's');
    number(arm_name, ARMS, 'r');
    number(knot_name, KNOTS, 'k');
    number(flip_name, FLIPS, 'f');
    number(declared_name, DECLARED, 'd');
    number(guest_name, GUESTS, 'n');
}

static shmtf_transform at(const char *parent, const char *child, int64_t stamp, double x, double y) {
    return (shmtf_transform){shmtf_by_name(parent), shmtf_by_name(child), stamp, {x, y, 0, 0, 0, 0, 1}, 0};
}

shmtf_pose single_pose(int i, int64_t t) {
    double half = 0.5e-6 * (double)(i % 3) * (double)t, c = cos(half), s = sin(half), sign = c < 0 ? -1 : 1;
    return (shmtf_pose){(double)(i + 1) * (double)t, (double)t, 0, 0, 0, s * sign, c * sign};
}

bool same_pose(const shmtf_pose *a, const shmtf_pose *b) {
    double scale = 1e-9 * (1 + fabs(b->x) + fabs(b->y));
    double dot = a->qx * b->qx + a->qy * b->qy + a->qz * b->qz + a->qw * b->qw; /* of two opposite ones, which are the same: -1 */
    return fabs(a->x - b->x) <= scale && fabs(a->y - b->y) <= scale && fabs(a->z - b->z) <= scale && fabs(fabs(dot) - 1) <= 1e-9;
}

void fill_chain(shmtf_transform t[CHAIN], int64_t stamp) {
    for (int i = 0; i < CHAIN; i++) t[i] = at(chain_name[i], chain_name[i + 1], stamp, (double)stamp, 0);
}

void fill_groups(shmtf_transform t[2 * GROUP], int64_t stamp) {
    double sum = 0;
    for (int i = 0; i < GROUP; i++) {
        double x = i + 1 < GROUP ? (double)(stamp * (i + 3) % 2003 - 1001) : -sum;
        sum += x;
        t[i] = at("root", equal_name[i], stamp, place_of(stamp), 0);
        t[GROUP + i] = at("root", sum_name[i], stamp, x, 0);
    }
}

void fill_big(shmtf_transform t[BIG], int64_t stamp) {
    for (int i = 0; i < BIG; i++) t[i] = at("root", big_name[i], stamp, (double)stamp, (double)i);
}

shmtf_transform arm_edge(int i, bool right, int64_t stamp) {
    return at(right ? "right" : "left", arm_name[i], stamp, place_of(stamp) + (right ? PLACE : -PLACE), (double)stamp);
}

static void set(shmtf_store *h, shmtf_transform *t, size_t n) {
    shmtf_error e;
    if (shmtf_set_transforms(h, t, n, NULL, NULL, &e)) violation("building the world", &e);
}

void world_build(member *m) {
    shmtf_transform *big = calloc(BIG, sizeof *big), t[SINGLES];
    shmtf_transform places[2] = {at("root", "left", 0, PLACE, 0), at("root", "right", 0, -PLACE, 0)};
    if (!big) violation("no memory", NULL);
    atomic_store(&board->stamp, 100);
    places[0].flags = places[1].flags = SHMTF_STATIC;
    set(m->main, places, 2);
    fill_groups(t, 1);
    set(m->main, t, 2 * GROUP);
    set(m->second, t, 2 * GROUP);
    fill_chain(t, 1);
    set(m->main, t, CHAIN);
    for (int i = 0; i < SINGLES; i++) {
        t[i] = at("root", single_name[i], 1, 0, 0);
        t[i].pose = single_pose(i, 1);
    }
    set(m->main, t, SINGLES);
    for (int i = 0; i < ARMS; i++) t[i] = arm_edge(i, false, 1);
    set(m->main, t, ARMS);
    for (int i = 0; i < KNOTS; i++) t[i] = at("root", knot_name[i], 1, 0, 0);
    set(m->main, t, KNOTS);
    for (int i = 0; i < FLIPS; i++) t[i] = at("root", flip_name[i], 1, place_of(1), 1);
    set(m->main, t, FLIPS);
    fill_big(big, 1);
    set(m->main, big, BIG);
    free(big);
}
