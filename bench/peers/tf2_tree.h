/* SPDX-License-Identifier: Apache-2.0
 *
 * The snake of common.h in a tf2::BufferCore, and what both users of it here share.
 *
 * At its best: names are strings made beforehand, no longer than what std::string holds without an allocation; a write
 * fills them into a message that is there already; tf2 logs nothing.  lookupTransform and setTransform lock one mutex.
 */
#ifndef SHMTF_BENCH_TF2_TREE_H
#define SHMTF_BENCH_TF2_TREE_H

#include <console_bridge/console.h>
#include <geometry_msgs/TransformStamped.h>
#include <tf2/buffer_core.h>

#include <cstdint>
#include <string>
#include <vector>

#include "common.h"

inline ros::Time tf2_time(int64_t ns) { return ros::Time(uint32_t(ns / 1000000000), uint32_t(ns % 1000000000)); }

inline shmtf_pose tf2_pose(const geometry_msgs::Transform &t) {
    return {t.translation.x, t.translation.y, t.translation.z, t.rotation.x, t.rotation.y, t.rotation.z, t.rotation.w};
}

class tf2_message {
public:
    tf2_message() { message_.transform.rotation.w = 1; }
    const geometry_msgs::TransformStamped &fill(const std::string &parent, const std::string &child, int64_t stamp_ns,
                                                const shmtf_pose &pose) {
        message_.header.frame_id = parent;
        message_.child_frame_id = child;
        message_.header.stamp = tf2_time(stamp_ns);
        message_.transform.translation.x = pose.x;
        message_.transform.translation.y = pose.y;
        message_.transform.translation.z = pose.z;
        message_.transform.rotation.x = pose.qx;
        message_.transform.rotation.y = pose.qy;
        message_.transform.rotation.z = pose.qz;
        message_.transform.rotation.w = pose.qw;
        return message_;
    }

private:
    geometry_msgs::TransformStamped message_;
};

class tf2_tree {
public:
    const std::string authority = "shmtf-bench";
    std::vector<std::string> names;
    tf2::BufferCore core;

    tf2_tree(uint32_t n_frames, const ros::Duration &cache_time) : core(cache_time) {
        console_bridge::setLogLevel(console_bridge::CONSOLE_BRIDGE_LOG_NONE);
        char name[BENCH_NAME_SIZE];
        names.reserve(n_frames);
        for (uint32_t i = 0; i < n_frames; i++) {
            bench_frame_name(name, i);
            names.emplace_back(name);
        }
    }

    /* n_rounds records of every frame from first_ns on; staggered: every frame has its own phase, as in snake_fill, else
     * all frames of a round share a stamp. */
    void fill(int64_t first_ns, uint32_t n_rounds, int64_t period_ns, bool staggered) {
        tf2_message message;
        for (uint32_t round = 0; round < n_rounds; round++)
            for (uint32_t child = 1; child < names.size(); child++) {
                int64_t phase = staggered ? child * int64_t(7919000) % period_ns : 0;
                int64_t stamp = first_ns + round * period_ns + phase;
                core.setTransform(message.fill(names[child - 1], names[child], stamp, bench_pose(child, stamp)), authority);
            }
    }
};

#endif
