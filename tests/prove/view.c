/* SPDX-License-Identifier: Apache-2.0
 *
 * All that a reader can learn about every frame, as words that can be compared.
 *
 * Handles are left out (ids and generations may differ after a death), and the capacity of static frames (a dead writer may
 * have given one a ring); names, parents, poses, stamps, commits and authorities are in.  Of a large world the costly
 * words are read for a part of the frames each time.
 */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "prove.h"

static uint64_t hash_bytes(uint64_t h, const void *data, size_t n) {
    const unsigned char *p = data;
    for (size_t i = 0; i < n; i++) h = (h ^ p[i]) * 0x100000001b3ull;
    return h;
}
static uint64_t hash_text(const char *text) { return hash_bytes(0xcbf29ce484222325ull, text, strlen(text)); }
static uint64_t bits_of(double d) {
    uint64_t u;
    memcpy(&u, &d, sizeof u);
    return u;
}

static const char *const labels[VIEW_WORDS] = {
    "status of the latest transform", "x", "y", "z", "qx", "qy", "qz", "qw", "stamp", "oldest", "newest", "version", "all static", "edges",
    "", "", "existence", "static or root", "records", "capacity", "oldest record", "newest record", "arrival", "version of the newest record",
    "parent", "authority", "list of records", "common time", "status of the common time", ""};

frame_view *new_views(const world *w) { return shared_memory((w->n_names + 1) * sizeof(frame_view)); }

static void see_latest(shmtf_store *h, const shmtf_snapshot *snap, const char *name, view_how *how, uint64_t *out) {
    shmtf_result r = {.edges = NULL};
    int64_t began = now_ns();
    shmtf_status st = shmtf_lookup_latest_transform(h, snap, shmtf_by_name("root"), shmtf_by_name(name), 0, &r, NULL);
    int64_t took = now_ns() - began;
    if (took > how->worst_ns) how->worst_ns = took;
    out[0] = st;
    if (st != SHMTF_OK) return;
    const double pose[7] = {r.pose.x, r.pose.y, r.pose.z, r.pose.qx, r.pose.qy, r.pose.qz, r.pose.qw};
    for (int i = 0; i < 7; i++) out[1 + i] = bits_of(pose[i]);
    out[8] = (uint64_t)r.stamp_ns;
    out[9] = (uint64_t)r.oldest_ns;
    out[10] = (uint64_t)r.newest_ns;
    out[11] = r.version;
    out[12] = (uint64_t)r.all_static;
    out[13] = r.n_edges;
}

static uint64_t see_records(shmtf_store *h, const shmtf_snapshot *snap, shmtf_ref frame) {
    enum { MOST = 64 };
    shmtf_record r[MOST];
    char parent[SHMTF_NAME_SIZE], who[SHMTF_HOLDER_SIZE];
    size_t n;
    shmtf_status st = shmtf_records(h, snap, frame, r, MOST, &n, NULL);
    uint64_t hash = hash_bytes(st, &n, sizeof n);
    for (size_t i = 0; st == SHMTF_OK && i < n; i++) {
        hash = hash_bytes(hash, &r[i].stamp_ns, 8);
        hash = hash_bytes(hash, &r[i].arrival_ns, 8);
        hash = hash_bytes(hash, &r[i].version, 8);
        hash = hash_bytes(hash, &r[i].pose, sizeof r[i].pose);
        hash = hash_bytes(hash, &r[i].is_static, sizeof r[i].is_static);
        if (shmtf_frame_name(h, r[i].parent, parent, NULL) == SHMTF_OK) hash ^= hash_text(parent);
        shmtf_authority_name(h, r[i].writer, who);
        hash ^= hash_text(who);
    }
    return hash;
}

static void see_detail(shmtf_store *h, const shmtf_snapshot *snap, const char *name, uint64_t *out) {
    shmtf_frame_info info;
    char who[SHMTF_HOLDER_SIZE];
    shmtf_ref frame = shmtf_by_name(name);
    out[0] = shmtf_get_frame_info(h, snap, frame, &info, NULL);
    if (out[0] != SHMTF_OK) return;
    shmtf_authority_name(h, info.writer, who);
    int has_time;
    int64_t common;
    const uint64_t words[13] = {out[0], (uint64_t)(info.is_static | info.is_root << 1), info.n_records, info.is_static ? 0 : info.capacity,
                                (uint64_t)info.oldest_ns, (uint64_t)info.newest_ns, (uint64_t)info.arrival_ns, info.version,
                                hash_text(info.parent_name), hash_text(who), see_records(h, snap, frame)};
    memcpy(out, words, sizeof words);
    out[12] = shmtf_latest_common_time(h, snap, shmtf_by_name("root"), frame, &common, &has_time, NULL);
    out[11] = out[12] == SHMTF_OK && has_time ? (uint64_t)common : 0;
    for (int i = 0; i < N_TIMES; i++) {
        shmtf_result r = {.edges = NULL};
        shmtf_frame parent;
        char parent_name[SHMTF_NAME_SIZE] = "";
        uint64_t *at = out + 14 + 4 * i;
        at[0] = shmtf_lookup_transform(h, snap, shmtf_by_name("root"), frame, &view_times[i], 0, &r, NULL);
        if (at[0] == SHMTF_OK) at[1] = hash_bytes(1, &r.pose, sizeof r.pose);
        if (at[0] == SHMTF_OK) at[2] = r.version;
        if (shmtf_parent(h, snap, frame, &view_times[i], &parent, NULL) == SHMTF_OK && parent.gen) shmtf_frame_name(h, parent, parent_name, NULL);
        at[3] = hash_text(parent_name);
    }
}

static bool in_detail(const view_how *how, uint32_t i) { return i % how->stride == how->phase % how->stride; }

void view_take(const world *w, shmtf_store *h, view_how *how, frame_view *out) {
    shmtf_snapshot taken = shmtf_take_snapshot(h), *snap = how->live ? NULL : &taken;
    char buffer[16];
    size_t n;
    memset(out, 0, (w->n_names + 1) * sizeof *out);
    for (uint32_t i = 0; i < w->n_names; i++) {
        const char *name = world_name(i, buffer);
        see_latest(h, snap, name, how, out[i].word);
        if (in_detail(how, i)) see_detail(h, snap, name, out[i].word + VIEW_LATEST);
    }
    uint64_t *whole = out[w->n_names].word;
    whole[0] = shmtf_frames(h, snap, NULL, 0, &n, NULL);
    whole[1] = n;
    whole[2] = shmtf_commit_version(h);
}

bool view_equal(const world *w, const frame_view *expected, const frame_view *seen, const view_how *how, char why[200]) {
    for (uint32_t i = 0; i <= w->n_names; i++) {
        size_t n = i == w->n_names || in_detail(how, i) ? VIEW_WORDS : VIEW_LATEST;
        if (!memcmp(&expected[i], &seen[i], n * sizeof(uint64_t))) continue;
        size_t k = 0;
        char buffer[16];
        while (expected[i].word[k] == seen[i].word[k]) k++;
        const char *what = i == w->n_names ? "of the store" : k >= VIEW_LATEST + 14 ? "at a time" : labels[k];
        snprintf(why, 200, "%s, %s (word %zu): %#llx instead of %#llx", i == w->n_names ? "the whole" : world_name(i, buffer), what, k,
                 (unsigned long long)seen[i].word[k], (unsigned long long)expected[i].word[k]);
        return false;
    }
    return true;
}
