/* SPDX-License-Identifier: Apache-2.0
 *
 * usage: history_replay LOG [MOST_PROBLEMS]
 *
 * Is a recorded history strictly serialisable?  The order that the store claims, by version of commit, is taken as the
 * witness and checked, so a history of a million operations costs a second:
 *
 *   - each version has one commit, and each version that anybody saw has one;
 *   - an operation that began after another had ended has at least its version, a commit a greater one;
 *   - the commits, done in order on a model of the tree, are each allowed, and found what they say they read;
 *   - each answer, errors included, is the model's at its version; an answer that does not name its version, at one of those
 *     that were current while it was sought;
 *   - a write whose process was killed happened at a version without another commit, or not at all.
 *
 * Exit 1 and lines that begin with VIOLATION if not; 2 if the log cannot be read.  linear.py does not trust versions.
 */
#define _GNU_SOURCE
#include <fcntl.h>
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include "model.h"
#include "shmtf.h"

enum { MOST_ORDERS = 512, NONE = -1 };

static history_control *all;
static const history_entry **op;
static uint64_t *low;        /* per operation: no version below it can be its own, by real time */
static int n_ops, *commit_at; /* per version: an operation, or NONE */
static int *first_at, *next_at; /* per version: the answers to be judged there, as a list */
static uint64_t last_version;
static int *lost, n_lost;       /* writes whose process was killed */
static uint64_t *hole, n_holes;
static uint64_t n_unjudged;
static long problems, most_problems = 5, n_judged, n_expired, n_refused, n_orders;
static uint64_t failed_at; /* version of the first problem of the last replay */
static FILE *out;
static char *said;         /* what there is against the order that came furthest */
static uint64_t furthest;

static const char *const kinds[N_OPS] = {"set", "transfer", "remove", "clear", "latest", "at", "common", "exists", "parent", "records", "frames", "snapshot"};

static void violation(int i, uint64_t version, const char *why) {
    if (!problems || version < failed_at) failed_at = version;
    if (problems++ >= most_problems) return;
    const history_entry *e = i == NONE ? NULL : op[i];
    fprintf(out, "VIOLATION at version %" PRIu64 ": %s", version, why);
    if (e)
        fprintf(out, "; process %u, %s of %u items, target %u, source %u, time %" PRId64 ", status %u, version %" PRIu64 ", between %" PRIu64 " and %" PRIu64
               ", order %" PRIu64 " to %" PRIu64, e->process, kinds[e->kind], e->n, e->target, e->source, e->time, e->status, e->version, e->low,
               e->high, e->begin, e->end);
    fputc('\n', out);
}

static void *memory(size_t n, size_t size, int fill) {
    void *p = malloc(n * size + 1);
    if (!p) abort();
    return memset(p, fill, n * size + 1);
}

/* ---- the log ----------------------------------------------------------------------------------------------- */

static bool impossible(const history_entry *e) { return e->kind >= N_OPS || e->n > MOST_ITEMS || e->target >= N_NAMES || e->source >= N_NAMES; }

static int each_entry(void (*found)(const history_entry *)) {
    for (uint64_t b = 0; b < all->n_buffers; b++) {
        const char *at = (const char *)all + HISTORY_HEADER + b * all->buffer_bytes, *stop = at + atomic_load(&all->used[b]);
        while (at < stop) {
            const history_entry *e = (const history_entry *)(const void *)at;
            if (impossible(e)) return fprintf(stderr, "an impossible entry in buffer %d\n", (int)b), 2;
            found(e);
            at += history_size(e);
        }
    }
    return 0;
}

static void count(const history_entry *e) {
    n_ops++;
    if (e->version > last_version) last_version = e->version;
    if (e->end && e->high > last_version) last_version = e->high;
}
static void add(const history_entry *e) { op[n_ops++] = e; }

