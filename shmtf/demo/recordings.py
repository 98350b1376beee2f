# SPDX-License-Identifier: Apache-2.0
"""Real recordings, played again on their own clocks: a car, a robot arm, a walking person."""

from __future__ import annotations

import csv
import math
from bisect import bisect_right
from collections.abc import Callable, Sequence
from decimal import Decimal
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from statistics import median

from . import bvh
from .poses import Pose, about, conjugate, from_rpy, interpolate, normalised, pose
from .world import Task, Track, World

_ORIGIN = (623450.0, 4848823.0, 154.0)  # of the car's site in UTM, metres: where the recording begins
_LESSON = (
    "Two sensors of a moving car, each on its own clock, fit together at one common time only; what",
    "moves by itself is better known from the newest records. A program says which one it wants.",
)
_BVH_UNIT = 0.0254 / 0.45  # metres: CMU's skeletons count 0.45 inches


class Recording(Track):
    """Reports at the recorded stamps, counted from `start`; after the last one it begins anew."""

    def __init__(
        self,
        name: str,
        edges: tuple[tuple[str, str], ...],
        offsets: Sequence[int],
        reports: Sequence[tuple[Pose, ...]] | Callable[[int], tuple[Pose, ...]],
        start: int,
        note: str,
    ) -> None:
        steps = [b - a for a, b in pairwise(offsets)]
        if not steps or min(steps) <= 0:
            raise ValueError(f"{name}: the stamps of the recording do not increase")
        period = round(median(steps))
        super().__init__(name, edges, 1e9 / period, note)
        self._offsets = list(offsets)
        self._reports = reports
        self._start = start
        self._length = offsets[-1] + period  # of one round

    def _index(self, time: int) -> tuple[int, int]:
        """Round, and the last report at or before a time; the first report stands for all time before."""
        turn, into = divmod(time - self._start, self._length)
        i = bisect_right(self._offsets, into) - 1
        if i < 0:
            turn, i = turn - 1, len(self._offsets) - 1
        return (turn, i) if turn >= 0 else (0, 0)

    def _stamp(self, turn: int, i: int) -> int:
        return self._start + turn * self._length + self._offsets[i]

    def latest_stamp(self, time: int) -> int:
        return self._stamp(*self._index(time))

    def next_stamp(self, stamp: int) -> int:
        turn, i = self._index(stamp)
        return self._stamp(turn, i + 1) if i + 1 < len(self._offsets) else self._stamp(turn + 1, 0)

    def poses(self, stamp: int) -> tuple[Pose, ...]:
        i = self._index(stamp)[1]
        return self._reports(i) if callable(self._reports) else self._reports[i]

    def truth(self, index: int, time: int) -> Pose:
        before = self.latest_stamp(time)
        after = self.next_stamp(before)
        ratio = (time - before) / (after - before)
        return interpolate(self.poses(before)[index], self.poses(after)[index], ratio)


def make(folder: Path, start: int, speed: float = 1.0) -> World:
    """The recordings that the folder has; their first reports are stamped `start` and a little later.

    speed: 2 plays twice as fast.  Raises FileNotFoundError, ValueError.
    """
    tracks: list[Track] = []
    tasks: list[Task] = []
    statics: list[tuple[str, str, Pose]] = []
    for part in (_car, _arm, _person):
        part(folder, start, Fraction(speed).limit_denominator(1000), tracks, statics, tasks)
    if not tracks:
        raise FileNotFoundError(f"{folder} has none of boreas, robot_arm and cmu_mocap")
    by_name = {track.name: track for track in tracks}
    return World(
        title="real recordings: " + ", ".join(dict.fromkeys(t.name for t in tasks)),
        tracks=by_name,
        statics=tuple(statics),
        tasks=tuple(tasks),
        lesson=_LESSON,
        victims=(tracks[min(1, len(tracks) - 1)].name, tracks[-1].name),
    )


def _scaled(stamps: Sequence[int], first: int, speed: Fraction) -> list[int]:
    return [int((stamp - first) / speed) for stamp in stamps]


