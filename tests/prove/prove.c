/* SPDX-License-Identifier: Apache-2.0
 *
 * Every write operation is killed before each of its stores, stopped before each of its stores, and its recovery is
 * killed before the stores of that; a table says how often, and what went wrong.
 *
 * usage: prove [--quick] [--seed N] [--operation NAME] [--jobs N] [--list]
 *
 * Tier: `test` runs it with --quick, `tools/dev prove` in full.  Times are reported; nothing depends on them, except that
 * a watchdog ends what hangs.
 */
#define _GNU_SOURCE
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/wait.h>
#include <unistd.h>

#include "trial.h"

enum { MOST_STEPS = 1 << 18, MOST_JOBS = 16, MOST_FAILURES = 4 };

typedef struct {
    bool quick;
    uint64_t seed;
    const char *only;
    unsigned jobs;
} options;

typedef struct { /* shared by the workers of one operation */
    tally t;
    uint64_t stores, words, watched;
    bool all_pairs;
    unsigned char state[MOST_STEPS]; /* 0: not tried, 1 + what was seen after a kill before that store */
} row;

static char store_names[MOST_JOBS][64];
static unsigned n_stores;

static void remove_stores(void) {
    for (unsigned i = 0; i < n_stores; i++) shmtf_unlink(store_names[i], NULL);
}
static void on_signal(int number) {
    remove_stores();
    _exit(128 + number);
}

static uint64_t random_of(uint64_t seed, uint64_t k) {
    uint64_t x = (seed + 1) * 0x9e3779b97f4a7c15ull ^ k * 0xd1342543de82ef95ull;
    x = (x ^ x >> 31) * 0xbf58476d1ce4e5b9ull;
    return x ^ x >> 29;
}

/* ---- what is tried at one store ------------------------------------------------------------------------------- */

/* What goes wrong once goes wrong often, and what hangs takes its time. */
static uint64_t most_failures(const options *o) { return o->quick ? 0 : MOST_FAILURES; }
static bool is_large(const operation *op) { return op->extra > 100; }
static bool left_out(const operation *op) { return is_large(op) || !strcmp(op->name, "64"); } /* of the quick run */

/* Second deaths per first death: all of them for three frames, else a sample of about this many an operation. */
static void kill_recoverers(bench *b, row *r, const options *o, uint64_t k, int state) {
    const operation *op = b->ref.op;
    bool all = !o->quick && !strcmp(op->name, "three");
    uint64_t wanted = o->quick ? 8 : is_large(op) ? 400 : 600;
    if (op->first) return; /* its first death came before */
    for (recovery how = BY_ADOPTING; how <= BY_MEETING; how++) {
        uint64_t luck = random_of(o->seed, k * 2 + how), n = wanted / 2 / r->stores + (luck % r->stores < wanted / 2 % r->stores);
        if (!n && !all) continue;
        uint64_t steps = count_recovery(b, how);
        if (all) n = steps;
        for (uint64_t i = 1; i <= n; i++) {
            uint64_t j = all ? i : 1 + random_of(luck, i) % steps;
            kill_twice_at(b, k, state, how, j, !is_large(op) && i % 8 == 0);
            if (b->t->failures > most_failures(o)) return;
        }
    }
}

static void try_store(bench *b, row *r, const options *o, uint64_t k) {
    bool large = is_large(b->ref.op), thorough = k % (large ? 64 : o->quick ? 8 : 1) == 0;
    int state = kill_at(b, k, !o->quick && !large, thorough);
    if (state < 0) return;
    r->state[k] = (unsigned char)(1 + state);
    kill_recoverers(b, r, o, k, state);
    if (b->t->failures > most_failures(o)) return;
    if (!o->quick && !large) stop_at(b, k, false, k % 8 == 0);
    if (o->quick && k % 3) return;
    stop_at(b, k, !large || k % 2, thorough);
}

/* ---- workers -------------------------------------------------------------------------------------------------- */

typedef struct {
    const operation *op;
    const options *o;
    row *r;
    unsigned index;
} job;

static void work(void *job_) {
    const job *j = job_;
    world w;
    bench b;
    world_make(&w, store_names[j->index], j->op->extra);
    bench_make(&b, &w, j->op, &j->r->t, j->o->seed);
    uint64_t stores = count_stores(&b);
    alarm(0); /* from here on every process has a watchdog of its own */
    if (!stores || stores >= MOST_STEPS) die("%s: %llu stores", j->op->name, (unsigned long long)stores);
    j->r->stores = stores;
    j->r->words = b.count->words;
    if (j->index == 0 && !is_large(j->op)) watch_stores(&b, &j->r->watched);
    uint64_t stride = j->o->quick && j->op->extra > 16 ? 7 : 1, first = 1 + (j->o->seed + j->index * stride) % (stride * j->o->jobs);
    for (uint64_t k = first; k <= stores && j->r->t.failures <= most_failures(j->o); k += stride * j->o->jobs) try_store(&b, j->r, j->o, k);
    world_drop(&w);
}