static int load(const char *path) {
    struct stat s;
    int fd = open(path, O_RDONLY | O_CLOEXEC);
    if (fd < 0 || fstat(fd, &s) || s.st_size < HISTORY_HEADER) return fprintf(stderr, "%s: no history\n", path), 2;
    all = mmap(NULL, (size_t)s.st_size, PROT_READ, MAP_PRIVATE, fd, 0);
    close(fd);
    if (all == MAP_FAILED || all->magic != HISTORY_MAGIC || HISTORY_HEADER + all->n_buffers * all->buffer_bytes > (uint64_t)s.st_size)
        return fprintf(stderr, "%s: no history\n", path), 2;
    if (each_entry(count)) return 2;
    op = memory((size_t)n_ops, sizeof *op, 0);
    n_ops = 0;
    return each_entry(add);
}

/* ---- real time --------------------------------------------------------------------------------------------------- */

static bool wrote(const history_entry *e) { return e->status == SHMTF_OK && (e->flags & F_COMMITTED); }

/* In the order of the shared counter: what had ended before each began. */
static void check_real_time(void) {
    uint64_t n = atomic_load(&all->order) + 1, newest = 0;
    int *event = memory(n, sizeof *event, 0); /* 1 + 2 * operation + (it ended) */
    for (int i = 0; i < n_ops; i++) {
        if (op[i]->begin >= n || op[i]->end >= n) violation(i, 0, "a moment that never was");
        else event[op[i]->begin] = 1 + 2 * i;
        if (op[i]->end && op[i]->end < n) event[op[i]->end] = 2 + 2 * i;
    }
    for (uint64_t k = 0; k < n; k++) {
        if (!event[k]) continue;
        int i = (event[k] - 1) / 2;
        const history_entry *e = op[i];
        if (event[k] % 2) {
            low[i] = newest > e->low ? newest : e->low;
            if (wrote(e) && e->version <= low[i]) violation(i, e->version, "a commit before one that it followed");
            continue;
        }
        if (!(e->flags & F_VERSION) || e->flags & F_IN_SNAPSHOT) continue;
        if (!wrote(e) && e->version < low[i]) violation(i, e->version, "stale: a later commit was known before it began");
        if (e->version > e->high) violation(i, e->version, "an answer from the future");
        if (e->version > newest) newest = e->version;
    }
    free(event);
}

/* ---- which version each operation is about ---------------------------------------------------------------------------- */

static void judge_from(int i, uint64_t version) {
    next_at[i] = first_at[version];
    first_at[version] = i;
}

static void place_commit(int i, uint64_t version) {
    if (commit_at[version] != NONE) violation(i, version, "two commits of one version");
    commit_at[version] = i;
}

static void place(int i) {
    const history_entry *e = op[i];
    bool write = e->kind <= OP_CLEAR;
    if (e->status == PENDING) {
        lost[n_lost++] = i;
    } else if (wrote(e)) {
        place_commit(i, e->version);
    } else if (write && (e->status == SHMTF_BUSY || e->status == SHMTF_CONFLICT)) {
        n_refused++;
    } else if (!write && e->status == SHMTF_SNAPSHOT_EXPIRED) {
        n_expired++;
    } else if (e->flags & F_VERSION) {
        judge_from(i, e->version);
    } else {
        judge_from(i, low[i]);
    }
}

static void place_all(void) {
    commit_at = memory(last_version + 1, sizeof *commit_at, 0xff);
    first_at = memory(last_version + 1, sizeof *first_at, 0xff);
    next_at = memory((size_t)n_ops, sizeof *next_at, 0xff);
    lost = memory((size_t)n_ops, sizeof *lost, 0);
    for (int i = 0; i < n_ops; i++) {
        if (low[i] > last_version || op[i]->version > last_version) violation(i, op[i]->version, "a version that never was");
        else place(i);
    }
    for (uint64_t v = 1; v <= last_version; v++) n_holes += commit_at[v] == NONE;
    hole = memory(n_holes, sizeof *hole, 0);
    n_holes = 0;
    for (uint64_t v = 1; v <= last_version; v++)
        if (commit_at[v] == NONE) hole[n_holes++] = v;
}

/* ---- replay -------------------------------------------------------------------------------------------------------- */

