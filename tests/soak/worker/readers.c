/* SPDX-License-Identifier: Apache-2.0
 *
 * The readers of the long run.  Every answer is checked: is it of one commit, is it what was written, is it not older than
 * what its writer had been told, and does nothing go back?
 */
#define _GNU_SOURCE
#include <stdlib.h>

#include "world.h"

static int64_t seen_stamp[SINGLES], seen_chain, seen_big;
static uint64_t seen_version[2];

static long long most(word *a, word *b) {
    long long x = atomic_load(a), y = atomic_load(b);
    return x > y ? x : y;
}

static void check_version(int store, uint64_t version, long long acknowledged) {
    if (version < seen_version[store]) violation_numbers("the version went back", (long long)seen_version[store], (long long)version);
    if ((long long)version < acknowledged)
        violation_numbers("a commit that was acknowledged is not seen", acknowledged, (long long)version);
    seen_version[store] = version;
}

static shmtf_status latest(shmtf_store *h, const shmtf_snapshot *s, const char *target, const char *source, shmtf_result *r) {
    shmtf_error e;
    stopwatch w = watch_start();
    shmtf_status st = shmtf_lookup_latest_transform(h, s, shmtf_by_name(target), shmtf_by_name(source), 0, r, &e);
    watch_read(&w);
    if (st && !(s && st == SHMTF_SNAPSHOT_EXPIRED)) violation("latest", &e);
    return st;
}

static void check_stamp(const char *what, int64_t *seen, int64_t stamp, long long acknowledged) {
    if (stamp < *seen) violation_numbers(what, *seen, stamp);
    if (stamp < acknowledged) violation_numbers("an acknowledged value is not seen", acknowledged, stamp);
    *seen = stamp;
}

static void read_single(member *m) {
    int i = (int)chance(m, SINGLES);
    long long stamp = most(&board->single_stamp[i], &board->py_stamp[i]), version = atomic_load(&board->version[0]);
    shmtf_result r = {.edges = NULL};
    latest(m->main, NULL, "root", single_name[i], &r);
    check_version(0, r.version, version);
    check_stamp("a single's newest stamp went back", &seen_stamp[i], r.stamp_ns, stamp);
    shmtf_pose right = single_pose(i, r.stamp_ns);
    if (!same_pose(&r.pose, &right)) violation_numbers("a single's value is not its stamp's", i, r.stamp_ns);
    count_op(OP_LATEST);
}

static void read_at_time(member *m) {
    int i = (int)chance(m, SINGLES);
    int64_t t = seen_stamp[i] - (int64_t)chance(m, 2000) + 20;
    shmtf_result r = {.edges = NULL};
    shmtf_error e;
    stopwatch w = watch_start();
    shmtf_status st = shmtf_lookup_transform(m->main, NULL, shmtf_by_name("root"), shmtf_by_name(single_name[i]), &t, 0, &r, &e);
    watch_read(&w);
    if (st == SHMTF_BACKWARD || st == SHMTF_FORWARD || st == SHMTF_NO_DATA) {
        if (st == SHMTF_FORWARD && t <= seen_stamp[i]) violation("what was there is in the future", &e);
        count_op(OP_NO_ANSWER);
        return;
    }
    if (st) violation("at a time", &e);
    shmtf_pose right = single_pose(i, t);
    if (!same_pose(&r.pose, &right)) violation_numbers("a value between two records is wrong", i, t);
    count_op(OP_AT_TIME);
}

