/* SPDX-License-Identifier: Apache-2.0
 *
 * Assertions for C tests.  A failed one is printed and counted; check_result() is what main returns.
 */
#ifndef SHMTF_TESTS_CHECK_H
#define SHMTF_TESTS_CHECK_H

#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>

static long check_count, check_failures;

static inline int check_that(int ok, const char *file, int line, const char *what) {
    check_count++;
    if (!ok && ++check_failures <= 20) fprintf(stderr, "%s:%d: %s\n", file, line, what);
    return ok;
}
static inline void check_equal(long long got, long long want, const char *file, int line, const char *what) {
    if (check_that(got == want, file, line, what) || check_failures > 20) return;
    fprintf(stderr, "    got %lld, want %lld\n", got, want);
}
static inline int check_result(const char *name) {
    printf("%s: %ld checks, %ld failures\n", name, check_count, check_failures);
    return check_failures != 0;
}

#define CHECK(condition) check_that(!!(condition), __FILE__, __LINE__, #condition)
#define EQUAL(got, want) check_equal((long long)(got), (long long)(want), __FILE__, __LINE__, #got " == " #want)
/* For what must hold or the rest of the test means nothing. */
#define NEED(condition) \
    if (!CHECK(condition)) exit(1)

static inline uint64_t check_random(uint64_t *state) {
    uint64_t x = *state;
    x ^= x << 13;
    x ^= x >> 7;
    x ^= x << 17;
    return *state = x;
}
static inline double check_uniform(uint64_t *state) { return (double)(check_random(state) >> 11) * 0x1p-53; }

#endif
