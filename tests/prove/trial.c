/* SPDX-License-Identifier: Apache-2.0
 *
 * One death, one death of a recoverer, one stop: each with processes of its own, from an image of the store.
 */
#define _GNU_SOURCE
#include "trial.h"

#include <signal.h>
#include <stdio.h>
#include <string.h>
#include <sys/wait.h>
#include <unistd.h>

typedef struct {
    bench *b;
    hook_mode mode;
    uint64_t at;
    int signal_number;
    bool recovers;   /* not the operation, but what comes after its death */
    recovery how;
} actor;

/* A process that does one thing and may not survive it. */
static void act(void *actor_) {
    const actor *a = actor_;
    const operation *op = a->b->ref.op;
    shmtf_error e;
    if (a->mode == HOOK_WATCH) hook_shadow(a->b->w);
    shmtf_store *h = attach_or_die(a->b->w, 0, a->recovers ? "checker" : "victim");
    bool cold = a->recovers ? a->how == BY_ADOPTING : op->cold;
    cold |= a->recovers && a->how == BY_REPAIR;
    if (!cold) must(write_nothing(h, &e), &e, "claim");
    if (a->mode == HOOK_WATCH && !cold) hook_shadow(a->b->w); /* else attaching is watched too */
    hook_arm(a->mode, a->b->w, h, a->at, a->signal_number, a->b->count);
    shmtf_check_report report;
    shmtf_status st;
    if (!a->recovers) st = op->run(h, &e);
    else if (a->how == BY_REPAIR) st = shmtf_check(h, 1, &report, &e);
    else st = write_again(h, a->b->w->extra, &e);
    hook_off();
    must(st, &e, op->name);
    shmtf_close(h);
}

static bool ended_well(int status) { return WIFEXITED(status) && WEXITSTATUS(status) == 0; }

static bool failure(bench *b, const char *what, uint64_t k, uint64_t j, int status) {
    b->t->failures++;
    fprintf(stderr, "%s: %s at %llu/%llu: status %#x\n", b->ref.op->name, what, (unsigned long long)k, (unsigned long long)j, (unsigned)status);
    return false;
}

/* The slot that the next process claims: 0 where it meets the dead one's locks, 1 where it takes over the dead one's slot. */
static void set_slot(bench *b, bool meets) { world_hold_first_slot(b->w, !meets); }

/* The same where a victim may have left locks in slot 0: holding it would make that one look alive. */
static void set_slot_after(bench *b, bool first_slot_dead, bool meets) { set_slot(b, first_slot_dead || meets); }

static int run_actor(actor a) {
    pid_t pid = start_process(act, &a);
    return wait_for(pid, 0);
}

static bool died(int status) { return WIFSIGNALED(status) && WTERMSIG(status) == SIGKILL; }

uint64_t count_stores(bench *b) {
    world_restore(b->w, b->base);
    set_slot(b, b->ref.op->meets);
    int status = run_actor((actor){.b = b, .mode = HOOK_COUNT});
    if (!ended_well(status)) return failure(b, "an undisturbed run fails", 0, 0, status);
    return b->count->stores;
}

uint64_t count_recovery(bench *b, recovery how) {
    world_restore(b->w, b->dead);
    set_slot(b, how == BY_MEETING);
    int status = run_actor((actor){.b = b, .mode = HOOK_COUNT, .recovers = true, .how = how});
    if (!ended_well(status)) return failure(b, "a recovery fails", 0, 0, status);
    return b->count->stores;
}

bool make_dead(bench *b, uint64_t k) {
    world_restore(b->w, b->base);
    set_slot(b, b->ref.op->meets);
    int status = run_actor((actor){.b = b, .mode = HOOK_HALT, .at = k, .signal_number = SIGKILL});
    if (!died(status)) return failure(b, "nobody died", k, 0, status);
    world_save(b->w, b->dead);
    return true;
}

/* An operation that meets a dead writer's locks has slot 0, so two slots may hold locks after its death. */
static verdict verdict_of(bench *b, unsigned allowed, recovery how, bool thorough) {
    return (verdict){.ref = &b->ref, .t = b->t, .allowed = allowed, .how = how, .second = b->ref.op->first != NULL, .thorough = thorough};
}

/* The commit word alone decides what must be seen. */
static unsigned allowed_now(const bench *b) { return 1u << (world_version(b->w) > b->version ? AFTER : BEFORE); }

