/* SPDX-License-Identifier: Apache-2.0
 *
 * tf2's rows of micro.  Three trees: one to write to, whose history is as long as ours; one whose frames share their
 * stamps, where Time(0) finds a record in every frame; and one with staggered stamps, as sensors have them, where Time(0)
 * interpolates every frame but one.
 */
#include "tf2_tree.h"

#include <unistd.h>

#include <exception>

#include "micro_peer.h"

namespace {

enum { RECORD_BYTES = 160 }; /* about what tf2 keeps per record, with the deque's share */
const ros::Duration LONG(1e6);

ros::Duration duration(int64_t ns) { return ros::Duration(int32_t(ns / 1000000000), int32_t(ns % 1000000000)); }

}  // namespace

struct micro_peer_client {
    micro_shape shape;
    tf2_tree together, staggered, written;
    std::vector<int64_t> newest_ns;
    std::vector<shmtf_pose> poses;
    tf2_message message;
    geometry_msgs::TransformStamped found;
    std::string why;

    explicit micro_peer_client(const micro_shape &s)
        : shape(s),
          together(s.n_frames, LONG),
          staggered(s.n_frames, LONG),
          written(s.n_frames, duration(s.history * s.period_ns)),
          newest_ns(s.n_frames) {
        together.fill(s.first_ns, s.history, s.period_ns, false);
        staggered.fill(s.first_ns, s.history, s.period_ns, true);
        written.fill(s.first_ns, s.history, s.period_ns, true);
        for (uint32_t i = 0; i < s.n_frames; i++) newest_ns[i] = s.first_ns + s.history * s.period_ns;
        for (uint32_t i = 0; i < BENCH_POSES; i++) poses.push_back(bench_written_pose(i));
    }
};

namespace {

bool lookup(micro_peer_client *c, tf2_tree &tree, uint32_t first, int64_t time_ns) {
    try {
        c->found = tree.core.lookupTransform(tree.names[first], tree.names[first + c->shape.depth], tf2_time(time_ns));
        return true;
    } catch (const std::exception &e) {
        c->why = e.what();
        return false;
    }
}
bool latest(micro_peer_client *c, uint32_t first, int64_t time_ns) { return lookup(c, c->together, first, time_ns); }
bool at(micro_peer_client *c, uint32_t first, int64_t time_ns) { return lookup(c, c->staggered, first, time_ns); }

bool can(micro_peer_client *c, uint32_t first, int64_t time_ns) {
    const tf2_tree &tree = c->staggered;
    if (tree.core.canTransform(tree.names[first], tree.names[first + c->shape.depth], tf2_time(time_ns))) return true;
    c->why = "canTransform says no";
    return false;
}

bool write_n(micro_peer_client *c, uint32_t first, uint32_t n) {
    tf2_tree &tree = c->written;
    for (uint32_t child = first + 1; child <= first + n; child++) {
        int64_t stamp = c->newest_ns[child] += c->shape.period_ns;
        const shmtf_pose &pose = c->poses[child % BENCH_POSES];
        if (!tree.core.setTransform(c->message.fill(tree.names[child - 1], tree.names[child], stamp, pose), tree.authority)) {
            c->why = "setTransform refused a record";
            return false;
        }
    }
    return true;
}
bool write_many(micro_peer_client *c, uint32_t first, int64_t) { return write_n(c, first, c->shape.write_len); }
bool write_1(micro_peer_client *c, uint32_t first, int64_t) { return write_n(c, first, 1); }

const micro_peer_row ROWS[] = {
    {"tf2 latest", "lookupTransform(Time(0)), all frames share their stamps", "latest name", MICRO_NEWEST, latest},
    {"tf2 recent", "lookupTransform in the newest 0.2 s", "recent name", MICRO_RECENT, at},
    {"tf2 any time", "lookupTransform anywhere in the history", "any time name", MICRO_ANY_TIME, at},
    {"tf2 common", "lookupTransform(Time(0)), staggered stamps", "common name", MICRO_NEWEST, at},
    {"tf2 can", "canTransform(Time(0)), staggered stamps", "can name", MICRO_NEWEST, can},
    {"tf2 write 16", "16 setTransform, one after the other", "write 16 name", MICRO_NEWEST, write_many},
    {"tf2 write 1", "setTransform", "write 1 name", MICRO_NEWEST, write_1},
};

micro_peer_client *make(const micro_shape *shape, char error[MICRO_ERROR_SIZE]) {
    double bytes = 3.0 * shape->n_frames * shape->history * RECORD_BYTES;
    double free_bytes = double(sysconf(_SC_AVPHYS_PAGES)) * double(sysconf(_SC_PAGESIZE));
    if (bytes > free_bytes / 2) {
        snprintf(error, MICRO_ERROR_SIZE, "%.0f MB for three trees, and %.0f MB are free", bytes / 1e6, free_bytes / 1e6);
        return nullptr;
    }
    try {
        return new micro_peer_client(*shape);
    } catch (const std::exception &e) {
        snprintf(error, MICRO_ERROR_SIZE, "%s", e.what());
        return nullptr;
    }
}

void remove_client(micro_peer_client *c) { delete c; }
const char *why(const micro_peer_client *c) { return c->why.c_str(); }

const micro_peer TF2 = {"tf2", make, remove_client, why, ROWS, sizeof ROWS / sizeof *ROWS};

}  // namespace

extern "C" __attribute__((visibility("default"))) const micro_peer *shmtf_bench_micro_peer(void) { return &TF2; }
