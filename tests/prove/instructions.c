/* SPDX-License-Identifier: Apache-2.0
 *
 * A writer of the library as it is shipped, without hooks, is driven by single steps and killed after its n-th machine
 * instruction.
 *
 * usage: prove_instructions [--quick] [--seed N] [--operation NAME] [--jobs N] [--budget SECONDS]
 *
 * killed  a real process executes n instructions and gets SIGKILL, for n = 0, 1, 2, ..; long operations are killed after
 *         every such-and-such-th only, so that each takes about the budget (an offset comes from the seed)
 * states  between two changes of the store all deaths leave the same memory: in one run the store is copied after
 *         every instruction that changed it, into a second store in which the writer is dead, and that is checked.
 *         So all instructions of long operations are covered too.
 *
 * Tier: `test` runs it with --quick, `tools/dev prove` in full.  Exit code 77: ptrace is refused here.
 */
#define _GNU_SOURCE
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ptrace.h>
#include <sys/wait.h>
#include <unistd.h>

#include "ptraced.h"
#include "segment/layout.h"

enum { MOST_JOBS = 16, MOST_FAILURES = 4, SKIPPED = 77 };

static const char *const in_full[] = {"one", "late", "late-again", "three", "64", "birth", "reparent", "remove", "clear", "static", "dynamic",
    "mixture", "declare", "claim", "adopt-undecided", "adopt-committed", "meet-undecided", "meet-committed"};
static const char *const in_short[] = {"one", "three", "birth", "claim", "adopt-committed", "meet-undecided", "meet-committed"};

typedef struct {
    tally t;
    uint64_t instructions, states;
    _Atomic uint64_t stride;
    int refused;
} row;

typedef struct {
    const operation *op;
    row *r;
    uint64_t seed;
    double budget_s;
    unsigned index, jobs;
    bool quick;
} job;

static char store_names[MOST_JOBS + 1][2][64];

static void remove_stores(void) {
    for (int i = 0; i < MOST_JOBS; i++)
        for (int k = 0; k < 2; k++)
            if (store_names[i][k][0]) shmtf_unlink(store_names[i][k], NULL);
}
static void on_signal(int number) {
    remove_stores();
    _exit(128 + number);
}

/* ---- the victim ----------------------------------------------------------------------------------------------- */

typedef struct {
    const world *w;
    const operation *op;
    _Atomic int *done;
} role;

static void act(void *role_) {
    const role *a = role_;
    shmtf_error e;
    shmtf_store *h = NULL;
    if (!a->op->cold) {
        h = attach_or_die(a->w, 0, "victim");
        must(write_nothing(h, &e), &e, "claim");
    }
    if (ptrace(PTRACE_TRACEME, 0, NULL, NULL)) _exit(SKIPPED);
    raise(SIGSTOP);
    if (!h) h = attach_or_die(a->w, 0, "victim");
    shmtf_status st = a->op->run(h, &e);
    *a->done = st == SHMTF_OK ? 1 : 2;
    raise(SIGSTOP);
}

static pid_t start_victim(const job *j, world *w, const operation *op, _Atomic int *done) {
    static role a;
    int status;
    a = (role){w, op, done};
    *done = 0;
    world_hold_first_slot(w, !op->meets);
    pid_t pid = start_process(act, &a);
    status = wait_for(pid, WUNTRACED);
    if (WIFSTOPPED(status)) return pid;
    j->r->refused = WIFEXITED(status) && WEXITSTATUS(status) == SKIPPED;
    if (!j->r->refused) die("%s: the writer does not start", op->name);
    _exit(SKIPPED);
}

static void end(pid_t pid) {
    kill(pid, SIGKILL);
    wait_for(pid, 0);
}

static verdict verdict_of(const job *j, reference *ref, recovery how, uint64_t n, const char *what) {
    verdict v = {.ref = ref, .t = &j->r->t, .how = how, .second = j->op->first != NULL};
    v.thorough = n % 16 == 0;
    snprintf(v.label, sizeof v.label, "%s instruction %llu", what, (unsigned long long)n);
    return v;
}

