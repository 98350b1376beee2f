/* SPDX-License-Identifier: Apache-2.0
 *
 * The reads of a recorded process: see operations.h.
 */
#include "operations.h"

enum { MOST_IN_SNAPSHOT = 6, LISTED = 12 };

static uint64_t handle_of(shmtf_frame f) { return f.gen ? (uint64_t)f.gen << 24 | f.id : 0; }

static unsigned any_source(member *m) {
    switch (member_below(m, 8)) {
    case 0: case 1: case 2: return FIRST_GROUP + GROUP - 1;
    case 3: return FIRST_GROUP + (unsigned)member_below(m, GROUP);
    case 4: return FIRST_BANK + (unsigned)member_below(m, BANK);
    default: return FIRST_FREE + (unsigned)member_below(m, FREE);
    }
}
static unsigned any_target(member *m) { return member_below(m, 2) ? 0 : (unsigned)member_below(m, N_NAMES); }

/* At, between, before and after what there is. */
static int64_t any_time(member *m) {
    int64_t now = (int64_t)atomic_load(&m->all->stamp);
    return (now + 1 - (int64_t)member_below(m, member_below(m, 3) ? 12 : 80)) * TICK - (int64_t)(member_below(m, 2) ? 0 : member_below(m, TICK));
}

static shmtf_status look_up(member *m, history_entry *e, const shmtf_snapshot *snapshot) {
    shmtf_edge edges[MOST_ITEMS];
    shmtf_result r = {.edges = edges, .max_edges = MOST_ITEMS};
    shmtf_ref target = shmtf_by_name(m->names[e->target]), source = shmtf_by_name(m->names[e->source]);
    shmtf_error error;
    shmtf_status st = e->kind == OP_LATEST ? shmtf_lookup_latest_transform(m->h, snapshot, target, source, 0, &r, &error)
                                           : shmtf_lookup_transform(m->h, snapshot, target, source, e->kind == OP_AT ? &e->time : NULL, 0, &r, &error);
    if (st != SHMTF_OK) return st;
    history_item *item = history_items(e);
    e->n = (uint16_t)r.n_edges;
    for (uint32_t i = 0; i < r.n_edges; i++)
        item[i] = (history_item){.flags = edges[i].is_static ? F_STATIC : 0, .child_handle = handle_of(edges[i].child),
                                 .parent_handle = handle_of(edges[i].parent), .stamp = edges[i].stamp_ns};
    e->x = r.pose.x;
    e->y = r.pose.y;
    e->version = r.version;
    e->flags |= F_VERSION;
    return st;
}

static shmtf_status list_records(member *m, history_entry *e, const shmtf_snapshot *snapshot) {
    shmtf_record records[LISTED];
    shmtf_error error;
    size_t n = 0;
    shmtf_status st = shmtf_records(m->h, snapshot, shmtf_by_name(m->names[e->source]), records, LISTED, &n, &error);
    history_item *item = history_items(e);
    for (size_t i = 0; i < n; i++)
        item[i] = (history_item){.flags = records[i].is_static ? F_STATIC : 0, .parent_handle = handle_of(records[i].parent), .version = records[i].version,
                                 .stamp = records[i].stamp_ns, .x = records[i].pose.x, .y = records[i].pose.y};
    e->n = (uint16_t)n;
    return st;
}

static shmtf_status list_frames(member *m, history_entry *e, const shmtf_snapshot *snapshot) {
    shmtf_frame frames[MOST_ITEMS];
    shmtf_error error;
    size_t n = 0;
    shmtf_status st = shmtf_frames(m->h, snapshot, frames, MOST_ITEMS, &n, &error);
    if (st != SHMTF_OK) return st;
    history_item *item = history_items(e);
    for (size_t i = 0; i < n && i < MOST_ITEMS; i++) item[i] = (history_item){.child_handle = handle_of(frames[i])};
    e->n = (uint16_t)n;
    return st;
}

static shmtf_status read_frame(member *m, history_entry *e, const shmtf_snapshot *snapshot) {
    shmtf_frame frame = {0, 0};
    shmtf_error error;
    const char *name = m->names[e->source];
    shmtf_status st = e->kind == OP_EXISTS ? shmtf_resolve(m->h, snapshot, name, &frame, &error)
                                           : shmtf_parent(m->h, snapshot, shmtf_by_name(name), NULL, &frame, &error);
    if (st != SHMTF_OK) return st;
    e->n = 1;
    history_items(e)[0] = (history_item){.child_handle = handle_of(frame)};
    return st;
}

static void read_once(member *m, history_kind kind, unsigned target, unsigned source, const shmtf_snapshot *snapshot) {
    history_entry *e = log_open(m, kind);
    e->target = (uint16_t)target;
    e->source = (uint16_t)source;
    if (kind == OP_AT) e->time = any_time(m);
    log_begin(m, e);
    shmtf_status st;
    switch (kind) {
    case OP_RECORDS: st = list_records(m, e, snapshot); break;
    case OP_FRAMES: st = list_frames(m, e, snapshot); break;
    case OP_EXISTS:
    case OP_PARENT: st = read_frame(m, e, snapshot); break;
    default: st = look_up(m, e, snapshot);
    }
    if (snapshot) {
        e->version = shmtf_snapshot_version(*snapshot);
        e->flags |= F_IN_SNAPSHOT | F_VERSION;
    }
    log_end(m, e, st);
    log_publish(m, e);
}

static history_kind any_kind(member *m) {
    uint64_t what = member_below(m, 32);
    if (what < 12) return OP_LATEST;
    if (what < 22) return OP_AT;
    if (what < 25) return OP_COMMON;
    if (what < 27) return OP_EXISTS;
    if (what < 29) return OP_PARENT;
    return what < 31 ? OP_RECORDS : OP_FRAMES;
}

void read_something(member *m) {
    if (member_below(m, 8)) return read_once(m, any_kind(m), any_target(m), any_source(m), NULL);
    history_entry *e = log_open(m, OP_SNAPSHOT);
    log_begin(m, e);
    shmtf_snapshot s = shmtf_take_snapshot(m->h);
    e->version = shmtf_snapshot_version(s);
    e->flags = F_VERSION;
    log_end(m, e, SHMTF_OK);
    log_publish(m, e);
    for (uint64_t i = 2 + member_below(m, MOST_IN_SNAPSHOT - 1); i > 0; i--) read_once(m, any_kind(m), any_target(m), any_source(m), &s);
}

void read_all(member *m) {
    read_once(m, OP_FRAMES, 0, 0, NULL);
    for (unsigned name = 0; name < N_NAMES; name++) {
        read_once(m, OP_EXISTS, 0, name, NULL);
        read_once(m, OP_PARENT, 0, name, NULL);
        read_once(m, OP_RECORDS, 0, name, NULL);
        read_once(m, OP_LATEST, 0, name, NULL);
    }
}