/* Both groups at one snapshot; all: in this store they are always there. */
static void read_groups(member *m, shmtf_store *h, bool all) {
    int which = h == m->second;
    long long version = atomic_load(&board->version[which]);
    shmtf_snapshot s = shmtf_take_snapshot(h);
    check_version(which, shmtf_snapshot_version(s), version);
    for (int group = 0; group < 2; group++) {
        shmtf_status first = SHMTF_OK;
        double sum = 0, equal = 0;
        int64_t stamp = 0;
        for (int i = 0; i < GROUP; i++) {
            shmtf_result r = {.edges = NULL};
            shmtf_error e;
            stopwatch w = watch_start();
            shmtf_ref name = shmtf_by_name(group ? sum_name[i] : equal_name[i]);
            shmtf_status st = shmtf_lookup_latest_transform(h, &s, shmtf_by_name("root"), name, 0, &r, &e);
            watch_read(&w);
            if (st == SHMTF_SNAPSHOT_EXPIRED) return count_op(OP_EXPIRED);
            if (st && (all || st != SHMTF_CONNECTIVITY)) violation("a group", &e);
            if (i == 0) first = st, equal = r.pose.x, stamp = r.stamp_ns;
            if (st != first) violation_numbers("half of a group is there", first, st);
            if (!st && (r.stamp_ns != stamp || (!group && r.pose.x != equal))) violation_numbers("half of an update", stamp, r.stamp_ns);
            sum += r.pose.x;
        }
        if (!first && group && sum != 0) violation_numbers("a sum is not 0", (long long)sum, stamp);
        if (!first && !group && equal != place_of(stamp)) violation_numbers("a value is not its stamp's", (long long)equal, stamp);
    }
    count_op(OP_SNAPSHOT);
}

static void read_chain(member *m) {
    shmtf_edge edges[CHAIN];
    shmtf_result r = {.edges = edges, .max_edges = CHAIN};
    long long stamp = atomic_load(&board->chain_stamp), version = atomic_load(&board->version[0]);
    latest(m->main, NULL, chain_name[0], chain_name[CHAIN], &r);
    check_version(0, r.version, version);
    if (r.n_edges != CHAIN || r.oldest_ns != r.newest_ns) violation_numbers("a mixture of stamps", r.oldest_ns, r.newest_ns);
    for (int i = 0; i < CHAIN; i++)
        if (edges[i].stamp_ns != r.oldest_ns) violation_numbers("an edge with another stamp", r.oldest_ns, edges[i].stamp_ns);
    if (r.pose.x != (double)(CHAIN * r.oldest_ns))
        violation_numbers("the chain's value is not its stamp's", r.oldest_ns, (long long)r.pose.x);
    check_stamp("the chain's newest stamp went back", &seen_chain, r.oldest_ns, stamp);
    count_op(OP_READ_CHAIN);
}

/* All of the big group, or some. */
static void read_big(member *m) {
    int n = chance(m, 16) ? 40 : BIG;
    long long acknowledged = atomic_load(&board->big_stamp);
    int64_t stamp = 0;
    shmtf_snapshot s = shmtf_take_snapshot(m->main);
    for (int k = 0; k < n; k++) {
        int i = n == BIG ? k : (int)chance(m, BIG);
        shmtf_result r = {.edges = NULL};
        if (latest(m->main, &s, "root", big_name[i], &r)) return count_op(OP_EXPIRED);
        if (k == 0) stamp = r.stamp_ns;
        if (r.stamp_ns != stamp || r.pose.x != (double)stamp || r.pose.y != (double)i)
            violation_numbers("half of a big update", stamp, r.stamp_ns);
    }
    check_stamp("the big group's stamp went back", &seen_big, stamp, acknowledged);
    count_op(OP_READ_BIG);
}