int kill_at(bench *b, uint64_t k, bool all_ways, bool thorough) {
    int seen = -1;
    if (!make_dead(b, k)) return -1;
    const unsigned allowed = allowed_now(b);
    *(b->ref.op->first ? &b->t->killed_twice : &b->t->killed) += 1;
    for (int way = 0; way < 3; way++) {
        recovery how = (recovery)((k + (uint64_t)way) % 3);
        if (way && !all_ways) break;
        if (way) world_restore(b->w, b->dead);
        set_slot_after(b, b->ref.op->meets, how == BY_MEETING);
        verdict v = verdict_of(b, allowed, how, thorough);
        v.phase = (uint32_t)k;
        snprintf(v.label, sizeof v.label, "killed before store %llu, recovery %d", (unsigned long long)k, how);
        int status = wait_for(start_process(check_after_death, &v), 0);
        if (!WIFEXITED(status) || WEXITSTATUS(status) > AFTER) return failure(b, "killed before store", k, 0, status), -1;
        int state = WEXITSTATUS(status);
        if (seen >= 0 && state != seen) return failure(b, "two checks differ", k, 0, status), -1;
        seen = state;
    }
    return seen;
}

bool kill_twice_at(bench *b, uint64_t k, int state, recovery how, uint64_t j, bool thorough) {
    world_restore(b->w, b->dead);
    set_slot(b, how == BY_MEETING);
    int status = run_actor((actor){.b = b, .mode = HOOK_HALT, .at = j, .signal_number = SIGKILL, .recovers = true, .how = how});
    if (!died(status)) return failure(b, "no recoverer died", k, j, status);
    b->t->killed_twice++;
    set_slot_after(b, how == BY_MEETING, j % 2 == 0);
    verdict v = verdict_of(b, 1u << state | 1u << (state + BEFORE_AND_AGAIN), j & 4 ? BY_ADOPTING : BY_REPAIR, thorough);
    v.second = true;
    v.phase = (uint32_t)j;
    snprintf(v.label, sizeof v.label, "killed before store %llu, its recoverer (%d) before store %llu", (unsigned long long)k, how,
             (unsigned long long)j);
    status = wait_for(start_process(check_after_death, &v), 0);
    if (!WIFEXITED(status) || WEXITSTATUS(status) >= N_STATES) return failure(b, "killed twice", k, j, status);
    return true;
}

/* ---- stop ----------------------------------------------------------------------------------------------------- */

typedef struct {
    verdict v;
    pid_t victim;
    bool crowd;
} beside;

/* Frames of the stopped writer: its own, and then its name is told; or free; or committed, and then others finish it. */
static void write_beside(const beside *s, shmtf_store *h, int state) {
    const operation *op = s->v.ref->op;
    shmtf_error e;
    for (int i = 0; op->frames[i]; i++) {
        shmtf_status st = write_frame(h, op->frames[i], 800 + i, &e);
        if (st == SHMTF_OK) continue;
        if (st != SHMTF_BUSY) must(st, &e, op->frames[i]);
        if (state == AFTER) die("%s, %s: %s is committed, but not to be had", op->name, s->v.label, op->frames[i]);
        bool taking_over = op->first && op->cold; /* until it has, the slot bears the dead one's texts */
        if (strcmp(e.holder, "victim") || (e.holder_pid != s->victim && !taking_over))
            die("%s, %s: BUSY names \"%s\" (%lld), not the stopped writer", op->name, s->v.label, e.holder, (long long)e.holder_pid);
    }
}

static void check_beside(void *beside_) {
    const beside *s = beside_;
    shmtf_error e;
    shmtf_store *h = attach_or_die(s->v.ref->w, 0, "neighbour");
    int state = check_views(&s->v, h, s->v.thorough);
    if (s->crowd) {
        must(write_frame(h, "other", 0, &e), &e, "a frame of nobody's");
        write_beside(s, h, state);
    }
    shmtf_close(h);
    _exit(state);
}

/* Records of the victim that a frame has now: all frames have one or none has. */
static void check_records(const verdict *v, shmtf_store *h) {
    const operation *op = v->ref->op;
    enum { MOST = 64 };
    shmtf_record r[MOST];
    shmtf_error e;
    char who[SHMTF_HOLDER_SIZE];
    uint64_t version = 0;
    for (int k = 0; op->frames[k]; k++) {
        size_t n, found = 0;
        must(shmtf_records(h, NULL, shmtf_by_name(op->frames[k]), r, MOST, &n, &e), &e, "records");
        for (size_t i = 0; i < n; i++) {
            shmtf_authority_name(h, r[i].writer, who);
            if (strcmp(who, "victim")) continue;
            found++;
            if (version && r[i].version != version) die("%s, %s: one transaction, two commits", op->name, v->label);
            version = r[i].version;
        }
        if (found != 1) die("%s, %s: %zu records of the writer in %s", op->name, v->label, found, op->frames[k]);
    }
}

