/* SPDX-License-Identifier: Apache-2.0
 *
 * A single step costs some 20 us, most of it in the kernel, so to step to the n-th instruction for every n is quadratic.
 * Runs from one image take the same course, but for what a clock says; so run at full speed to a breakpoint shortly before n, at an address
 * that has come a few times only, and step from there.  Where there is no such short cut (another processor): step.
 */
#define _GNU_SOURCE
#include "ptraced.h"

#include <errno.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/ptrace.h>
#include <sys/user.h>
#include <sys/wait.h>

enum { WINDOW = 400, HIT_COST = 3 };

extern const unsigned char __executable_start, etext;

course *course_new(void) {
    course *c = calloc(1, sizeof *c);
    if (!c) die("no memory");
    c->at = shared_memory(MOST_INSTRUCTIONS * sizeof *c->at);
    c->nth = shared_memory(MOST_INSTRUCTIONS * sizeof *c->nth);
    c->from = shared_memory(MOST_INSTRUCTIONS * sizeof *c->from);
    return c;
}

static void wait_for_trap(pid_t pid) {
    int status = wait_for(pid, 0);
    if (!WIFSTOPPED(status)) die("the writer ended in the middle: status %#x", (unsigned)status);
}

bool ptraced_step(pid_t pid, const _Atomic int *done) {
    if (*done) return false;
    if (ptrace(PTRACE_SINGLESTEP, pid, NULL, NULL)) die("a step is refused: %s", strerror(errno));
    wait_for_trap(pid);
    return true;
}

#if defined(__x86_64__)
static uint64_t address_of(pid_t pid) {
    return (uint64_t)ptrace(PTRACE_PEEKUSER, pid, (void *)offsetof(struct user_regs_struct, rip), NULL);
}
static void poke(pid_t pid, uint64_t address, uint64_t word) {
    if (ptrace(PTRACE_POKETEXT, pid, (void *)address, (void *)word)) die("no breakpoint: %s", strerror(errno));
}

/* At full speed until the address comes for the `nth` time. */
static bool run_until(pid_t pid, uint64_t address, uint32_t nth, const _Atomic int *done) {
    uint64_t code = (uint64_t)ptrace(PTRACE_PEEKTEXT, pid, (void *)address, NULL);
    for (uint32_t i = 0; i < nth; i++) {
        if (i) ptraced_step(pid, done); /* over the instruction itself */
        poke(pid, address, (code & ~0xffull) | 0xcc);
        if (ptrace(PTRACE_CONT, pid, NULL, NULL)) die("it does not go on: %s", strerror(errno));
        wait_for_trap(pid);
        if (address_of(pid) != address + 1) return false; /* it did not come by */
        poke(pid, address, code);
        ptrace(PTRACE_POKEUSER, pid, (void *)offsetof(struct user_regs_struct, rip), (void *)address);
    }
    return true;
}
#else
static uint64_t address_of(pid_t pid) { return (void)pid, 0; }
static bool run_until(pid_t pid, uint64_t address, uint32_t nth, const _Atomic int *done) { return (void)pid, (void)address, (void)nth, (void)done, false; }
#endif

void course_note(course *c, uint64_t i, pid_t pid) {
    if (i < MOST_INSTRUCTIONS) c->at[i] = address_of(pid);
}

void course_end(course *c, uint64_t n, double seconds) {
    const uint64_t text = (uint64_t)(uintptr_t)&__executable_start, end = (uint64_t)(uintptr_t)&etext;
    uint32_t *come = shared_memory((end - text) * sizeof *come); /* not from the heap: its state is a part of the course */
    double sum = 0;
    if (n >= MOST_INSTRUCTIONS) die("%llu instructions are too many", (unsigned long long)n);
    c->n = n;
    c->each_s = seconds / (double)(n ? n : 1);
    for (uint64_t i = 0; i <= n; i++) {
        bool ours = i && c->at[i] >= text && c->at[i] < end && c->at[i] != c->at[0];
        c->nth[i] = ours ? ++come[c->at[i] - text] : 0;
        uint64_t best = i; /* steps from the start */
        c->from[i] = 0;
        for (uint64_t m = i; m > 0 && i - m < WINDOW; m--) {
            uint64_t cost = (uint64_t)c->nth[m] * HIT_COST + (i - m);
            if (c->nth[m] && cost < best) best = cost, c->from[i] = (uint32_t)m;
        }
        sum += (double)best;
    }
    c->mean_cost = sum / (double)(n + 1);
    munmap(come, (end - text) * sizeof *come);
}

bool course_run_to(const course *c, uint64_t n, pid_t pid, const _Atomic int *done) {
    uint64_t from = c->from[n];
    if (from && !run_until(pid, c->at[from], c->nth[from], done)) return false;
    for (uint64_t i = from; i < n; i++)
        if (!ptraced_step(pid, done)) return false;
    return address_of(pid) == c->at[n];
}
