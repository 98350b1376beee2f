/* SPDX-License-Identifier: Apache-2.0 */
#define _GNU_SOURCE
#include "common.h"

#include <math.h>
#include <sched.h>
#include <stdbool.h>
#include <stdlib.h>

shmtf_pose bench_pose(uint32_t frame, int64_t stamp_ns) {
    double phase = 0.7 * frame, t = (double)(stamp_ns % 1000000000000) * 1e-9;
    double half = 0.25 * sin(3.1 * t + phase);
    double s = sin(half) / sqrt(3);
    shmtf_pose p = {0.1, 0.01 * sin(t + phase), 0, s, -s, s, cos(half)};
    return p;
}

/* As it was when first asked: pinning changes what the kernel says. */
static const cpu_set_t *allowed(void) {
    static cpu_set_t set;
    static bool known;
    if (!known) known = !sched_getaffinity(0, sizeof set, &set);
    return &set;
}

int bench_cpu_allowed(int n) {
    const cpu_set_t *set = allowed();
    int count = CPU_COUNT(set);
    if (n < 0) n += count;
    for (int cpu = 0; cpu < CPU_SETSIZE; cpu++)
        if (CPU_ISSET((size_t)cpu, set) && n-- == 0) return cpu;
    return -1;
}

int bench_pin(int cpu) {
    cpu_set_t one;
    allowed();
    if (cpu < 0 || cpu >= CPU_SETSIZE) return -1;
    CPU_ZERO(&one);
    CPU_SET((size_t)cpu, &one);
    return sched_setaffinity(0, sizeof one, &one) ? -1 : cpu;
}

void bench_unpin(void) { sched_setaffinity(0, sizeof *allowed(), allowed()); }

static int compare(const void *a, const void *b) {
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

bench_spread bench_spread_of(double *values, size_t n) {
    qsort(values, n, sizeof *values, compare);
    double median = n % 2 ? values[n / 2] : (values[n / 2 - 1] + values[n / 2]) / 2;
    return (bench_spread){median, values[0], values[n - 1]};
}
