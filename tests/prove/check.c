/* SPDX-License-Identifier: Apache-2.0
 *
 * What a fresh process verifies after a death: readers of every kind see one state, all or nothing; taking over changes
 * nothing that they see and leaves no lock; doing it again changes no byte; the next writers get everything written,
 * and every frame and ring that is free can be had.
 */
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/wait.h>
#include <unistd.h>

#include "core/ring.h"
#include "prove.h"

void raise_worst(_Atomic int64_t *worst, int64_t ns) {
    int64_t old = *worst;
    while (ns > old && !atomic_compare_exchange_weak(worst, &old, ns)) {}
}

static void __attribute__((noreturn)) wrong(const verdict *v, const char *what, const char *more) {
    die("%s, %s: %s %s", v->ref->op->name, v->label, what, more);
}

/* The first of the allowed states that is what this handle sees. */
static int state_seen(const verdict *v, shmtf_store *h, bool live) {
    static const char *const names[N_STATES] = {"before", "after", "before, and again", "after, and again"};
    const reference *r = v->ref;
    view_how how = {.live = live, .stride = v->ref->op->extra > 100 && !v->thorough ? 64 : 1, .phase = v->phase};
    char why[200], all[1000] = "";
    view_take(r->w, h, &how, r->seen);
    raise_worst(&v->t->worst_read_ns, how.worst_ns);
    for (int i = 0; i < N_STATES; i++) {
        if (!(v->allowed & 1u << i)) continue;
        if (view_equal(r->w, r->state[i], r->seen, &how, why)) return i;
        size_t used = strlen(all);
        snprintf(all + used, sizeof all - used, "\n    not \"%s\": %s", names[i], why);
    }
    wrong(v, "neither all nor nothing", all);
}

/* A large world takes its time: there the ways to read take turns. */
static bool is_brief(const verdict *v) { return v->ref->op->extra > 100 && !v->thorough; }

int check_views(const verdict *v, shmtf_store *h, bool all_ways) {
    v->t->checks++;
    if (is_brief(v) && v->phase % 2) return state_seen(v, h, true);
    shmtf_store *ro = attach_or_die(v->ref->w, SHMTF_READONLY, NULL);
    int state = state_seen(v, ro, false);
    if (!is_brief(v) && state_seen(v, h, true) != state) wrong(v, "readers disagree", "");
    if (all_ways && (state_seen(v, ro, true) != state || state_seen(v, h, false) != state)) wrong(v, "readers disagree", "");
    shmtf_close(ro);
    return state;
}

void check_clean(const verdict *v, shmtf_store *h) {
    shmtf_check_report report;
    shmtf_error e;
    if (shmtf_check(h, 0, &report, &e) != SHMTF_OK) wrong(v, "a bad word:", report.first_problem);
    if (report.locks_held) wrong(v, "a frame is still locked", "");
}

/* Taking over once more must find nothing to do. */
static void check_idle_repair(const verdict *v, shmtf_store *h) {
    shmtf_check_report report;
    shmtf_error e;
    const world *w = v->ref->w;
    memcpy(v->ref->scratch, w->memory, w->size);
    must(shmtf_check(h, 1, &report, &e), &e, "second repair");
    if (report.locks_repaired) wrong(v, "a second recovery finds work", "");
    if (memcmp(v->ref->scratch, w->memory, w->size)) wrong(v, "a second recovery changes a byte", "");
}

static void recover(const verdict *v, shmtf_store *h, int state) {
    shmtf_check_report report;
    shmtf_error e;
    verdict then = *v;
    then.allowed = 1u << state;
    if (v->how == BY_REPAIR) must(shmtf_check(h, 1, &report, &e), &e, "repair");
    if (v->how == BY_ADOPTING || v->second) must(write_nothing(h, &e), &e, "adopt");
    if (v->second) must(shmtf_check(h, 1, &report, &e), &e, "repair");
    if (v->how == BY_MEETING && !v->second) {
        must(write_nothing(h, &e), &e, "claim");
        int64_t began = now_ns();
        must(write_again(h, v->ref->w->extra, &e), &e, "the next write");
        int64_t took = now_ns() - began;
        raise_worst(&v->t->worst_write_ns, took);
        v->t->sum_write_ns += took;
        v->t->writes_timed++;
        then.allowed = 1u << (state + BEFORE_AND_AGAIN);
        must(shmtf_check(h, 1, &report, &e), &e, "repair"); /* locks of frames that were not written again */
    }
    check_clean(v, h);
    check_views(&then, h, v->thorough);
    if (!is_brief(v)) check_idle_repair(v, h);
}

