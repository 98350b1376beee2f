/* SPDX-License-Identifier: Apache-2.0 */
#define _GNU_SOURCE
#include <errno.h>
#include <pthread.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "verify.h"
#include "worker.h"

typedef struct {
    bench_control *control;
    const bench_job *job;
    uint32_t index;
    pthread_t thread;
} hosted;

static void *run(void *given) {
    hosted *h = given;
    bench_work(h->control, h->index, h->job);
    return NULL;
}

static bool fail_from(bench_control *c, uint32_t first, const char *why) {
    for (uint32_t i = first; i < c->n_workers; i++) {
        snprintf(c->worker[i].error, BENCH_ERROR_SIZE, "%s", why);
        bench_worker_enter(&c->worker[i], false);
    }
    return false;
}

static void wait_until_attached(const bench_control *c) {
    const struct timespec turn = {0, 1000000};
    for (uint32_t i = 0; i < c->n_workers; i++)
        while (load32_acquire(&c->worker[i].state) == WORKER_STARTING) nanosleep(&turn, NULL);
}

static void run_all(bench_control *c, const bench_job *job, hosted *all) {
    uint32_t n = 0;
    bench_cpu_allowed(0); /* remembered before there are threads */
    for (int failed = 0; n < c->n_workers && !failed; n += !failed) {
        all[n] = (hosted){c, job, n, 0};
        failed = pthread_create(&all[n].thread, NULL, run, &all[n]);
        if (failed) fail_from(c, n, strerror(failed));
    }
    wait_until_attached(c);
    job->protocols[0]->remove(job->places[0]); /* nothing is left even where this process is killed */
    while (n-- > 0) pthread_join(all[n].thread, NULL); /* they leave when the coordinator says so */
}

bool bench_host(bench_control *c, bench_job *job) {
    const bench_protocol *p = job->protocols[0];
    char place[BENCH_PLACE_SIZE], error[BENCH_ERROR_SIZE] = "";
    snprintf(place, sizeof place, "%s", job->places[0]);
    if (!p->create(place, &job->shape, error)) return fail_from(c, 0, error);
    job->places[0] = place;
    hosted *all = calloc(c->n_workers, sizeof *all);
    bool ok = bench_verify(p, place, &job->shape, error) && all;
    if (ok) {
        run_all(c, job, all);
    } else {
        p->remove(place);
        fail_from(c, 0, all ? error : "no memory");
    }
    free(all);
    return ok;
}
