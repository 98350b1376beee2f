/* SPDX-License-Identifier: Apache-2.0
 *
 * Log-linear histogram, as in HdrHistogram: 128 buckets per power of two, so a value is known to 0.8 %, from 1 ns to an
 * hour.  Recording is a shift and an increment; it belongs to one thread.
 */
#ifndef SHMTF_BENCH_HISTOGRAM_H
#define SHMTF_BENCH_HISTOGRAM_H

#include <stddef.h>
#include <stdint.h>

enum { HISTOGRAM_SUB_BITS = 7, HISTOGRAM_MAX_BITS = 42, HISTOGRAM_BUCKETS = (HISTOGRAM_MAX_BITS - HISTOGRAM_SUB_BITS + 1) << HISTOGRAM_SUB_BITS };

typedef struct {
    uint64_t count, sum, max;
    uint64_t bucket[HISTOGRAM_BUCKETS];
} bench_histogram;

static inline size_t bench_histogram_bucket(uint64_t value) {
    if (value >> HISTOGRAM_MAX_BITS) return HISTOGRAM_BUCKETS - 1;
    if (value >> (HISTOGRAM_SUB_BITS + 1) == 0) return (size_t)value;
    unsigned shift = 63 - (unsigned)__builtin_clzll(value) - HISTOGRAM_SUB_BITS;
    return ((size_t)shift << HISTOGRAM_SUB_BITS) + (size_t)(value >> shift);
}

/* Negative values count as 0: two clocks were read in the wrong order by a hair. */
static inline void bench_histogram_record(bench_histogram *h, int64_t value) {
    uint64_t v = value > 0 ? (uint64_t)value : 0;
    h->count++;
    h->sum += v;
    if (v > h->max) h->max = v;
    h->bucket[bench_histogram_bucket(v)]++;
}

/* Middle of a bucket's range. */
double bench_histogram_value(size_t bucket);
void bench_histogram_add(bench_histogram *to, const bench_histogram *from);
/* Smallest value that at least the share q of all values does not exceed; 0 if there are none. */
double bench_histogram_quantile(const bench_histogram *h, double q);

#endif