/* Answers that do not name their version wait in a list until they fit. */
static void judge_waiting(model *m, uint64_t version, int *waiting, int *n) {
    int kept = 0;
    for (int k = 0; k < *n; k++) {
        int i = waiting[k];
        if (model_answers(m, op[i], false)) continue;
        if (version >= op[i]->high) violation(i, version, model_why(m));
        else waiting[kept++] = i;
    }
    *n = kept;
}

static void replay(void) {
    model *m = model_make(all->live, all->cache_time_ns);
    int *waiting = memory((size_t)n_ops, sizeof *waiting, 0), n = 0;
    n_judged = 0;
    for (uint64_t v = 0; v <= last_version && problems < most_problems; v++) {
        int c = commit_at[v];
        if (c != NONE && !model_commit(m, op[c], v)) {
            violation(c, v, model_why(m));
            break; /* what follows would say the same again */
        }
        n_judged += c != NONE;
        for (int i = first_at[v]; i != NONE; i = next_at[i]) {
            n_judged++;
            if (!(op[i]->flags & F_VERSION)) waiting[n++] = i;
            else if (!model_answers(m, op[i], true)) violation(i, v, model_why(m));
        }
        judge_waiting(m, v, waiting, &n);
    }
    n_unjudged = model_unjudged(m);
    free(waiting);
    model_free(m);
}

static char *text;
static size_t length;
static void listen(void) {
    out = open_memstream(&text, &length);
    if (!out) abort();
    problems = 0;
}
/* True: there was nothing. */
static bool hear(void) {
    fclose(out);
    if (problems && (!said || failed_at > furthest)) {
        free(said);
        said = text;
        furthest = failed_at;
    } else {
        free(text);
    }
    return problems == 0;
}

static bool fits(int i, uint64_t version) { return version > low[i] && (version <= op[i]->high || !op[i]->high); }

/* Every way to explain the versions from the k-th hole on; true: one of them is a serial history.  A problem before a hole
 * has nothing to do with who fills it. */
static bool explain(uint64_t k, char *used) {
    if (k == n_holes) {
        n_orders++;
        listen();
        replay();
        return hear();
    }
    bool any = false;
    for (int j = 0; j < n_lost && n_orders < MOST_ORDERS; j++) {
        if (used[j] || !fits(lost[j], hole[k])) continue;
        any = true;
        used[j] = 1;
        commit_at[hole[k]] = lost[j];
        if (explain(k + 1, used)) return true;
        used[j] = 0;
        if (problems && failed_at < hole[k]) return false;
    }
    if (!any) {
        listen();
        violation(NONE, hole[k], "a commit that nobody made");
        hear();
    }
    return false;
}

static void report(void) {
    uint64_t commits = 0, by_kind[N_OPS] = {0};
    for (uint64_t v = 1; v <= last_version; v++) commits += commit_at[v] != NONE;
    for (int i = 0; i < n_ops; i++) by_kind[op[i]->kind]++;
    printf("%d operations (", n_ops);
    for (int k = 0; k < N_OPS; k++) printf("%s%" PRIu64 " %s", k ? ", " : "", by_kind[k], kinds[k]);
    printf("); %" PRIu64 " commits, %" PRIu64 " of them by %d that were killed; %ld judged, %" PRIu64 " not (a past with a loop), %ld writes gave way, %ld snapshots expired, %ld orders tried\n",
           commits, n_holes, n_lost, n_judged, n_unjudged, n_refused, n_expired, n_orders);
}

int main(int argc, char **argv) {
    if (argc < 2) return 2;
    if (argc > 2) most_problems = atol(argv[2]);
    int bad = load(argv[1]);
    if (bad) return bad;
    low = memory((size_t)n_ops, sizeof *low, 0);
    listen();
    check_real_time();
    place_all();
    bool serial = hear() && explain(0, memory((size_t)n_lost, 1, 0));
    if (!serial && said) fputs(said, stdout);
    if (n_orders >= MOST_ORDERS) printf("the killed may have committed in more than %d orders; these were tried\n", MOST_ORDERS);
    report();
    return !serial;
}