/* The commit word alone decides what must be seen. */
static void check(const job *j, world *w, verdict *v, uint64_t version_before) {
    world_hold_first_slot(w, v->how != BY_MEETING && !j->op->meets);
    v->allowed = 1u << (world_version(w) > version_before ? AFTER : BEFORE);
    int status = wait_for(start_process(check_after_death, v), 0);
    if (WIFEXITED(status) && WEXITSTATUS(status) <= AFTER) return;
    j->r->t.failures++;
    fprintf(stderr, "%s, %s: status %#x\n", j->op->name, v->label, (unsigned)status);
}

/* ---- trials --------------------------------------------------------------------------------------------------- */

typedef struct {
    world w, copy;
    reference ref, copy_ref;
    unsigned char *base, *now, *before;
    uint64_t version;
    course *course;
    _Atomic int *done;
} stand;

/* Another writer, in slot 1, died: how far it came is told by the commit word. */
static void die_first(const job *j, stand *s) {
    const operation *op = j->op, *first = operation_named(op->first);
    uint64_t old = world_version(&s->w), at = 0, n = 0;
    for (int round = 0; round < 2; round++) {
        world_restore(&s->w, s->base);
        pid_t pid = start_victim(j, &s->w, first, s->done);
        uint64_t until = round && op->died < DIED_COMMITTED ? at - 20 : UINT64_MAX;
        for (n = 0; n < until && world_version(&s->w) == old && ptraced_step(pid, s->done); n++) {}
        end(pid);
        at = n;
        if (op->died >= DIED_COMMITTED) break;
    }
    world_save(&s->w, s->base);
}

static void stand_make(const job *j, stand *s) {
    world_make(&s->w, store_names[j->index][0], j->op->extra);
    world_make(&s->copy, store_names[j->index][1], j->op->extra);
    s->base = world_new_image(&s->w);
    s->now = world_new_image(&s->w);
    s->before = world_new_image(&s->w);
    s->course = course_new();
    s->done = shared_memory(sizeof *s->done);
    world_save(&s->w, s->base);
    if (j->op->first) die_first(j, s);
    s->version = world_version(&s->w);
    reference_make(&s->ref, &s->w, j->op, s->base);
    reference_make(&s->copy_ref, &s->copy, j->op, s->base);
}

/* One run from the first to the last instruction: its course; and each state of the store is checked as if the writer
 * died in it. */
static void follow(const job *j, stand *s) {
    uint64_t n = 0, states = 0;
    int64_t began = now_ns(), spent = 0;
    world_restore(&s->w, s->base);
    pid_t pid = start_victim(j, &s->w, j->op, s->done);
    world_save(&s->w, s->before);
    for (course_note(s->course, 0, pid); ptraced_step(pid, s->done); course_note(s->course, n, pid)) {
        n++;
        if (j->quick || !memcmp(s->before, s->w.memory, s->w.size)) continue;
        int64_t changed = now_ns();
        world_save(&s->w, s->before);
        if (states++ % j->jobs != j->index) continue;
        world_restore(&s->copy, s->before);
        verdict v = verdict_of(j, &s->copy_ref, (recovery)(states / j->jobs % 3), n, "the state after");
        check(j, &s->copy, &v, s->version);
        spent += now_ns() - changed;
        if (j->r->t.failures > MOST_FAILURES) break;
    }
    end(pid);
    course_end(s->course, n, (double)(now_ns() - began - spent) * 1e-9);
    if (j->index == 0) j->r->states = states;
}

static void kill_after(const job *j, stand *s, uint64_t n) {
    world_restore(&s->w, s->base);
    pid_t pid = start_victim(j, &s->w, j->op, s->done);
    course_run_to(s->course, n, pid, s->done);
    end(pid);
    if (*s->done == 2) die("%s: refused", j->op->name);
    j->r->t.killed++;
    verdict v = verdict_of(j, &s->ref, (recovery)(n % 3), n, "killed after");
    check(j, &s->w, &v, s->version);
}

/* So that all of it takes about the budget; all workers have that of the first. */
static uint64_t choose_stride(const job *j, const course *c) {
    const double each_s = 0.003 + c->mean_cost * c->each_s, share_s = j->budget_s * j->jobs;
    if (!j->index) {
        j->r->instructions = c->n;
        j->r->stride = 1 + (uint64_t)((double)c->n * each_s / share_s);
    }
    while (!j->r->stride) usleep(1000);
    return j->r->stride;
}