/* What is committed stays so: from some store on the answer is "after", and never "before" again. */
static void check_order(const operation *op, row *r) {
    unsigned char last = 1;
    for (uint64_t k = 1; k <= r->stores; k++) {
        if (!r->state[k]) continue;
        if (r->state[k] < last) {
            fprintf(stderr, "%s: killed before store %llu, a commit was lost\n", op->name, (unsigned long long)k);
            r->t.failures++;
        }
        last = r->state[k];
    }
}

static void run_operation(const operation *op, const options *o, row *r) {
    pid_t pid[MOST_JOBS];
    job jobs[MOST_JOBS];
    memset(r, 0, sizeof *r);
    for (unsigned i = 0; i < o->jobs; i++) {
        jobs[i] = (job){op, o, r, i};
        pid[i] = start_process(work, &jobs[i]);
    }
    for (unsigned i = 0; i < o->jobs; i++)
        if (wait_for(pid[i], 0)) {
            fprintf(stderr, "%s: worker %u failed\n", op->name, i);
            r->t.failures++;
        }
    remove_stores();
    check_order(op, r);
}

/* ---- the table ------------------------------------------------------------------------------------------------ */

#define COLUMNS "%-36s %7llu %7llu %8llu %8llu %8llu %9llu"
static void print_row(const char *what, const row *r) {
    printf(COLUMNS "\n", what, (unsigned long long)r->stores, (unsigned long long)r->words, (unsigned long long)r->t.killed,
           (unsigned long long)r->t.killed_twice, (unsigned long long)r->t.stopped, (unsigned long long)r->t.failures);
    fflush(stdout);
}

static void add_row(row *all, const row *r) {
    all->stores += r->stores;
    all->words += r->words;
    all->watched += r->watched;
    all->t.killed += r->t.killed;
    all->t.killed_twice += r->t.killed_twice;
    all->t.stopped += r->t.stopped;
    all->t.failures += r->t.failures;
    all->t.checks += r->t.checks;
    all->t.sum_write_ns += r->t.sum_write_ns;
    all->t.writes_timed += r->t.writes_timed;
    raise_worst(&all->t.worst_read_ns, r->t.worst_read_ns);
    raise_worst(&all->t.worst_write_ns, r->t.worst_write_ns);
}

static int run_all(const options *o) {
    static row all;
    row *r = shared_memory(sizeof *r);
    int64_t began = now_ns();
    printf("seed %llu, %u at a time\n", (unsigned long long)o->seed, o->jobs);
    printf("%-36s %7s %7s %8s %8s %8s %9s\n", "operation", "stores", "words", "killed", "twice", "stopped", "failures");
    for (unsigned i = 0; i < n_operations; i++) {
        const operation *op = &operations[i];
        if (o->only ? strcmp(o->only, op->name) != 0 : o->quick && left_out(op)) continue;
        run_operation(op, o, r);
        print_row(op->what, r);
        add_row(&all, r);
        if (o->quick && all.t.failures) break;
    }
    print_row("all", &all);
    printf("%llu full views; each of %llu stores watched changed the one word that its step named, and nothing else changed\n",
           (unsigned long long)all.t.checks, (unsigned long long)all.watched);
    printf("slowest lookup beside a dead or stopped writer %.1f us; next write of a dead writer's frames: mean %.1f us, worst %.1f us\n",
           (double)all.t.worst_read_ns * 1e-3, all.t.writes_timed ? (double)all.t.sum_write_ns * 1e-3 / (double)all.t.writes_timed : 0.0,
           (double)all.t.worst_write_ns * 1e-3);
    printf("%.1f s\n", (double)(now_ns() - began) * 1e-9);
    return all.t.failures || !all.stores;
}

int main(int argc, char **argv) {
    long processors = sysconf(_SC_NPROCESSORS_ONLN);
    options o = {.seed = 1, .jobs = processors > 1 ? (unsigned)processors : 1};
    for (int i = 1; i < argc; i++) {
        const char *more = i + 1 < argc ? argv[i + 1] : "";
        if (!strcmp(argv[i], "--quick")) o.quick = true;
        else if (!strcmp(argv[i], "--seed")) o.seed = strtoull(more, NULL, 0), i++;
        else if (!strcmp(argv[i], "--operation")) o.only = more, i++;
        else if (!strcmp(argv[i], "--jobs")) o.jobs = (unsigned)atoi(more), i++;
        else if (!strcmp(argv[i], "--list")) {
            for (unsigned k = 0; k < n_operations; k++) printf("%-16s %s\n", operations[k].name, operations[k].what);
            return 0;
        } else return fprintf(stderr, "no such option: %s\n", argv[i]), 2;
    }
    if (o.only && !operation_named(o.only)) return fprintf(stderr, "no such operation: %s (--list)\n", o.only), 2;
    if (!o.jobs || o.jobs > MOST_JOBS) o.jobs = MOST_JOBS;
    for (n_stores = 0; n_stores < o.jobs; n_stores++)
        snprintf(store_names[n_stores], sizeof *store_names, "shmtf-prove-%d-%u", (int)getpid(), n_stores);
    signal(SIGINT, on_signal);
    signal(SIGTERM, on_signal);
    return run_all(&o);
}