static void read_shape(member *m) {
    shmtf_result r = {.edges = NULL};
    shmtf_error e;
    uint64_t what = chance(m, 4);
    if (what == 0) latest(m->main, NULL, "root", knot_name[chance(m, KNOTS)], &r); /* a circle would be no answer */
    if (what == 1) latest(m->main, NULL, "root", arm_name[chance(m, ARMS)], &r);
    if (what == 2) latest(m->main, NULL, "root", flip_name[chance(m, FLIPS)], &r);
    if (what == 3) {
        const char *name = chance(m, 4) ? guest_name[chance(m, GUESTS)] : declared_name[chance(m, DECLARED)];
        shmtf_frame_info info;
        shmtf_status st = shmtf_get_frame_info(m->main, NULL, shmtf_by_name(name), &info, &e);
        if (st && st != SHMTF_LOOKUP) violation("a guest", &e);
        shmtf_record record;
        size_t n = 0;
        if (!st) st = shmtf_records(m->main, NULL, shmtf_by_handle(info.frame), &record, 1, &n, &e);
        if (st && st != SHMTF_LOOKUP) violation("a guest's records", &e);
        if (!st && n) r.pose = record.pose;
    }
    if (what && r.pose.x != place_of((int64_t)r.pose.y))
        violation_numbers("a value is not its stamp's", (long long)r.pose.x, (long long)r.pose.y);
    count_op(OP_READ_SHAPE);
}

/* Every frame at one snapshot. */
static void dump(member *m) {
    static shmtf_frame frames[MOST_FRAMES];
    shmtf_snapshot s = shmtf_take_snapshot(m->main);
    shmtf_error e;
    size_t n = 0, big = 0;
    int64_t stamp = 0;
    shmtf_status st = shmtf_frames(m->main, &s, frames, MOST_FRAMES, &n, &e);
    for (size_t i = 0; i < n && !st; i++) {
        shmtf_frame_info info;
        st = shmtf_get_frame_info(m->main, &s, shmtf_by_handle(frames[i]), &info, &e);
        if (st || info.name[0] != 'b') continue;
        if (big++ == 0) stamp = info.newest_ns;
        if (info.newest_ns != stamp) violation_numbers("half of a big update in a dump", stamp, info.newest_ns);
    }
    if (st == SHMTF_SNAPSHOT_EXPIRED) return count_op(OP_EXPIRED);
    if (st) violation("a dump", &e);
    if (big != BIG) violation_numbers("frames are missing in a dump", (long long)n, (long long)big);
    count_op(OP_DUMP);
}

void read_everything(member *m) {
    while (!over()) {
        uint64_t what = chance(m, 64);
        if (what < 20) read_single(m);
        else if (what < 34) read_at_time(m);
        else if (what < 44) read_groups(m, m->main, true);
        else if (what < 54) read_chain(m);
        else if (what < 63) read_shape(m);
        else if (chance(m, 8)) read_big(m);
        else dump(m);
        board_counters(m->main, &m->counted[0]);
    }
}

void read_second(member *m) {
    while (!over()) {
        read_groups(m, m->second, false);
        board_counters(m->second, &m->counted[1]);
    }
}

void wait_for_singles(member *m) {
    uint64_t since[SINGLES] = {0};
    while (!over()) {
        shmtf_ref frames[3];
        shmtf_error e;
        int first = (int)chance(m, SINGLES), n = 1 + (int)chance(m, 3);
        uint64_t from = UINT64_MAX, version;
        long long known = 0;
        for (int k = 0; k < n; k++) {
            int i = (first + k) % SINGLES;
            long long v = most(&board->single_version[i], &board->py_version[i]);
            frames[k] = shmtf_by_name(single_name[i]);
            if (since[i] < from) from = since[i];
            if (v > known) known = v;
        }
        shmtf_status st = shmtf_wait_for_change(m->main, frames, (size_t)n, from, 200000000, &version, &e);
        if (st && st != SHMTF_TIMEOUT) violation("a wait", &e);
        if (st && known > (long long)from) violation_numbers("a change that was there was not seen", (long long)from, known);
        if (!st && version <= from) violation_numbers("woken without a change", (long long)from, (long long)version);
        for (int k = 0; k < n; k++) since[(first + k) % SINGLES] = version;
        count_op(st ? OP_TIMED_OUT : OP_WOKEN);
        board_counters(m->main, &m->counted[0]);
    }
}
