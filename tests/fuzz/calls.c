/* SPDX-License-Identifier: Apache-2.0
 *
 * Every public call on an attached store, with arguments from the input.  Results lie in memory of exactly their size, so
 * that AddressSanitizer sees the first byte too many.
 */
#include "fuzz.h"

#include <stdio.h>
#include <stdlib.h>

static const char *any_name(void) {
    static const char *const odd[] = {"", "/n1", "n0 ", "nobody", "peer", "\xff\xfe", "n\xc3\xa9"};
    static char longest[SHMTF_NAME_SIZE + 2];
    if (!one_in(12)) return image_names[take(N_NAMES)];
    if (!one_in(6)) return odd[take(7)];
    memset(longest, 'n', sizeof longest - 1);
    longest[SHMTF_NAME_SIZE - 1 + take(2)] = 0;
    return longest;
}

static shmtf_frame any_frame(void) {
    if (one_in(8)) return (shmtf_frame){(uint32_t)take64(), (uint32_t)take64()};
    return (shmtf_frame){take(28), 2 * take(4)};
}

static shmtf_ref any_ref(void) {
    if (!one_in(6)) return shmtf_by_name(any_name());
    shmtf_ref r = {any_name(), any_frame()};
    if (r.frame.gen && take(2)) r.name = NULL;
    return r;
}

static int64_t any_time(void) {
    if (one_in(10)) return (int64_t)take64();
    return 1000 + (int64_t)take(400);
}

/* NULL, the commit now, one some commits ago, or anything. */
static const shmtf_snapshot *any_snapshot(shmtf_store *h, shmtf_snapshot *s) {
    uint32_t which = take(8);
    if (which < 5) return NULL;
    watch_call("shmtf_take_snapshot", CALL_READ);
    *s = shmtf_take_snapshot(h);
    watch_answer(SHMTF_OK, NULL);
    if (which == 6) s->word -= take(12);
    if (which == 7) s->word = take64();
    shmtf_snapshot_version(*s);
    return s;
}

static void read_lookup(shmtf_store *h, bool latest) {
    shmtf_error e;
    shmtf_snapshot s;
    const shmtf_snapshot *snapshot = any_snapshot(h, &s);
    int64_t time = any_time(), *at = one_in(3) ? NULL : &time;
    uint32_t room = take(3) ? take(12) : 0;
    shmtf_edge *edges = room ? malloc(room * sizeof *edges) : NULL;
    shmtf_result r = {.edges = edges, .max_edges = edges ? room : (take(2) ? 7 : 0)}, *result = one_in(8) ? NULL : &r;
    shmtf_ref target = any_ref(), source = any_ref();
    watch_call(latest ? "shmtf_lookup_latest_transform" : "shmtf_lookup_transform", CALL_READ);
    watch_answer(latest ? shmtf_lookup_latest_transform(h, snapshot, target, source, 0, result, &e)
                        : shmtf_lookup_transform(h, snapshot, target, source, at, 0, result, &e), &e);
    for (uint32_t i = 0; result && i < r.n_edges && i < room && e.status == SHMTF_OK; i++) /* all were filled in */
        if (edges[i].child.id > h->s.geo.max_frames) watch_failed("an edge of no frame");
    free(edges);
}

static void read_names(shmtf_store *h) {
    shmtf_error e;
    shmtf_snapshot s;
    const shmtf_snapshot *snapshot = any_snapshot(h, &s);
    shmtf_frame frame = any_frame();
    char *name = malloc(SHMTF_NAME_SIZE);
    const char *asked = any_name();
    watch_call("shmtf_resolve", CALL_READ);
    watch_answer(shmtf_resolve(h, snapshot, asked, &frame, &e), &e);
    watch_call("shmtf_frame_name", CALL_READ);
    shmtf_status st = shmtf_frame_name(h, frame, name, &e);
    watch_answer(st, &e);
    if (st == SHMTF_OK && !memchr(name, 0, SHMTF_NAME_SIZE)) watch_failed("a name without an end");
    free(name);
}

