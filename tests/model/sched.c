/* SPDX-License-Identifier: Apache-2.0 */
#define _GNU_SOURCE
#include "sched.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "segment/atomic.h"
#include "segment/failpoint.h"

enum { STACK_BYTES = 1 << 16, MOST_DEPTH = 1 << 14, MOST_SHOWN = 64, CRASH = 16 };

#if defined(__x86_64__)
typedef void *context;
void sched_switch(void **save, void *to);
__asm__(".text\n.globl sched_switch\nsched_switch:\n push %rbp\n push %rbx\n push %r12\n push %r13\n push %r14\n push %r15\n"
        " mov %rsp,(%rdi)\n mov %rsi,%rsp\n pop %r15\n pop %r14\n pop %r13\n pop %r12\n pop %rbx\n pop %rbp\n ret\n");
#define SWITCH(save, to) sched_switch(&(save), (to))
#else
#include <ucontext.h>
typedef ucontext_t context;
#define SWITCH(save, to) swapcontext(&(save), &(to))
#endif

typedef enum { RUNNING, DONE, DEAD } thread_state;

static char stacks[SCHED_THREADS][STACK_BYTES] __attribute__((aligned(64)));
static context contexts[SCHED_THREADS], scheduler;
static thread_state state[SCHED_THREADS];
static bool at_store[SCHED_THREADS], waits[SCHED_THREADS];
static int current = -1;
static const sched_program *program;
static int choice[MOST_DEPTH], n_options[MOST_DEPTH], ran[MOST_DEPTH], depth, explored;
static long executions;

bool sched_is_dead(int thread) { return state[thread] == DEAD; }
bool sched_is_done(int thread) { return state[thread] == DONE; }
int sched_current(void) { return current; }

void sched_fail(const char *what) {
    printf("VIOLATION: %s\n  after %ld executions; the schedule, as thread x steps (! crash):", what, executions);
    for (int i = 0, n = 1, shown = 0; i < depth && shown < MOST_SHOWN; i++, n++) {
        if (i + 1 < depth && ran[i + 1] == ran[i]) continue;
        shown++;
        if (ran[i] >= CRASH) printf(" %d!", ran[i] - CRASH);
        else printf(" %dx%d", ran[i], n);
        n = 0;
    }
    printf("\n");
    exit(1);
}

static void yield_to_scheduler(void) {
    int me = current;
    SWITCH(contexts[me], scheduler);
}

void shmtf_step(int kind, const void *word) {
    if (current < 0 || !program->is_point(word)) return;
    at_store[current] = kind == SHMTF_STEP_STORE;
    yield_to_scheduler();
}

void sched_wait(void) {
    if (current < 0) return;
    at_store[current] = false;
    waits[current] = true;
    yield_to_scheduler();
}

void shmtf_failpoint(const char *name) { (void)name; }

static void trampoline(void) {
    int me = current;
    program->body[me](me);
    state[me] = DONE;
    yield_to_scheduler();
    abort();
}

static void start(int i) {
    state[i] = RUNNING;
    at_store[i] = waits[i] = false;
#if defined(__x86_64__)
    void **p = (void **)(void *)(stacks[i] + STACK_BYTES - 64);
    void (*entry)(void) = trampoline;
    *--p = NULL;
    --p;
    memcpy(p, &entry, sizeof entry);
    for (int k = 0; k < 6; k++) *--p = NULL;
    contexts[i] = p;
#else
    getcontext(&contexts[i]);
    contexts[i].uc_stack.ss_sp = stacks[i];
    contexts[i].uc_stack.ss_size = STACK_BYTES;
    contexts[i].uc_link = NULL;
    makecontext(&contexts[i], trampoline, 0);
#endif
}

static bool chosen(const sched_bounds *b, int last) {
    const uint64_t odd = 0x9e3779b97f4a7c15ull, more = 0xbf58476d1ce4e5b9ull;
    uint64_t h = ((uint64_t)depth * odd ^ b->salt ^ (uint64_t)last << 40) * more;
    return b->stride <= 1 || (h >> 33) % b->stride == 0;
}

/* What may happen next: the same thread goes on, another one does, or it dies before its store. */
static int options(const sched_bounds *b, int last, int preempted, int crashed, int out[2 * SCHED_THREADS]) {
    int n = 0;
    bool goes_on = last >= 0 && state[last] == RUNNING && !waits[last], here = chosen(b, last);
    if (goes_on) out[n++] = last;
    for (int i = 0; i < program->n_threads; i++)
        if (state[i] == RUNNING && !waits[i] && i != last && (!goes_on || (here && preempted < b->preemptions))) out[n++] = i;
    if (goes_on && here && crashed < b->crashes && at_store[last] && program->may_crash[last]) out[n++] = CRASH + last;
    return n;
}

/* Something is about to change, by `but`: the others may look again. */
static bool wake_all(int but) {
    bool any = false;
    for (int i = 0; i < program->n_threads; i++)
        if (waits[i] && i != but) waits[i] = false, any |= state[i] == RUNNING;
    return any;
}

static void run_one(const sched_bounds *b, sched_result *r) {
    int last = -1, preempted = 0, crashed = 0, option[2 * SCHED_THREADS];
    depth = 0;
    program->reset();
    for (int i = 0; i < program->n_threads; i++) start(i);
    for (;;) {
        int n = options(b, last, preempted, crashed, option);
        if (!n && wake_all(-1)) continue;
        if (!n) break;
        if (depth == MOST_DEPTH) sched_fail("an execution does not end");
        if (depth >= explored) choice[depth] = 0, explored = depth + 1;
        n_options[depth] = n;
        int next = ran[depth] = option[choice[depth]];
        depth++;
        if (next >= CRASH) {
            state[last] = DEAD;
            last = -1;
            crashed++;
            r->crashes++;
            wake_all(-1);
            continue;
        }
        preempted += last >= 0 && state[last] == RUNNING && !waits[last] && next != last;
        if (at_store[next]) wake_all(next); /* two that wait and look must not keep each other awake */
        last = current = next;
        SWITCH(scheduler, contexts[next]);
        current = -1;
        program->stepped(next);
    }
    program->finish();
    r->executions = ++executions;
}

static double now(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + (double)t.tv_nsec * 1e-9;
}

sched_result sched_explore(const sched_program *p, const sched_bounds *b) {
    sched_result r = {0, 0, true};
    double until = now() + b->seconds;
    program = p;
    executions = 0;
    explored = 0;
    memset(choice, 0, sizeof choice);
    for (;;) {
        run_one(b, &r);
        int d = depth - 1;
        while (d >= 0 && choice[d] + 1 >= n_options[d]) d--;
        if (d < 0) break;
        choice[d]++;
        explored = d + 1;
        if (b->seconds > 0 && r.executions % 1024 == 0 && now() > until) {
            r.complete = false;
            break;
        }
    }
    return r;
}
