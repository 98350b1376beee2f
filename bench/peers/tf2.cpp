/* SPDX-License-Identifier: Apache-2.0
 *
 * tf2 as it is installed, behind the interface of protocol.h: one BufferCore, shared by the threads of one process.
 *
 * What it does not do: there is no newest record of every edge, so a lookup asks for Time(0), the newest time that all
 * edges have in common, and interpolates the edges that are newer; all frames of an update share a stamp, so it need not
 * within one update.  An update is write_len calls, and a lookup may come between two of them.  A result has one stamp
 * and does not tell which records it was made from: that stamp stands for every edge here.
 */
#include "tf2_tree.h"

#include <unistd.h>

#include <exception>
#include <new>

#include "protocol.h"

namespace {

/* Longer than a run.  A frame whose neighbours' history ends after its own newest record has no time in common with
 * them, and random starts leave some frames unwritten for long. */
const ros::Duration CACHE_TIME(3600);
enum { PERIOD_NS = 10000000 };

bool say(char *error, const char *why) {
    snprintf(error, BENCH_ERROR_SIZE, "tf2: %s", why);
    return false;
}

}  // namespace

struct bench_client {
    tf2_tree *tree;
    bench_shape shape;
    tf2_message message;
    shmtf_pose poses[BENCH_POSES];
};

namespace {

/* NULL: it was made by another process. */
tf2_tree *tree_at(const char *place) {
    long pid;
    void *tree;
    return sscanf(place, "%ld %p", &pid, &tree) == 2 && pid == getpid() ? static_cast<tf2_tree *>(tree) : nullptr;
}

bool create(char place[BENCH_PLACE_SIZE], const bench_shape *shape, char error[BENCH_ERROR_SIZE]) {
    try {
        tf2_tree *tree = new tf2_tree(shape->n_frames, CACHE_TIME);
        snprintf(place, BENCH_PLACE_SIZE, "%ld %p", long(getpid()), static_cast<void *>(tree));
        tree->fill(bench_now_ns() - int64_t(shape->history) * PERIOD_NS, shape->history, PERIOD_NS, false);
        return true;
    } catch (const std::exception &e) {
        return say(error, e.what());
    }
}

/* The threads that attached go on using it until the process ends. */
void remove_tree(const char *) {}

bench_client *attach(const char *place, const bench_shape *shape, char error[BENCH_ERROR_SIZE]) {
    tf2_tree *tree = tree_at(place);
    bench_client *c = tree ? new (std::nothrow) bench_client : nullptr;
    if (!c) return say(error, tree ? "no memory" : "made by another process"), nullptr;
    c->tree = tree;
    c->shape = *shape;
    for (uint32_t i = 0; i < BENCH_POSES; i++) c->poses[i] = bench_written_pose(i);
    return c;
}

void detach(bench_client *c) { delete c; }

bool read_chain(bench_client *c, uint32_t first, shmtf_pose *out, int64_t *stamps, char error[BENCH_ERROR_SIZE]) {
    const std::vector<std::string> &names = c->tree->names;
    uint32_t n = c->shape.read_len;
    try {
        geometry_msgs::TransformStamped found = c->tree->core.lookupTransform(names[first], names[first + n], ros::Time());
        *out = tf2_pose(found.transform);
        for (uint32_t i = 0; stamps && i < n; i++) stamps[i] = int64_t(found.header.stamp.toNSec());
        return true;
    } catch (const std::exception &e) {
        return say(error, e.what());
    }
}

bool write_chain(bench_client *c, uint32_t first, int64_t stamp_ns, bool opposite, char error[BENCH_ERROR_SIZE]) {
    const std::vector<std::string> &names = c->tree->names;
    uint32_t n = c->shape.write_len;
    try {
        for (uint32_t i = 0; i < n; i++) {
            uint32_t child = opposite ? first + 1 + i : first + n - i;
            const shmtf_pose &pose = c->poses[child % BENCH_POSES];
            if (!c->tree->core.setTransform(c->message.fill(names[child - 1], names[child], stamp_ns, pose), c->tree->authority))
                return say(error, "setTransform refused a record");
        }
        return true;
    } catch (const std::exception &e) {
        return say(error, e.what());
    }
}

void retries(bench_client *, uint64_t *reads, uint64_t *writes) { *reads = *writes = 0; }

const bench_protocol TF2 = {
    "tf2", "tf2::BufferCore: one mutex; an update is a call per frame, a lookup is at the newest common time",
    true, true, create, remove_tree, attach, detach, read_chain, write_chain, retries,
};

}  // namespace

extern "C" __attribute__((visibility("default"))) const bench_protocol *shmtf_bench_peer(void) { return &TF2; }
