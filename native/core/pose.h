/* SPDX-License-Identifier: Apache-2.0
 *
 * Rigid transforms: a translation and a unit quaternion (x y z w).  T_a_c = compose(T_a_b, T_b_c).
 */
#ifndef SHMTF_CORE_POSE_H
#define SHMTF_CORE_POSE_H

#include <stdbool.h>

#include "segment/atomic.h"
#include "shmtf.h"

static inline shmtf_pose pose_identity(void) { return (shmtf_pose){0, 0, 0, 0, 0, 0, 1}; }

/* v rotated by the unit quaternion q of p, added to p's translation: v' = v + 2w(u x v) + 2u x (u x v). */
HOT_INLINE void pose_apply(const shmtf_pose *p, double x, double y, double z, double out[3]) {
    double tx = 2 * (p->qy * z - p->qz * y), ty = 2 * (p->qz * x - p->qx * z), tz = 2 * (p->qx * y - p->qy * x);
    out[0] = p->x + x + p->qw * tx + (p->qy * tz - p->qz * ty);
    out[1] = p->y + y + p->qw * ty + (p->qz * tx - p->qx * tz);
    out[2] = p->z + z + p->qw * tz + (p->qx * ty - p->qy * tx);
}

HOT_INLINE shmtf_pose pose_compose(const shmtf_pose *T_a_b, const shmtf_pose *T_b_c) {
    const shmtf_pose *a = T_a_b, *b = T_b_c;
    double t[3];
    pose_apply(a, b->x, b->y, b->z, t);
    return (shmtf_pose){t[0], t[1], t[2],
                        a->qw * b->qx + a->qx * b->qw + a->qy * b->qz - a->qz * b->qy,
                        a->qw * b->qy - a->qx * b->qz + a->qy * b->qw + a->qz * b->qx,
                        a->qw * b->qz + a->qx * b->qy - a->qy * b->qx + a->qz * b->qw,
                        a->qw * b->qw - a->qx * b->qx - a->qy * b->qy - a->qz * b->qz};
}

shmtf_pose pose_inverse(const shmtf_pose *T_a_b);

/* sin(t*theta) / sin(theta) for cos(theta) = 1 - x, x < POSE_NARROW, as t times a product series in x (Eberly, "A fast and
 * accurate algorithm for computing slerp", 2011): factors 1 - (t^2 / (i(2i+1)) - i/(2i+1)) * x.  Four of them leave less
 * than 1e-17. */
#define POSE_NARROW 8e-4 /* records that differ by less than 4.6 degrees */
HOT_INLINE double pose_narrow_weight(double t, double x) {
    double t2 = t * t;
    double a1 = (t2 * (1.0 / 3) - 1.0 / 3) * x, a2 = (t2 * (1.0 / 10) - 2.0 / 5) * x;
    double a3 = (t2 * (1.0 / 21) - 3.0 / 7) * x, a4 = (t2 * (1.0 / 36) - 4.0 / 9) * x;
    return t * (1 - a1 * (1 - a2 * (1 - a3 * (1 - a4))));
}
HOT_INLINE shmtf_pose pose_blend(const shmtf_pose *a, const shmtf_pose *b, double u, double v, double wa, double wb) {
    return (shmtf_pose){u * a->x + v * b->x,     u * a->y + v * b->y,     u * a->z + v * b->z,    wa * a->qx + wb * b->qx,
                        wa * a->qy + wb * b->qy, wa * a->qz + wb * b->qz, wa * a->qw + wb * b->qw};
}
shmtf_pose pose_interpolate_wide(const shmtf_pose *a, const shmtf_pose *b, double ratio);
/* Translation linear, rotation along the shortest great arc at constant speed; ratio in [0, 1].
 * Exact to a few ulp at every angle: Shoemake 1985 (slerp); where records are close its series, no trigonometry. */
HOT_INLINE shmtf_pose pose_interpolate(const shmtf_pose *a, const shmtf_pose *b, double ratio) {
    double dx = a->qx - b->qx, dy = a->qy - b->qy, dz = a->qz - b->qz, dw = a->qw - b->qw;
    double x = (dx * dx + dy * dy + dz * dz + dw * dw) / 2, u = 1 - ratio;
    if (!(x < POSE_NARROW)) return pose_interpolate_wide(a, b, ratio);
    return pose_blend(a, b, u, ratio, pose_narrow_weight(u, x), pose_narrow_weight(ratio, x));
}
/* Is the pose in the stored form already? */
static inline bool pose_is_normal(const shmtf_pose *p) {
    double sum = p->x + p->y + p->z; /* finite only if all three are; if it overflows, pose_normalise looks closer */
    double off = p->qx * p->qx + p->qy * p->qy + p->qz * p->qz + p->qw * p->qw - 1;
    return sum - sum == 0 && off <= 1e-15 && off >= -1e-15 && p->qw >= 0;
}
/* Check that a pose can be stored, and bring it into the stored form: |q| = 1, qw >= 0.  NULL, or the name of the
 * component that is wrong, its value in *value. */
const char *pose_normalise(shmtf_pose *p, double *value);
/* Undo the drift of a long chain of products. */
void pose_renormalise(shmtf_pose *p);

#endif
