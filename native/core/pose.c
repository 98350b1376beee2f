/* SPDX-License-Identifier: Apache-2.0 */
#include "core/pose.h"

#include <math.h>

shmtf_pose pose_inverse(const shmtf_pose *p) {
    shmtf_pose r = {0, 0, 0, -p->qx, -p->qy, -p->qz, p->qw};
    double t[3];
    pose_apply(&r, p->x, p->y, p->z, t);
    r.x = -t[0];
    r.y = -t[1];
    r.z = -t[2];
    return r;
}

shmtf_pose pose_interpolate_wide(const shmtf_pose *a, const shmtf_pose *b, double ratio) {
    double u = 1 - ratio, v = ratio;
    double dot = a->qx * b->qx + a->qy * b->qy + a->qz * b->qz + a->qw * b->qw;
    double sign = dot < 0 ? -1 : 1;
    /* 1 - cos from the chord: acos of a rounded cosine would lose half the digits towards 0 */
    double dx = a->qx - sign * b->qx, dy = a->qy - sign * b->qy, dz = a->qz - sign * b->qz, dw = a->qw - sign * b->qw;
    double x = (dx * dx + dy * dy + dz * dz + dw * dw) / 2, wa, wb;
    if (x < POSE_NARROW) {
        wa = pose_narrow_weight(u, x);
        wb = pose_narrow_weight(v, x);
    } else {
        double theta = 2 * asin(sqrt(x / 2)), s = sqrt(x * (2 - x));
        wa = sin(u * theta) / s;
        wb = sin(v * theta) / s;
    }
    return pose_blend(a, b, u, v, wa, sign * wb);
}

static void scale_rotation(shmtf_pose *p, double s) {
    p->qx *= s;
    p->qy *= s;
    p->qz *= s;
    p->qw *= s;
}

void pose_renormalise(shmtf_pose *p) {
    double n2 = p->qx * p->qx + p->qy * p->qy + p->qz * p->qz + p->qw * p->qw;
    scale_rotation(p, (3 - n2) / 2); /* one Newton step towards 1/sqrt(n2), n2 being 1 to a few ulp */
}

const char *pose_normalise(shmtf_pose *p, double *value) {
    if (pose_is_normal(p)) return NULL; /* it stays as it was given, to the bit */
    double norm2 = p->qx * p->qx + p->qy * p->qy + p->qz * p->qz + p->qw * p->qw;
    const double v[7] = {p->x, p->y, p->z, p->qx, p->qy, p->qz, p->qw};
    static const char *const name[7] = {"translation x", "translation y", "translation z", "rotation x",
                                        "rotation y",    "rotation z",    "rotation w"};
    for (int i = 0; i < 7; i++)
        if (!isfinite(v[i])) return *value = v[i], name[i];
    if (!(fabs(norm2 - 1) <= 1e-2)) return *value = sqrt(norm2), "norm of the rotation quaternion";
    double s = fabs(norm2 - 1) <= 1e-15 ? 1 : 1 / sqrt(norm2);
    bool flip = p->qw < 0;
    if (s != 1 || flip) scale_rotation(p, flip ? -s : s);
    return NULL;
}
