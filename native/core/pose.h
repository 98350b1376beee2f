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
/* Translation linear, rotation along the shortest great arc at constant speed; ratio in [0, 1].
 * Exact to a few ulp at every angle: Shoemake 1985 (slerp); below 1.8 degrees its series in 1 - cos, no trigonometry. */
shmtf_pose pose_interpolate(const shmtf_pose *a, const shmtf_pose *b, double ratio);
/* Check that a pose can be stored, and bring it into the stored form: |q| = 1, qw >= 0.  NULL, or the name of the
 * component that is wrong, its value in *value. */
const char *pose_normalise(shmtf_pose *p, double *value);
/* Undo the drift of a long chain of products. */
void pose_renormalise(shmtf_pose *p);

#endif
