/* SPDX-License-Identifier: Apache-2.0 */
#define _GNU_SOURCE
#include "verify.h"

#include <math.h>
#include <stdlib.h>

#include "core/pose.h"

enum { LOOKUPS = 64 };
static const double TOLERANCE = 1e-9; /* per edge, in metres and in components of the quaternion */

static double distance(const shmtf_pose *a, const shmtf_pose *b) {
    double sign = a->qx * b->qx + a->qy * b->qy + a->qz * b->qz + a->qw * b->qw < 0 ? -1 : 1;
    double d[] = {a->x - b->x,          a->y - b->y,          a->z - b->z,         a->qx - sign * b->qx,
                  a->qy - sign * b->qy, a->qz - sign * b->qz, a->qw - sign * b->qw};
    double most = 0;
    for (size_t i = 0; i < sizeof d / sizeof *d; i++) most = isnan(d[i]) ? INFINITY : fmax(most, fabs(d[i]));
    return most;
}

static bool is_right(const bench_protocol *p, bench_client *c, const bench_shape *shape, uint32_t first, int64_t stamp,
                     int64_t *stamps, char error[BENCH_ERROR_SIZE]) {
    shmtf_pose found, expected = pose_identity();
    if (!p->read(c, first, &found, stamps, error)) return false;
    for (uint32_t i = 1; i <= shape->read_len; i++) {
        shmtf_pose edge = bench_written_pose(first + i);
        expected = pose_compose(&expected, &edge);
        if (stamps[i - 1] == stamp) continue;
        return snprintf(error, BENCH_ERROR_SIZE, "wrong answer: frame %u has stamp %lld, not %lld", first + i,
                        (long long)stamps[i - 1], (long long)stamp), false;
    }
    double off = distance(&found, &expected);
    if (off <= TOLERANCE * shape->read_len) return true;
    return snprintf(error, BENCH_ERROR_SIZE, "wrong answer: frame %u from %u is off by %g", first, first + shape->read_len, off), false;
}

bool bench_verify(const bench_protocol *p, const char *place, const bench_shape *shape, char error[BENCH_ERROR_SIZE]) {
    uint32_t n = (shape->n_frames - 1) / shape->write_len * shape->write_len; /* what whole updates reach */
    int64_t stamp = bench_now_ns(), *stamps = calloc(shape->read_len, sizeof *stamps);
    bench_client *c = stamps ? p->attach(place, shape, error) : NULL;
    bool ok = c != NULL;
    for (uint32_t first = 0; ok && first < n; first += shape->write_len) ok = p->write(c, first, stamp, first / shape->write_len % 2, error);
    for (uint32_t i = 0; ok && n >= shape->read_len && i < LOOKUPS; i++)
        ok = is_right(p, c, shape, (uint32_t)((uint64_t)(n - shape->read_len) * i / (LOOKUPS - 1)), stamp, stamps, error);
    if (c) p->detach(c);
    free(stamps);
    return ok;
}
