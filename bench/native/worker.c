/* SPDX-License-Identifier: Apache-2.0 */
#define _GNU_SOURCE
#include "worker.h"

#include <signal.h>
#include <stdlib.h>
#include <sys/prctl.h>
#include <unistd.h>

#include "rates.h"

typedef struct {
    bench_control *control;
    bench_worker *w;
    const bench_job *job;
    bench_phase phase;
    const bench_protocol *protocol;
    bench_client *client;
    uint32_t index;
    bench_random random;
    uint32_t first_low, n_first; /* lookups start at one of n_first frames */
    int64_t *stamps;
    uint64_t read_retries0, write_retries0, cpu0;
    bool measuring;
    uint32_t until_check;
} worker;

static void sleep_until(int64_t ns) {
    struct timespec t = {ns / 1000000000, ns % 1000000000};
    while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &t, NULL)) {}
}

static void begin_to_measure(worker *k) {
    k->measuring = true;
    k->cpu0 = (uint64_t)bench_clock_ns(CLOCK_THREAD_CPUTIME_ID);
    k->protocol->retries(k->client, &k->read_retries0, &k->write_retries0);
}

static bool read_once(worker *k, uint32_t first, bool check, char *error) {
    shmtf_pose out;
    return k->protocol->read(k->client, first, &out, check ? k->stamps : NULL, error);
}

/* An operation on the frames after `first`, begun at begin_ns.  Returns when it ended. */
static int64_t operate(worker *k, bool reads, uint32_t first, int64_t begin_ns) {
    const bench_shape *shape = &k->job->shape;
    char error[BENCH_ERROR_SIZE] = "";
    bool ok, check = false;
    if (reads) {
        check = k->job->check_every && k->until_check-- == 0;
        if (check) k->until_check = k->job->check_every - 1;
        ok = read_once(k, first, check, error);
    } else {
        ok = k->protocol->write(k->client, first, bench_update_stamp(shape, first, begin_ns), k->job->opposite, error);
    }
    int64_t now = bench_now_ns();
    if (!ok) bench_worker_fail(k->w, error);
    if (!ok || !k->measuring || now >= k->phase.end_ns) return now;
    reads ? k->w->reads++ : k->w->writes++;
    bench_histogram_record(reads ? &k->w->read_ns : &k->w->write_ns, now - begin_ns);
    if (!check) return now;
    bench_worker_check(k->w, shape, first, k->stamps, now, k->phase.start_ns);
    return bench_now_ns();
}

static bool is_over(const worker *k, int64_t now) { return now >= k->phase.end_ns || load32_relaxed(&k->control->stop); }

static void run_uniform(worker *k) {
    const bench_shape *shape = &k->job->shape;
    int64_t period = k->job->frequency > 0 ? (int64_t)(1e9 / k->job->frequency) : 0, now = bench_now_ns();
    while (!is_over(k, now)) {
        if (!k->measuring && now >= k->phase.measure_ns) begin_to_measure(k);
        bool reads = bench_next_is_read(&k->phase, k->index, &k->random);
        uint32_t first = reads ? k->first_low + bench_random_below(&k->random, k->n_first)
                               : bench_random_below(&k->random, shape->n_frames - shape->write_len);
        now = operate(k, reads, first, now);
        if (!period) continue;
        sleep_until(now + period);
        now = bench_now_ns();
    }
}

static void write_at_rates(worker *k) {
    const bench_phase *p = &k->phase;
    rates r;
    if (!rates_make(&r, &k->job->shape, k->index - p->n_readers, p->n_active - p->n_readers, p->start_ns, p->measure_ns)) {
        bench_worker_fail(k->w, "no memory");
        return;
    }
    for (int64_t now = bench_now_ns(); r.n && !is_over(k, now);) {
        if (!k->measuring && now >= p->measure_ns) begin_to_measure(k);
        if (r.heap[0].due_ns > now) {
            sleep_until(r.heap[0].due_ns < p->end_ns ? r.heap[0].due_ns : p->end_ns);
            now = bench_now_ns();
            continue;
        }
        now = operate(k, false, r.heap[0].child - 1, now);
        rates_written(&r, &k->job->shape, now);
    }
    rates_free(&r);
}

/* Lookups of `mixed-rate` span the slow edge, and begin when every edge has been written in this phase. */
static void choose_lookups(worker *k) {
    const bench_shape *shape = &k->job->shape;
    uint32_t n = shape->n_frames - shape->read_len, slow = rates_slow(shape);
    k->first_low = !k->job->mixed_rate || slow < shape->read_len ? 0 : slow - shape->read_len;
    k->n_first = (k->job->mixed_rate && slow < n ? slow : n) - k->first_low;
}

static void run_phase(worker *k) {
    bool writes_at_rates = k->job->mixed_rate && k->index >= k->phase.n_readers;
    bench_worker_begin(k->control, k->index);
    k->protocol = k->job->protocols[k->phase.protocol];
    k->random.state = (k->phase.seed + k->index) * 0x9e3779b97f4a7c15ull | 1;
    k->measuring = false;
    k->until_check = 0;
    if (k->phase.pinned) bench_pin(bench_cpu_allowed((int)k->index));
    else bench_unpin();
    choose_lookups(k);
    sleep_until(k->job->mixed_rate && !writes_at_rates ? k->phase.measure_ns : k->phase.start_ns);
    if (writes_at_rates) write_at_rates(k);
    else run_uniform(k);
    uint64_t cpu = 0, reads = 0, writes = 0;
    if (k->measuring) {
        cpu = (uint64_t)bench_clock_ns(CLOCK_THREAD_CPUTIME_ID) - k->cpu0;
        k->protocol->retries(k->client, &reads, &writes);
        reads -= k->read_retries0;
        writes -= k->write_retries0;
    }
    bench_worker_end(k->control, k->index, reads, writes, cpu);
}

/* The first write claims what a writer needs, and opens it by name. */
static bool attach_all(const bench_job *job, bench_client **clients, bench_worker *w) {
    for (uint32_t i = 0; i < job->n_protocols; i++) {
        int64_t stamp = bench_update_stamp(&job->shape, 0, bench_now_ns());
        clients[i] = job->protocols[i]->attach(job->places[i], &job->shape, w->error);
        if (!clients[i] || !job->protocols[i]->write(clients[i], 0, stamp, false, w->error)) return false;
    }
    return true;
}

bool bench_work(bench_control *c, uint32_t index, const bench_job *job) {
    bench_client *clients[BENCH_MAX_PROTOCOLS] = {NULL};
    worker k = {.control = c, .w = &c->worker[index], .job = job, .index = index};
    k.stamps = calloc(job->shape.read_len, sizeof *k.stamps);
    bool ok = k.stamps && attach_all(job, clients, k.w);
    bench_worker_enter(k.w, ok);
    int64_t number = 0, next;
    while (ok && (next = bench_control_next(c, (uint32_t)number)) >= 0) {
        if (!next) continue;
        number = next;
        k.phase = c->phase;
        if (index >= k.phase.n_active) continue;
        k.client = clients[k.phase.protocol];
        run_phase(&k);
    }
    for (uint32_t i = 0; i < job->n_protocols; i++)
        if (clients[i]) job->protocols[i]->detach(clients[i]);
    free(k.stamps);
    return ok;
}

void bench_die_with(int parent) {
    prctl(PR_SET_PDEATHSIG, SIGKILL);
    if (getppid() != parent) _exit(1); /* it was gone already */
}