static void work(void *job_) {
    const job *j = job_;
    static stand s;
    stand_make(j, &s);
    alarm(0); /* from here on every process has a watchdog of its own */
    follow(j, &s);
    uint64_t stride = choose_stride(j, s.course);
    for (uint64_t n = j->seed % stride + j->index * stride; n <= s.course->n && j->r->t.failures <= MOST_FAILURES; n += j->jobs * stride)
        kill_after(j, &s, n);
    world_drop(&s.w);
    world_drop(&s.copy);
}

/* ---- the table ------------------------------------------------------------------------------------------------ */

/* False: ptrace is refused. */
static bool run_operation(job j, row *r) {
    pid_t pid[MOST_JOBS];
    job jobs[MOST_JOBS];
    memset(r, 0, sizeof *r);
    for (unsigned i = 0; i < j.jobs; i++) {
        jobs[i] = j;
        jobs[i].index = i;
        pid[i] = start_process(work, &jobs[i]);
    }
    for (unsigned i = 0; i < j.jobs; i++) {
        int status = wait_for(pid[i], 0);
        if (!status || r->refused) continue;
        fprintf(stderr, "%s: worker %u failed: status %#x\n", j.op->name, i, (unsigned)status);
        r->t.failures++;
    }
    remove_stores();
    if (r->refused) return false;
    printf("%-36s %12llu %9llu %7llu %8llu %9llu\n", j.op->what, (unsigned long long)r->instructions, (unsigned long long)r->stride,
           (unsigned long long)r->t.killed, (unsigned long long)r->states, (unsigned long long)r->t.failures);
    fflush(stdout);
    return true;
}

static int run_all(const char *only, job j) {
    const char *const *names = j.quick ? in_short : in_full;
    size_t n = j.quick ? sizeof in_short / sizeof *in_short : sizeof in_full / sizeof *in_full;
    row *r = shared_memory(sizeof *r);
    uint64_t killed = 0, states = 0, failures = 0, instructions = 0;
    int64_t began = now_ns();
    printf("seed %llu, %u at a time\n", (unsigned long long)j.seed, j.jobs);
    printf("%-36s %12s %9s %7s %8s %9s\n", "operation", "instructions", "every nth", "killed", "states", "failures");
    for (size_t i = 0; i < (only ? 1 : n); i++) {
        j.op = operation_named(only ? only : names[i]);
        if (!j.op) return fprintf(stderr, "no such operation: %s\n", only), 2;
        j.r = r;
        if (!run_operation(j, r)) return fprintf(stderr, "ptrace is refused here\n"), SKIPPED;
        instructions += r->instructions;
        killed += r->t.killed;
        states += r->states;
        failures += r->t.failures;
    }
    printf("%-36s %12llu %9s %7llu %8llu %9llu\n%.1f s\n", "all", (unsigned long long)instructions, "", (unsigned long long)killed,
           (unsigned long long)states, (unsigned long long)failures, (double)(now_ns() - began) * 1e-9);
    return failures || !killed;
}

int main(int argc, char **argv) {
    long processors = sysconf(_SC_NPROCESSORS_ONLN);
    const char *only = NULL;
    job j = {.seed = 1, .jobs = processors > 1 ? (unsigned)processors : 1, .budget_s = 8};
    for (int i = 1; i < argc; i++) {
        const char *more = i + 1 < argc ? argv[i + 1] : "";
        if (!strcmp(argv[i], "--quick")) j.quick = true, j.budget_s = 0.5;
        else if (!strcmp(argv[i], "--seed")) j.seed = strtoull(more, NULL, 0), i++;
        else if (!strcmp(argv[i], "--operation")) only = more, i++;
        else if (!strcmp(argv[i], "--jobs")) j.jobs = (unsigned)atoi(more), i++;
        else if (!strcmp(argv[i], "--budget")) j.budget_s = atof(more), i++;
        else return fprintf(stderr, "no such option: %s\n", argv[i]), 2;
    }
    if (!j.jobs || j.jobs > MOST_JOBS) j.jobs = MOST_JOBS;
    for (unsigned i = 0; i < j.jobs; i++)
        for (int k = 0; k < 2; k++) snprintf(store_names[i][k], sizeof store_names[i][k], "shmtf-instructions-%d-%u-%d", (int)getpid(), i, k);
    signal(SIGINT, on_signal);
    signal(SIGTERM, on_signal);
    return run_all(only, j);
}
