/* SPDX-License-Identifier: Apache-2.0 */
#define _GNU_SOURCE
#include "rates.h"

#include <stdlib.h>

enum { LEAST_HZ = 30, MOST_HZ = 200 };

/* The same for every process and every run, and without a pattern along the chain. */
static uint32_t scatter(uint32_t child) { return child * 2654435761u >> 8; }

double rates_of(const bench_shape *shape, uint32_t child) {
    return child == rates_slow(shape) ? 1 : LEAST_HZ + scatter(child) % (MOST_HZ - LEAST_HZ + 1);
}

static void sink(rates *r, uint32_t at) {
    for (uint32_t child; (child = 2 * at + 1) < r->n; at = child) {
        if (child + 1 < r->n && r->heap[child + 1].due_ns < r->heap[child].due_ns) child++;
        if (r->heap[at].due_ns <= r->heap[child].due_ns) return;
        rates_edge moved = r->heap[at];
        r->heap[at] = r->heap[child];
        r->heap[child] = moved;
    }
}

bool rates_make(rates *r, const bench_shape *shape, uint32_t index, uint32_t n_writers, int64_t start_ns, int64_t measure_ns) {
    *r = (rates){calloc(shape->n_frames / n_writers + 1, sizeof *r->heap), 0, start_ns};
    if (!r->heap) return false;
    uint32_t slow = rates_slow(shape);
    for (uint32_t child = 1 + index; child < shape->n_frames; child += n_writers)
        if (child != slow) r->heap[r->n++] = (rates_edge){start_ns, child, false};
    if ((slow - 1) % n_writers == index) r->heap[r->n++] = (rates_edge){start_ns + (measure_ns - start_ns) / 2, slow, true};
    return true;
}

void rates_free(rates *r) { free(r->heap); }

void rates_written(rates *r, const bench_shape *shape, int64_t now_ns) {
    rates_edge *e = &r->heap[0];
    int64_t period = (int64_t)(1e9 / rates_of(shape, e->child));
    if (!e->written) e->due_ns = r->start_ns - (int64_t)(scatter(~e->child) % 1000) * period / 1000;
    e->written = true;
    if (e->due_ns <= now_ns) e->due_ns += ((now_ns - e->due_ns) / period + 1) * period;
    sink(r, 0);
}
