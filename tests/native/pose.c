/* SPDX-License-Identifier: Apache-2.0
 * Poses against rotation matrices and slerp in long double. */
#include "core/pose.h"

#include <math.h>

#include "support/check.h"

typedef long double real;
typedef struct {
    real r[3][3], t[3];
} matrix;

static uint64_t seed = 88172645463325252ull;

static real distance(const shmtf_pose *a, const shmtf_pose *b) {
    real sign = (real)a->qx * b->qx + (real)a->qy * b->qy + (real)a->qz * b->qz + (real)a->qw * b->qw < 0 ? -1 : 1, most = 0;
    const real d[7] = {(real)a->x - b->x, (real)a->y - b->y, (real)a->z - b->z, (real)a->qx - sign * b->qx, (real)a->qy - sign * b->qy,
                       (real)a->qz - sign * b->qz, (real)a->qw - sign * b->qw};
    for (int i = 0; i < 7; i++) most = fmaxl(most, fabsl(d[i]));
    return most;
}

static shmtf_pose random_pose(double angle) {
    real a[3], n = 0;
    for (int i = 0; i < 3; i++) a[i] = (real)check_uniform(&seed) * 2 - 1, n += a[i] * a[i];
    n = sinl((real)angle / 2) / sqrtl(n);
    return (shmtf_pose){check_uniform(&seed) * 10 - 5, check_uniform(&seed) * 10 - 5, check_uniform(&seed) * 10 - 5,
                        (double)(a[0] * n), (double)(a[1] * n), (double)(a[2] * n), (double)cosl((real)angle / 2)};
}

static matrix to_matrix(const shmtf_pose *p) {
    real x = p->qx, y = p->qy, z = p->qz, w = p->qw;
    return (matrix){{{1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)},
                     {2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)},
                     {2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)}},
                    {p->x, p->y, p->z}};
}

static void check_compose(void) {
    for (int n = 0; n < 20000; n++) {
        shmtf_pose a = random_pose(check_uniform(&seed) * 6.2), b = random_pose(check_uniform(&seed) * 6.2), c = pose_compose(&a, &b);
        matrix ma = to_matrix(&a), mb = to_matrix(&b), mc = to_matrix(&c);
        for (int i = 0; i < 3; i++) {
            real t = ma.t[i];
            for (int j = 0; j < 3; j++) {
                real r = 0;
                for (int k = 0; k < 3; k++) r += ma.r[i][k] * mb.r[k][j];
                CHECK(fabsl(r - mc.r[i][j]) < 3e-15L);
                t += ma.r[i][j] * mb.t[j];
            }
            CHECK(fabsl(t - mc.t[i]) < 2e-14L);
        }
        shmtf_pose inverse = pose_inverse(&a), one = pose_compose(&inverse, &a), identity = pose_identity();
        CHECK(distance(&one, &identity) < 1e-14L);
        double v[3], w[3];
        pose_apply(&a, b.x, b.y, b.z, v);
        pose_apply(&inverse, v[0], v[1], v[2], w);
        CHECK(fabs(w[0] - b.x) < 1e-14 && fabs(w[1] - b.y) < 1e-14 && fabs(w[2] - b.z) < 1e-14);
    }
}

static shmtf_pose slerp_signed(const shmtf_pose *a, const shmtf_pose *b, real t, real sign) {
    const real p[4] = {a->qx, a->qy, a->qz, a->qw}, q[4] = {b->qx, b->qy, b->qz, b->qw};
    real minus = 0, plus = 0, r[4];
    for (int i = 0; i < 4; i++) {
        minus += (p[i] - sign * q[i]) * (p[i] - sign * q[i]);
        plus += (p[i] + sign * q[i]) * (p[i] + sign * q[i]);
    }
    real theta = 2 * atan2l(sqrtl(minus), sqrtl(plus)); /* exact for tiny angles too */
    real wa = theta > 0 ? sinl((1 - t) * theta) / sinl(theta) : 1 - t, wb = sign * (theta > 0 ? sinl(t * theta) / sinl(theta) : t);
    for (int i = 0; i < 4; i++) r[i] = wa * p[i] + wb * q[i];
    return (shmtf_pose){(double)((1 - t) * a->x + t * b->x), (double)((1 - t) * a->y + t * b->y), (double)((1 - t) * a->z + t * b->z),
                        (double)r[0], (double)r[1], (double)r[2], (double)r[3]};
}