static void read_frames(shmtf_store *h) {
    shmtf_error e;
    shmtf_snapshot s;
    const shmtf_snapshot *snapshot = any_snapshot(h, &s);
    size_t n, room = take(2) ? 32 : take(8);
    shmtf_frame *frames = room ? malloc(room * sizeof *frames) : NULL;
    watch_call("shmtf_frames", CALL_READ);
    shmtf_status st = shmtf_frames(h, snapshot, frames, room, &n, &e);
    watch_answer(st, &e);
    if (st == SHMTF_OK && n > h->s.geo.max_frames) watch_failed("more frames than there can be");
    free(frames);
}

static void read_info(shmtf_store *h) {
    shmtf_error e;
    shmtf_snapshot s;
    shmtf_frame_info i;
    shmtf_info all;
    const shmtf_snapshot *snapshot = any_snapshot(h, &s);
    shmtf_ref frame = any_ref();
    watch_call("shmtf_get_frame_info", CALL_READ);
    watch_answer(shmtf_get_frame_info(h, snapshot, frame, &i, &e), &e);
    if (!memchr(i.name, 0, sizeof i.name) || !memchr(i.parent_name, 0, sizeof i.parent_name)) watch_failed("a name without an end");
    watch_call("shmtf_get_info", CALL_READ);
    watch_answer(shmtf_get_info(h, &all, &e), &e);
    if (all.n_chunks_free > all.n_chunks) watch_failed("more free memory than memory");
}

static void read_parent(shmtf_store *h) {
    shmtf_error e;
    shmtf_snapshot s;
    shmtf_frame parent;
    const shmtf_snapshot *snapshot = any_snapshot(h, &s);
    int64_t time = any_time();
    shmtf_ref frame = any_ref();
    watch_call("shmtf_parent", CALL_READ);
    watch_answer(shmtf_parent(h, snapshot, frame, take(2) ? &time : NULL, &parent, &e), &e);
}

static void read_records(shmtf_store *h) {
    shmtf_error e;
    shmtf_snapshot s;
    const shmtf_snapshot *snapshot = any_snapshot(h, &s);
    size_t n, room = take(2) ? 64 : take(5);
    shmtf_record *records = room ? malloc(room * sizeof *records) : NULL;
    shmtf_ref frame = any_ref();
    char *name = malloc(SHMTF_HOLDER_SIZE);
    watch_call("shmtf_records", CALL_READ);
    shmtf_status st = shmtf_records(h, snapshot, frame, records, room, &n, &e);
    watch_answer(st, &e);
    if (n > room) watch_failed("more records than room");
    watch_call("shmtf_authority_name", CALL_READ);
    watch_answer(shmtf_authority_name(h, n ? records[0].writer : (uint16_t)take(300), name), NULL);
    if (!memchr(name, 0, SHMTF_HOLDER_SIZE)) watch_failed("a name without an end");
    free(name);
    free(records);
}

static void read_common_time(shmtf_store *h) {
    shmtf_error e;
    shmtf_snapshot s;
    int64_t time;
    int has;
    const shmtf_snapshot *snapshot = any_snapshot(h, &s);
    shmtf_ref target = any_ref(), source = any_ref();
    watch_call("shmtf_latest_common_time", CALL_READ);
    watch_answer(shmtf_latest_common_time(h, snapshot, target, source, &time, &has, &e), &e);
}

static void read_writers(shmtf_store *h) {
    shmtf_error e;
    size_t n, room = take(6);
    shmtf_writer_info *writers = room ? malloc(room * sizeof *writers) : NULL;
    watch_call("shmtf_writers", CALL_READ);
    watch_answer(shmtf_writers(h, writers, room, &n, &e), &e);
    for (size_t i = 0; i < n && i < room; i++)
        if (!memchr(writers[i].name, 0, sizeof writers[i].name)) watch_failed("a name without an end");
    free(writers);
}

static void read_words(shmtf_store *h) {
    shmtf_error e;
    shmtf_frame_words w;
    shmtf_ref frame = any_ref();
    watch_call("shmtf_get_frame_words", CALL_READ);
    watch_answer(shmtf_get_frame_words(h, frame, &w, &e), &e);
}

void call_check(shmtf_store *h, int repair) {
    shmtf_error e;
    shmtf_check_report r;
    watch_call(repair ? "shmtf_check, repairing" : "shmtf_check", repair ? CALL_WRITE : CALL_READ);
    watch_answer(shmtf_check(h, repair, &r, &e), &e);
    if (!memchr(r.first_problem, 0, sizeof r.first_problem)) watch_failed("a report without an end");
}

