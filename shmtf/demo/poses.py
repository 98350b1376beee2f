# SPDX-License-Identifier: Apache-2.0
"""Poses as plain tuples (x, y, z, qx, qy, qz, qw), in plain Python: independent of the code they are to check."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TypeAlias

Pose: TypeAlias = tuple[float, float, float, float, float, float, float]
Quaternion: TypeAlias = tuple[float, float, float, float]

IDENTITY: Pose = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)


def quaternion_product(a: Sequence[float], b: Sequence[float]) -> Quaternion:
    """The rotation b, then a."""
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    return (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )


def normalised(q: Sequence[float]) -> Quaternion:
    """The same rotation, of length 1."""
    n = math.sqrt(sum(v * v for v in q))
    return (q[0] / n, q[1] / n, q[2] / n, q[3] / n)


def about(axis: str, angle: float) -> Quaternion:
    """A rotation about x, y or z, radians."""
    s, c = math.sin(angle / 2), math.cos(angle / 2)
    return {"x": (s, 0.0, 0.0, c), "y": (0.0, s, 0.0, c), "z": (0.0, 0.0, s, c)}[axis]


def from_rpy(roll: float, pitch: float, yaw: float) -> Quaternion:
    """Rz(yaw) Ry(pitch) Rx(roll)."""
    return quaternion_product(about("z", yaw), quaternion_product(about("y", pitch), about("x", roll)))


def conjugate(q: Sequence[float]) -> Quaternion:
    """The opposite rotation."""
    return (-q[0], -q[1], -q[2], q[3])


def pose(x: float, y: float, z: float, q: Sequence[float] = (0.0, 0.0, 0.0, 1.0)) -> Pose:
    """A translation and a rotation."""
    return (x, y, z, q[0], q[1], q[2], q[3])


def _rotated(q: Sequence[float], x: float, y: float, z: float) -> tuple[float, float, float]:
    px, py, pz, _ = quaternion_product(quaternion_product(q, (x, y, z, 0.0)), conjugate(q))
    return px, py, pz


def compose(a: Pose, b: Pose) -> Pose:
    """T_a_c of T_a_b and T_b_c."""
    x, y, z = _rotated(a[3:], b[0], b[1], b[2])
    return pose(a[0] + x, a[1] + y, a[2] + z, quaternion_product(a[3:], b[3:]))


def inverse(a: Pose) -> Pose:
    """T_b_a of T_a_b."""
    q = conjugate(a[3:])
    x, y, z = _rotated(q, a[0], a[1], a[2])
    return pose(-x, -y, -z, q)


def slerp(a: Sequence[float], b: Sequence[float], ratio: float) -> Quaternion:
    """The shortest way from a to b at constant speed: the rotation vector of a^-1 b, scaled."""
    x, y, z, w = quaternion_product(conjugate(a), b)
    if w < 0:
        x, y, z, w = -x, -y, -z, -w
    s = math.sqrt(x * x + y * y + z * z)
    if s == 0.0:
        return (a[0], a[1], a[2], a[3])
    half = math.atan2(s, w) * ratio
    k = math.sin(half) / s
    return quaternion_product(a, (x * k, y * k, z * k, math.cos(half)))


def interpolate(a: Pose, b: Pose, ratio: float) -> Pose:
    """Translation on the straight line, rotation by slerp."""
    x, y, z = (u + (v - u) * ratio for u, v in zip(a[:3], b[:3], strict=True))
    return pose(x, y, z, slerp(a[3:], b[3:], ratio))


def distance(a: Sequence[float], b: Sequence[float]) -> float:
    """Metres between two origins."""
    return math.dist(a[:3], b[:3])


def angle(a: Sequence[float], b: Sequence[float]) -> float:
    """Radians between two orientations."""
    x, y, z, w = quaternion_product(conjugate(a[3:]), b[3:])
    return 2 * math.atan2(math.sqrt(x * x + y * y + z * z), abs(w))