static shmtf_pose slerp(const shmtf_pose *a, const shmtf_pose *b, real t, bool other_way) {
    real dot = (real)a->qx * b->qx + (real)a->qy * b->qy + (real)a->qz * b->qz + (real)a->qw * b->qw;
    return slerp_signed(a, b, t, (dot < 0) != other_way ? -1 : 1);
}

static void check_slerp(void) {
    static const double angles[] = {0, 1e-12, 1e-9, 1e-6, 1e-4, 1e-3, 0.01, 0.03, 0.0314, 0.0316, 0.0633, 0.1, 0.5, 1, 2, 3, 3.1, 3.14159, 3.141592653589793};
    real worst = 0;
    for (size_t k = 0; k < sizeof angles / sizeof *angles; k++)
        for (int n = 0; n < 2000; n++) {
            shmtf_pose a = random_pose(check_uniform(&seed) * 3), turn = random_pose(angles[k]), b = pose_compose(&a, &turn);
            pose_renormalise(&b);
            if (n & 1) b.qx = -b.qx, b.qy = -b.qy, b.qz = -b.qz, b.qw = -b.qw;
            double t = n % 5 == 0 ? 0 : n % 5 == 1 ? 1 : check_uniform(&seed);
            shmtf_pose got = pose_interpolate(&a, &b, t), want = slerp(&a, &b, t, false);
            if (angles[k] > 3.14159265 && distance(&got, &want) > 1e-10L) 
                want = slerp(&a, &b, t, true); /* half a turn: both ways are the shortest */
            real d = distance(&got, &want), norm = (real)got.qx * got.qx + (real)got.qy * got.qy + (real)got.qz * got.qz + (real)got.qw * got.qw;
            worst = fmaxl(worst, d);
            CHECK(fabsl(norm - 1) < 4e-15L);
            CHECK(t != 0 || distance(&got, &a) < 1e-15L);
            CHECK(t != 1 || distance(&got, &b) < 1e-15L);
        }
    printf("pose: worst slerp error %.2Lg\n", worst);
    CHECK(worst < 4e-15L);
}

static void check_normalise(void) {
    static const double factors[] = {1, 1.001, 0.999, 1.0049, 0.9951, -1, -1.004};
    double value;
    for (size_t k = 0; k < sizeof factors / sizeof *factors; k++)
        for (int n = 0; n < 500; n++) {
            shmtf_pose p = random_pose(check_uniform(&seed) * 6), before = p;
            p.qx *= factors[k], p.qy *= factors[k], p.qz *= factors[k], p.qw *= factors[k];
            CHECK(!pose_normalise(&p, &value));
            CHECK(p.qw >= 0 && fabs(p.qx * p.qx + p.qy * p.qy + p.qz * p.qz + p.qw * p.qw - 1) < 4e-16 * 3);
            CHECK(distance(&p, &before) < 1e-15L);
        }
    static const double bad[] = {0.98, 1.02, 0, 2};
    for (size_t k = 0; k < sizeof bad / sizeof *bad; k++) {
        shmtf_pose p = {0, 0, 0, 0, 0, 0, bad[k]};
        const char *why = pose_normalise(&p, &value);
        CHECK(why && fabs(value - bad[k]) < 1e-15);
    }
    double *component;
    for (int i = 0; i < 7; i++) {
        const double infinite[3] = {NAN, INFINITY, -INFINITY};
        for (int k = 0; k < 3; k++) {
            shmtf_pose p = pose_identity();
            component = &p.x + i;
            *component = infinite[k];
            CHECK(pose_normalise(&p, &value) != NULL);
        }
    }
}

/* A chain of 10,000 products stays a rotation once renormalised. */
static void check_drift(void) {
    shmtf_pose p = pose_identity();
    for (int n = 0; n < 10000; n++) {
        shmtf_pose step = random_pose(check_uniform(&seed) * 3);
        p = pose_compose(&p, &step);
    }
    pose_renormalise(&p);
    CHECK(fabs(p.qx * p.qx + p.qy * p.qy + p.qz * p.qz + p.qw * p.qw - 1) < 1e-15);
}

int main(void) {
    check_compose();
    check_slerp();
    check_normalise();
    check_drift();
    return check_result("pose");
}