static void check_after_stop(void *beside_) {
    const beside *s = beside_;
    shmtf_error e;
    shmtf_check_report report;
    shmtf_store *h = attach_or_die(s->v.ref->w, 0, "checker");
    if (s->v.ref->op->first) must(shmtf_check(h, 1, &report, &e), &e, "repair"); /* locks that nobody met */
    if (!s->crowd) check_views(&s->v, h, s->v.thorough);
    else if (s->v.ref->op->leaves_records) check_records(&s->v, h);
    check_clean(&s->v, h);
    if (s->v.thorough) must(write_probe(h, s->v.ref->w->extra, 900, &e), &e, "the probe");
    check_clean(&s->v, h);
    shmtf_close(h);
}

bool stop_at(bench *b, uint64_t k, bool crowd, bool thorough) {
    actor a = {.b = b, .mode = HOOK_HALT, .at = k, .signal_number = SIGSTOP};
    world_restore(b->w, b->base);
    set_slot(b, b->ref.op->meets);
    pid_t victim = start_process(act, &a);
    int status = wait_for(victim, WUNTRACED);
    if (!WIFSTOPPED(status)) return failure(b, "nobody stopped", k, 0, status);
    b->t->stopped++;
    beside s = {verdict_of(b, allowed_now(b), BY_ADOPTING, thorough), victim, crowd};
    s.v.phase = (uint32_t)k;
    snprintf(s.v.label, sizeof s.v.label, "stopped before store %llu", (unsigned long long)k);
    int beside_status = wait_for(start_process(check_beside, &s), 0);
    kill(victim, SIGCONT);
    status = wait_for(victim, 0);
    if (!WIFEXITED(beside_status) || WEXITSTATUS(beside_status) > AFTER) return failure(b, "beside a stopped writer", k, 0, beside_status);
    if (!ended_well(status)) return failure(b, "the writer did not go on well after a stop", k, 0, status);
    s.v.allowed = 1u << AFTER;
    snprintf(s.v.label, sizeof s.v.label, "after a stop before store %llu", (unsigned long long)k);
    status = wait_for(start_process(check_after_stop, &s), 0);
    return ended_well(status) || failure(b, "after a stop", k, 0, status);
}

/* ---- the bench ------------------------------------------------------------------------------------------------ */

static uint64_t step_of_death(const bench *b, const operation *op) {
    switch (op->died) {
    case DIED_UNDECIDED: return b->count->commit_at - 10;
    case DIED_PREPARED: return b->count->commit_at;
    case DIED_COMMITTED: return b->count->commit_at + 1;
    default: return b->count->stores;
    }
}

/* Another operation, killed in slot 1, comes first. */
static void die_first(bench *b) {
    const operation *op = b->ref.op, first = *operation_named(op->first);
    b->ref.op = &first;
    if (!count_stores(b)) die("%s: it cannot be run first", first.name);
    uint64_t k = step_of_death(b, op);
    if (!make_dead(b, k)) die("%s: no dead writer", op->name);
    memcpy(b->base, b->dead, b->w->size);
    b->ref.op = op;
}

void bench_make(bench *b, world *w, const operation *op, tally *t, uint64_t seed) {
    *b = (bench){.w = w, .t = t, .seed = seed, .base = world_new_image(w), .dead = world_new_image(w), .count = shared_memory(sizeof(step_count))};
    memset(w->bell_page, 0, 64);
    if (op->wakes) w->bell_page[0] = 0xff; /* somebody waits: for anything, for the shape, for the first frames */
    world_save(w, b->base);
    b->ref.op = op;
    b->ref.w = w;
    if (op->first) die_first(b);
    b->version = world_version(w);
    reference_make(&b->ref, w, op, b->base);
}

static bool watch_actor(bench *b, actor a, uint64_t *changed) {
    a.mode = HOOK_WATCH;
    int status = run_actor(a);
    *changed += b->count->changed;
    return ended_well(status) || failure(b, "a store without a step", a.recovers, 0, status);
}

bool watch_stores(bench *b, uint64_t *seen) {
    world_restore(b->w, b->base);
    set_slot(b, b->ref.op->meets);
    if (!watch_actor(b, (actor){.b = b}, seen)) return false;
    uint64_t n = b->count->stores;
    for (uint64_t k = 1; k <= n; k += n / 3 + 1) {
        if (!make_dead(b, k)) return false;
        for (recovery how = BY_ADOPTING; how <= BY_REPAIR; how++) {
            world_restore(b->w, b->dead);
            set_slot_after(b, b->ref.op->meets, how == BY_MEETING);
            if (!watch_actor(b, (actor){.b = b, .recovers = true, .how = how}, seen)) return false;
        }
    }
    return true;
}