static void read_change(shmtf_store *h, int64_t timeout_ns) {
    shmtf_error e;
    shmtf_ref frames[40];
    uint64_t version, since = take(3) ? take(60) : take64();
    size_t n = take(4) ? take(4) : take(40);
    for (size_t i = 0; i < n; i++) frames[i] = any_ref();
    watch_call("shmtf_wait_for_change", CALL_READ);
    watch_answer(shmtf_wait_for_change(h, frames, n, since, timeout_ns, &version, &e), &e);
}

void call_read(shmtf_store *h, unsigned which) {
    shmtf_counters c;
    switch (which % 14) {
    case 0: case 1: case 2: return read_lookup(h, false);
    case 3: case 4: return read_lookup(h, true);
    case 5: return read_names(h);
    case 6: return read_frames(h);
    case 7: return read_info(h);
    case 8: return read_parent(h);
    case 9: return read_records(h);
    case 10: return read_common_time(h);
    case 11: return take(2) ? read_writers(h) : read_words(h);
    case 12: return call_check(h, 0);
    default:
        read_change(h, 0);
        shmtf_get_counters(h, &c);
        shmtf_commit_version(h);
    }
}

void call_reads(shmtf_store *h) {
    for (unsigned i = 0; i < 14; i++) call_read(h, i);
}

void call_waits(shmtf_store *h) {
    shmtf_error e;
    shmtf_ref target = any_ref(), source = any_ref();
    int64_t time = any_time(), timeout_ns = 1 + take(20000);
    watch_call("shmtf_lookup_transform, waiting", CALL_READ);
    watch_answer(shmtf_lookup_transform(h, NULL, target, source, take(2) ? &time : NULL, timeout_ns, NULL, &e), &e);
    read_change(h, timeout_ns);
}

/* ---- writes ---- */

static void any_pose(shmtf_pose *p) {
    *p = (shmtf_pose){take(9), 1, 2, 0, 0, 0.6, 0.8};
    if (one_in(24)) p->qw = (double)take(3) / 0.7;
    if (one_in(24)) memcpy(&p->x, &(uint64_t){take64()}, 8);
}

static void write_batch(shmtf_store *h, const shmtf_write_options *o) {
    shmtf_error e;
    uint64_t version;
    size_t n = take(4) ? take(4) : take(48);
    shmtf_transform *items = malloc((n ? n : 1) * sizeof *items);
    for (size_t i = 0; i < n; i++) {
        items[i].parent = any_ref();
        items[i].child = any_ref();
        items[i].stamp_ns = any_time();
        items[i].flags = one_in(6) ? SHMTF_STATIC : 0;
        any_pose(&items[i].pose);
    }
    watch_call("shmtf_set_transforms", CALL_WRITE);
    watch_answer(shmtf_set_transforms(h, items, n, o, take(2) ? &version : NULL, &e), &e);
    if (one_in(4)) { /* again, with the handles it filled in */
        watch_call("shmtf_set_transforms, again", CALL_WRITE);
        watch_answer(shmtf_set_transforms(h, items, n, o, NULL, &e), &e);
    }
    free(items);
}

void call_write(shmtf_store *h) {
    shmtf_error e;
    shmtf_write_options o = {.timeout_ns = one_in(16) ? (int64_t)take(200000) : 0, .priority = one_in(4)};
    if (one_in(8)) o.authority = any_name();
    const shmtf_write_options *options = take(8) ? &o : NULL;
    switch (take(10)) {
    case 0:
        watch_call("shmtf_declare_frame", CALL_WRITE);
        watch_answer(shmtf_declare_frame(h, any_name(), take(3) ? take(60) : (uint32_t)take64(), options, &e), &e);
        return;
    case 1: {
        shmtf_ref frame = any_ref();
        watch_call("shmtf_remove_frame", CALL_WRITE);
        watch_answer(shmtf_remove_frame(h, frame, options, &e), &e);
        return;
    }
    case 2:
        watch_call("shmtf_clear", CALL_WRITE);
        watch_answer(shmtf_clear(h, (int)take(2), options, &e), &e);
        return;
    default: write_batch(h, options);
    }
}