def _rows(path: Path) -> list[list[str]]:
    with open(path, newline="", encoding="ascii") as file:
        return [row for row in csv.reader(file) if row and row[0][:1].isdigit()]


def _car(
    folder: Path,
    start: int,
    speed: Fraction,
    tracks: list[Track],
    statics: list[tuple[str, str, Pose]],
    tasks: list[Task],
) -> None:
    """Boreas.  Radar stamps are nanoseconds, the others microseconds."""
    if not (folder / "boreas").is_dir():
        return
    units = {"camera": 1000, "lidar": 1000, "radar": 1}
    rows = {name: _rows(folder / "boreas" / f"{name}_poses.csv") for name in units}
    stamps = {name: [int(row[0]) * unit for row in rows[name]] for name, unit in units.items()}
    first = min(s[0] for s in stamps.values())
    for name in units:
        tracks.append(
            Recording(
                f"car_{name}",
                (("site", name),),
                _scaled(stamps[name], first, speed),
                [(_boreas_pose([float(v) for v in row[1:]]),) for row in rows[name]],
                start,
                f"site -> {name}",
            )
        )
    statics.append(("utm", "site", pose(*_ORIGIN)))
    tasks.append(Task("car", (("camera", "lidar"), ("radar", "camera"), ("site", "radar"))))


def _boreas_pose(row: list[float]) -> Pose:
    """easting, northing, altitude, three velocities, roll, pitch, heading: T_utm_sensor, less the origin.

    The dataset's angles are those of the opposite rotation: R_utm_sensor = Rx(-roll) Ry(-pitch) Rz(-heading).
    """
    x, y, z = (row[i] - _ORIGIN[i] for i in range(3))
    return pose(x, y, z, conjugate(from_rpy(row[6], row[7], row[8])))


def _arm(
    folder: Path,
    start: int,
    speed: Fraction,
    tracks: list[Track],
    statics: list[tuple[str, str, Pose]],
    tasks: list[Task],
) -> None:
    """A robot arm's hand, and its camera as a calibration target sees it: two trees, two clocks."""
    if not (folder / "robot_arm").is_dir():
        return
    pairs = (("base_link", "sr300_hinge"), ("target", "ir"))
    rows = {pair: _rows(folder / "robot_arm" / f"{pair[0]}_{pair[1]}.csv") for pair in pairs}
    stamps = {pair: [int(Decimal(row[0].strip()) * 10**9) for row in rows[pair]] for pair in pairs}
    first = min(s[0] for s in stamps.values())
    for pair, name in zip(pairs, ("arm_hand", "arm_camera"), strict=True):
        reports = []
        for row in rows[pair]:
            x, y, z, *q = (float(v) for v in row[1:8])
            reports.append((pose(x, y, z, normalised(q)),))
        offsets = _scaled(stamps[pair], first, speed)
        tracks.append(Recording(name, (pair,), offsets, reports, start, f"{pair[0]} -> {pair[1]}"))
    tasks.append(Task("arm", pairs))


def _person(
    folder: Path,
    start: int,
    speed: Fraction,
    tracks: list[Track],
    statics: list[tuple[str, str, Pose]],
    tasks: list[Task],
) -> None:
    """A walking person, all joints in one commit."""
    if not (folder / "cmu_mocap").is_dir():
        return
    motion = bvh.read(folder / "cmu_mocap" / "01_01.bvh")
    edges = tuple((joint.parent or "mocap", joint.name) for joint in motion.joints)
    stamps = [i * motion.frame_ns for i in range(len(motion.frames))]
    cache: dict[int, tuple[Pose, ...]] = {}

    def report(i: int) -> tuple[Pose, ...]:
        if i not in cache:
            cache[i] = motion.poses(i, _BVH_UNIT)
        return cache[i]

    offsets = _scaled(stamps, 0, speed)
    tracks.append(Recording("person", edges, offsets, report, start, f"{len(edges)} joints in one commit"))
    statics.append(("studio", "mocap", pose(0.0, 0.0, 0.0, about("x", math.pi / 2))))  # there y is up
    tasks.append(Task("person", (("studio", "LFingers"), ("LeftFoot", "RightHand"), ("Head", "LeftToeBase"))))
