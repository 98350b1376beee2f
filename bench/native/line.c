/* SPDX-License-Identifier: Apache-2.0 */
#define _GNU_SOURCE
#include "line.h"

#include <pthread.h>
#include <sched.h>
#include <stdalign.h>

#include "segment/atomic.h"

enum { TRIPS = 20000, WARM_UP = 2000, PATIENCE = 200 };

typedef struct {
    alignas(128) shmtf_word ball;
    alignas(128) int cpu[2];
    bool pinned[2];
    double ns;
} court;

/* A core that another process has taken answers late; let it run. */
static void wait_for(court *c, uint64_t value) {
    for (uint64_t spins = 1; load_acquire(&c->ball) != value; spins++)
        if (spins % PATIENCE == 0) sched_yield();
}

static void *answer(void *argument) {
    court *c = argument;
    c->pinned[1] = bench_pin(c->cpu[1]) >= 0;
    for (uint64_t i = 0; i < TRIPS; i++) {
        wait_for(c, 2 * i + 1);
        store_release(&c->ball, 2 * i + 2);
    }
    return NULL;
}

static void *ask(void *argument) {
    court *c = argument;
    int64_t begin = 0;
    c->pinned[0] = bench_pin(c->cpu[0]) >= 0;
    for (uint64_t i = 0; i < TRIPS; i++) {
        if (i == WARM_UP) begin = bench_now_ns();
        store_release(&c->ball, 2 * i + 1);
        wait_for(c, 2 * i + 2);
    }
    c->ns = (double)(bench_now_ns() - begin) / (TRIPS - WARM_UP);
    return NULL;
}

double bench_line_round_trip(int cpu_a, int cpu_b) {
    court c = {.cpu = {cpu_a, cpu_b}};
    pthread_t server, returner; /* both of their own, so that the caller stays on the CPUs it was on */
    if (pthread_create(&returner, NULL, answer, &c)) return -1;
    if (pthread_create(&server, NULL, ask, &c)) return ask(&c), pthread_join(returner, NULL), -1;
    pthread_join(server, NULL);
    pthread_join(returner, NULL);
    return c.pinned[0] && c.pinned[1] ? c.ns : -1;
}
