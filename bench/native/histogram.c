/* SPDX-License-Identifier: Apache-2.0 */
#include "histogram.h"

#include <math.h>

double bench_histogram_value(size_t bucket) {
    if (bucket < 2u << HISTOGRAM_SUB_BITS) return (double)bucket;
    size_t shift = (bucket >> HISTOGRAM_SUB_BITS) - 1;
    uint64_t low = ((uint64_t)bucket - ((uint64_t)shift << HISTOGRAM_SUB_BITS)) << shift;
    return (double)low + (double)((1ull << shift) - 1) / 2;
}

void bench_histogram_add(bench_histogram *to, const bench_histogram *from) {
    to->count += from->count;
    to->sum += from->sum;
    if (from->max > to->max) to->max = from->max;
    for (size_t i = 0; i < HISTOGRAM_BUCKETS; i++) to->bucket[i] += from->bucket[i];
}

double bench_histogram_quantile(const bench_histogram *h, double q) {
    uint64_t wanted = (uint64_t)ceil(q * (double)h->count), seen = 0;
    if (!h->count) return 0;
    if (wanted < 1) wanted = 1;
    for (size_t i = 0; i < HISTOGRAM_BUCKETS; i++) {
        seen += h->bucket[i];
        if (seen < wanted) continue;
        double value = bench_histogram_value(i);
        return value < (double)h->max ? value : (double)h->max;
    }
    return (double)h->max;
}