/* Every frame exists now: what their rings do not take must be free. */
static void check_arena(const verdict *v, shmtf_store *h) {
    enum { MOST = 1100 };
    static shmtf_frame frames[MOST];
    shmtf_info info;
    shmtf_error e;
    size_t n;
    uint64_t used = 0;
    must(shmtf_get_info(h, &info, &e), &e, "info");
    must(shmtf_frames(h, NULL, frames, MOST, &n, &e), &e, "frames");
    if (n != info.config.max_frames) wrong(v, "a frame is lost", "");
    for (size_t i = 0; i < n; i++) {
        shmtf_frame_info frame;
        must(shmtf_get_frame_info(h, NULL, shmtf_by_handle(frames[i]), &frame, &e), &e, "frame info");
        if (frame.capacity > shmtf_ring_live(SHMTF_INLINE_LOG2)) used += ring_word_chunks(ring_word(0, shmtf_ring_log2_for(frame.capacity)));
    }
    if (used + info.n_chunks_free != info.n_chunks) wrong(v, "memory for rings is lost", "");
}

static void probe(const verdict *v, shmtf_store *h) {
    shmtf_error e;
    char buffer[16];
    const world *w = v->ref->w;
    must(write_probe(h, w->extra, 900, &e), &e, "the probe");
    for (uint32_t i = 1; i < w->n_names; i++) {
        shmtf_result r = {.edges = NULL};
        if (i >= CORE_FRAMES && i < CORE_FRAMES + UNBORN_FRAMES) continue;
        const char *name = world_name(i, buffer);
        must(shmtf_lookup_latest_transform(h, NULL, shmtf_by_name(parent_name_of(name)), shmtf_by_name(name), 0, &r, &e), &e, "probing");
        if (r.stamp_ns != 900 || r.pose.x != 900) wrong(v, "a later write does not last:", name);
    }
    check_arena(v, h);
    check_clean(v, h);
}

void check_after_death(void *verdict_) {
    const verdict *v = verdict_;
    shmtf_check_report report;
    shmtf_error e;
    shmtf_store *h = attach_or_die(v->ref->w, 0, "checker");
    int state = check_views(v, h, v->thorough);
    if (shmtf_check(h, 0, &report, &e) != SHMTF_OK) wrong(v, "a bad word:", report.first_problem);
    if (report.locks_held != report.locks_dead) wrong(v, "a lock of nobody that died", "");
    recover(v, h, state);
    if (v->thorough) probe(v, h);
    shmtf_close(h);
    _exit(state);
}

/* ---- references ----------------------------------------------------------------------------------------------- */

typedef struct {
    reference *r;
    bool run, again;
    frame_view *out;
} clean_run;

static void perform(void *clean_run_) {
    const clean_run *c = clean_run_;
    shmtf_error e;
    shmtf_store *h = attach_or_die(c->r->w, 0, "victim");
    view_how how = {.stride = 1};
    if (c->run) must(c->r->op->run(h, &e), &e, c->r->op->name);
    if (c->again) { /* by another, whose name the records carry */
        shmtf_store *other = attach_or_die(c->r->w, 0, "checker");
        must(write_again(other, c->r->w->extra, &e), &e, "again");
        shmtf_close(other);
    }
    view_take(c->r->w, h, &how, c->out);
    shmtf_close(h);
}

void reference_make(reference *r, world *w, const operation *op, const unsigned char *image) {
    r->w = w;
    r->op = op;
    r->seen = new_views(w);
    r->scratch = world_new_image(w);
    world_hold_first_slot(w, true);
    for (int i = 0; i < N_STATES; i++) {
        r->state[i] = new_views(w);
        world_restore(w, image);
        clean_run run = {r, (i & 1) != 0, i >= BEFORE_AND_AGAIN, r->state[i]};
        if (wait_for(start_process(perform, &run), 0)) die("%s: an undisturbed run fails", op->name);
    }
}
