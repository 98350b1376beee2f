/* SPDX-License-Identifier: Apache-2.0
 *
 * The rules of watch.c, each broken once in a process of its own that must end by it and say which one it was: a fuzzer
 * whose checks cannot fail proves nothing.  Tier: test.
 */
#define _GNU_SOURCE
#include "fuzz.h"

#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/wait.h>
#include <unistd.h>

#include "../native/support/check.h"

const char *const fuzz_target = "fuzz_rules";
static shmtf_store *h;

static void outside(void) { shmtf_step(SHMTF_STEP_LOAD, (unsigned char *)h->base + h->s.geo.size_bytes); }
static void before(void) { shmtf_step(SHMTF_STEP_LOAD, (unsigned char *)h->base - 8); }
static void header(void) { shmtf_step(SHMTF_STEP_STORE, (unsigned char *)h->base + 8); }
static void stores(void) { shmtf_step(SHMTF_STEP_STORE, &h->s.global->commit); }
static void endless(void) {
    for (;;) shmtf_step(SHMTF_STEP_LOAD, &h->s.global->commit);
}
static void answers(void) { watch_answer(SHMTF_TIMEOUT, NULL); }
static void differs(void) { watch_answer(SHMTF_CORRUPT, &(shmtf_error){.status = SHMTF_LOOKUP}); }
static void unended(void) {
    shmtf_error e = {.status = SHMTF_CORRUPT};
    memset(e.child, 'n', sizeof e.child);
    watch_answer(SHMTF_CORRUPT, &e);
}
static void nothing(void) { watch_answer(SHMTF_OK, NULL); }

static const struct {
    const char *says;
    call_kind kind;
    void (*breaks)(void);
} rules[] = {
    {"an access outside of the store", CALL_READ, outside},
    {"an access outside of the store", CALL_WRITE, before},
    {"a store into the header", CALL_WRITE, header},
    {"a read that stores", CALL_READ, stores},
    {"no end: more accesses than the capacities explain", CALL_WRITE, endless},
    {"an answer that is not documented", CALL_WRITE, answers},
    {"an error that says something else than the answer", CALL_READ, differs},
    {"a text without an end", CALL_READ, unended},
    {"", CALL_WRITE, nothing},
};

/* What it says before it ends; its end in *status. */
static void run_apart(size_t i, char *said, size_t size, int *status) {
    int ends[2];
    NEED(pipe(ends) == 0);
    pid_t child = fork();
    if (child == 0) {
        dup2(ends[1], STDERR_FILENO);
        h->forks = peer_fork_count();
        watch_call("the call", rules[i].kind);
        rules[i].breaks();
        _exit(0);
    }
    close(ends[1]);
    size_t n = 0;
    for (ssize_t got; n < size - 1 && (got = read(ends[0], said + n, size - 1 - n)) > 0;) n += (size_t)got;
    said[n] = 0;
    close(ends[0]);
    NEED(waitpid(child, status, 0) == child);
}

int main(void) {
    unsigned n;
    const uint8_t input[8] = {0};
    take_from(input, sizeof input);
    NEED(h = bench_attach(bench_load(images_all(&n), false)->fd, 0));
    CHECK(n > 100);
    for (size_t i = 0; i < sizeof rules / sizeof *rules; i++) {
        char said[4096];
        int status;
        run_apart(i, said, sizeof said, &status);
        bool holds = !rules[i].says[0];
        CHECK(holds ? WIFEXITED(status) && WEXITSTATUS(status) == 0 : strstr(said, rules[i].says) != NULL);
        CHECK(holds || !WIFEXITED(status) || WEXITSTATUS(status) != 0);
    }
    watch_nothing();
    shmtf_close(h);
    return check_result("fuzz_rules");
}
