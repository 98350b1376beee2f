# SPDX-License-Identifier: Apache-2.0
"""A mobile manipulator that is a pure function of time, so that anyone can tell where everything was, exactly."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise

from .poses import Pose, about, from_rpy, pose
from .world import Task, Track, World

_S = 10**9


def _phase(time: int, seconds: float) -> float:
    """Where in a cycle of so many seconds a time is, radians; integers first, so that no digit is lost."""
    cycle = round(seconds * _S)
    return 2 * math.pi * (time % cycle) / cycle


class Grid(Track):
    """Reports at the multiples of its period."""

    def __init__(
        self,
        name: str,
        rate: int,
        edges: tuple[tuple[str, str], ...],
        motion: Callable[[int], tuple[Pose, ...]],
        note: str,
    ) -> None:
        super().__init__(name, edges, rate, note)
        self._rate = rate
        self._motion = motion

    def latest_stamp(self, time: int) -> int:
        return self._stamp((time * self._rate + self._rate - 1) // _S)

    def next_stamp(self, stamp: int) -> int:
        return self._stamp((stamp * self._rate + self._rate - 1) // _S + 1)

    def _stamp(self, k: int) -> int:
        """The k-th, rounded down where the period is no whole number of nanoseconds."""
        return k * _S // self._rate

    def poses(self, stamp: int) -> tuple[Pose, ...]:
        return self._motion(stamp)

    def truth(self, index: int, time: int) -> Pose:
        return self._motion(time)[index]


def _localisation(time: int) -> tuple[Pose, ...]:
    """The drift of the odometry: slow."""
    a = _phase(time, 60)
    return (pose(0.3 * math.sin(a), 0.2 * math.cos(a), 0.0, about("z", 0.05 * math.sin(2 * a))),)


def _odometry(time: int) -> tuple[Pose, ...]:
    """A figure of eight of 8 m in 24 s, looking ahead."""
    a = _phase(time, 24)
    yaw = math.atan2(2 * 2.0 * math.cos(2 * a), 4.0 * math.cos(a))
    return (pose(4.0 * math.sin(a), 2.0 * math.sin(2 * a), 0.0, about("z", yaw)),)


def _imu(time: int) -> tuple[Pose, ...]:
    """Roll and pitch of a soft suspension."""
    roll, pitch = 0.03 * math.sin(_phase(time, 1.7)), 0.02 * math.sin(_phase(time, 2.3))
    return (pose(0.0, 0.0, 0.15, from_rpy(roll, pitch, 0.0)),)


_LINKS = (("z", 0.0, 0.0, 0.33), ("y", 0.0, 0.0, 0.0), ("z", 0.0, 0.0, 0.32), ("y", 0.08, 0.0, 0.0),
          ("z", -0.08, 0.0, 0.38), ("y", 0.0, 0.0, 0.0), ("z", 0.09, 0.0, 0.1))  # fmt: skip
_ARM = ("arm_base", *(f"arm_link_{i}" for i in range(1, 8)))


def _arm(time: int) -> tuple[Pose, ...]:
    """Seven joints, each with a rhythm of its own."""
    out = []
    for i, (axis, x, y, z) in enumerate(_LINKS):
        joint = (0.4 + 0.1 * i) * math.sin(_phase(time, 3.0 + 0.7 * i)) + 0.2 * i
        out.append(pose(x, y, z, about(axis, joint)))
    return tuple(out)


def _camera(time: int) -> tuple[Pose, ...]:
    """Pan and tilt, looking around."""
    pan, tilt = 1.2 * math.sin(_phase(time, 6)), 0.4 * math.sin(_phase(time, 4.1))
    return pose(0.0, 0.0, 0.08, about("z", pan)), pose(0.0, 0.0, 0.05, about("y", tilt))


def _chain(*names: str) -> tuple[tuple[str, str], ...]:
    return tuple(pairwise(names))


def make() -> World:
    """The robot: five sensors, its mounts, and what planners ask."""
    optical = from_rpy(-math.pi / 2, 0.0, -math.pi / 2)
    tracks = [
        Grid("localisation", 1, _chain("map", "odom"), _localisation, "map -> odom"),
        Grid("odometry", 50, _chain("odom", "base_link"), _odometry, "odom -> base_link"),
        Grid("imu", 200, _chain("base_link", "base_stabilised"), _imu, "base_link -> base_stabilised"),
        Grid("arm", 100, _chain(*_ARM), _arm, "7 joints in one commit"),
        Grid("camera", 30, _chain("rig", "camera_pan", "camera_tilt"), _camera, "pan and tilt in one commit"),
    ]
    return World(
        title="a simulated mobile manipulator",
        tracks={track.name: track for track in tracks},
        statics=(
            ("base_link", "arm_base", pose(0.35, 0.0, 0.6)),
            ("arm_link_7", "tool", pose(0.0, 0.0, 0.21, about("z", math.pi / 4))),
            ("base_link", "rig", pose(0.1, 0.0, 1.3)),
            ("camera_tilt", "camera_left_optical", pose(0.02, 0.06, 0.0, optical)),
            ("camera_tilt", "camera_right_optical", pose(0.02, -0.06, 0.0, optical)),
            ("base_link", "laser", pose(0.45, 0.0, 0.2)),
        ),
        tasks=(
            Task("grasp", (("map", "tool"), ("arm_base", "tool"))),
            Task("look", (("map", "camera_left_optical"), ("laser", "camera_right_optical"))),
            Task("handeye", (("camera_left_optical", "tool"), ("base_stabilised", "tool"))),
            Task("drive", (("map", "base_stabilised"), ("odom", "laser"))),
        ),
        lesson=(
            "map -> odom comes once a second. At the newest time common to all edges, all are as old as",
            "that one; lookup_latest_transform takes the newest record of each, in one snapshot.",
        ),
        victims=("camera", "arm"),
    )
