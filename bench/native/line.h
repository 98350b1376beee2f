/* SPDX-License-Identifier: Apache-2.0
 *
 * How long a cache line takes from one core to another and back: the unit in which every two-core number is to be read.
 */
#ifndef SHMTF_BENCH_LINE_H
#define SHMTF_BENCH_LINE_H

#include "common.h"

/* ns per round trip between two CPUs; negative: they could not be used. */
double bench_line_round_trip(int cpu_a, int cpu_b);

#endif
