# SPDX-License-Identifier: Apache-2.0
"""The demonstration's own mathematics, and its two worlds."""

from __future__ import annotations

import math
import os
import random
from pathlib import Path

import pytest

from shmtf.demo import bvh, poses, recordings, simulation
from shmtf.demo.poses import Pose, angle, compose, distance, from_rpy, interpolate, inverse, pose
from shmtf.demo.world import Track, World

START = 1_700_000_000_123_456_789
DATA = Path(os.environ.get("SHMTF_DATA") or Path(__file__).resolve().parents[2] / ".." / "shared" / "data")
needs_data = pytest.mark.skipif(
    not (DATA / "boreas").is_dir(), reason="the recordings are not here; SHMTF_DATA names their folder"
)


def random_pose(r: random.Random) -> Pose:
    return pose(*(r.uniform(-5, 5) for _ in range(3)), poses.normalised([r.gauss(0, 1) for _ in range(4)]))


def test_groups() -> None:
    r = random.Random(1)
    for _ in range(100):
        a, b, c = random_pose(r), random_pose(r), random_pose(r)
        left, right = compose(compose(a, b), c), compose(a, compose(b, c))
        assert distance(left, right) < 1e-13 and angle(left, right) < 1e-13
        one = compose(a, inverse(a))
        assert distance(one, poses.IDENTITY) < 1e-14 and angle(one, poses.IDENTITY) < 1e-14


def test_known_values() -> None:
    quarter = pose(1.0, 0.0, 0.0, from_rpy(0.0, 0.0, math.pi / 2))
    assert compose(quarter, pose(1.0, 0.0, 0.0))[:3] == pytest.approx((1.0, 1.0, 0.0))
    half = interpolate(poses.IDENTITY, pose(2.0, 0.0, 0.0, from_rpy(0.0, 0.0, 1.0)), 0.25)
    assert half == pytest.approx(pose(0.5, 0.0, 0.0, from_rpy(0.0, 0.0, 0.25)))


def test_interpolation_keeps_its_speed_and_the_short_way() -> None:
    r = random.Random(2)
    for _ in range(100):
        a, b = random_pose(r), random_pose(r)
        b = (*b[:3], *(-v for v in b[3:])) if r.random() < 0.5 else b  # type: ignore[assignment]
        whole = angle(a, b)
        for ratio in (0.0, 0.1, 0.5, 1.0):
            assert angle(a, interpolate(a, b, ratio)) == pytest.approx(ratio * whole, abs=1e-7)


def worlds() -> list[World]:
    found = [simulation.make()]
    if (DATA / "boreas").is_dir():
        found += [recordings.make(DATA, START), recordings.make(DATA, START, 2.0)]
    return found


def tracks() -> list[Track]:
    return [track for world in worlds() for track in world.tracks.values()]


@pytest.mark.parametrize("track", tracks(), ids=lambda track: track.name)
def test_stamps(track: Track) -> None:
    stamp = track.latest_stamp(START + 3 * 10**9)
    for _ in range(2000):
        later = track.next_stamp(stamp)
        assert stamp < later
        assert track.has_stamp(later) and not track.has_stamp(later - 1)
        assert track.latest_stamp(later - 1) == stamp
        stamp = later


@pytest.mark.parametrize("track", tracks(), ids=lambda track: track.name)
def test_truth_passes_through_the_reports(track: Track) -> None:
    stamp = track.latest_stamp(START + 5 * 10**9)
    for i, reported in enumerate(track.poses(stamp)):
        assert track.truth(i, stamp) == pytest.approx(reported, abs=1e-12)
        assert math.hypot(*reported[3:]) == pytest.approx(1, abs=1e-12)
        assert distance(track.truth(i, stamp + 1000), reported) < 1e-3


def test_stamps_do_not_drift() -> None:
    camera = simulation.make().tracks["camera"]  # 30 Hz: its period is no whole number of nanoseconds
    first = camera.latest_stamp(START)
    stamp = first
    for _ in range(30 * 60):
        stamp = camera.next_stamp(stamp)
    assert abs(stamp - first - 60 * 10**9) <= 1


# ---- recordings ----


@needs_data
def test_car_is_one_rigid_body() -> None:
    """Camera and lidar have clocks of their own; where both are known at one time they fit, all along the drive."""
    tracks = recordings.make(DATA, START).tracks
    camera, lidar = tracks["car_camera"], tracks["car_lidar"]
    fits = [
        compose(inverse(camera.truth(0, START + s * 10**9)), lidar.truth(0, START + s * 10**9))
        for s in range(2, 118, 4)
    ]
    for fit in fits:
        assert distance(fit, fits[0]) < 0.02 and angle(fit, fits[0]) < 0.02


@needs_data
def test_person_stands() -> None:
    world = recordings.make(DATA, START)
    track = world.tracks["person"]
    joints = {child: (parent, p) for (parent, child), p in zip(track.edges, track.poses(START + 10**9), strict=False)}
    up = world.statics[-1][2]

    def height(name: str) -> float:
        at = poses.IDENTITY
        while name in joints:
            name, p = joints[name][0], compose(joints[name][1], at)
            at = p
        return compose(up, at)[2]

    assert len(joints) == 31
    assert 1.2 < height("Head") < 1.8
    assert 0.8 < height("Hips") < 1.2
    assert abs(height("LeftToeBase")) < 0.25


@needs_data
def test_recordings_begin_anew() -> None:
    track = recordings.make(DATA, START).tracks["person"]
    last = track.latest_stamp(START + 5 * 10**9 - 100_000_000)
    while (after := track.next_stamp(last)) and track.poses(after) != track.poses(START):
        last = after
    assert after - last == pytest.approx(8_333_300, abs=2)
    assert track.poses(track.next_stamp(after)) == track.poses(track.next_stamp(START))


def test_no_recordings(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="boreas"):
        recordings.make(tmp_path, START)


BVH = """HIERARCHY
ROOT Hips
{
  OFFSET 0 0 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Yrotation Xrotation
  JOINT Knee
  {
    OFFSET 0 -2 0
    CHANNELS 3 Zrotation Yrotation Xrotation
    End Site
    {
      OFFSET 0 -1 0
    }
  }
  JOINT Arm
  {
    OFFSET 1 0 0
    CHANNELS 1 Xrotation
  }
}
MOTION
Frames: 2
Frame Time: 0.01
1 2 3 0 0 0 0 0 0 0
1 2 3 90 0 0 0 0 90 45
"""


def test_bvh(tmp_path: Path) -> None:
    path = tmp_path / "a.bvh"
    path.write_text(BVH, encoding="ascii")
    motion = bvh.read(path)
    assert [(j.name, j.parent, len(j.channels)) for j in motion.joints] == [
        ("Hips", None, 6),
        ("Knee", "Hips", 3),
        ("Arm", "Hips", 1),
    ]
    assert motion.frame_ns == 10_000_000
    hips, knee, arm = motion.poses(1, 0.5)
    assert hips == pytest.approx(pose(0.5, 1.0, 1.5, from_rpy(0, 0, math.pi / 2)))
    assert knee == pytest.approx(pose(0.0, -1.0, 0.0, from_rpy(math.pi / 2, 0, 0)))
    assert arm == pytest.approx(pose(0.5, 0.0, 0.0, from_rpy(math.pi / 4, 0, 0)))


@pytest.mark.parametrize(
    "broken", [BVH.replace("MOTION", ""), BVH.replace("ROOT", "ROOTS"), BVH[:-3], BVH.replace("Frames", "Frame")]
)
def test_bvh_that_is_none(tmp_path: Path, broken: str) -> None:
    path = tmp_path / "a.bvh"
    path.write_text(broken, encoding="ascii")
    with pytest.raises(ValueError, match=r"a\.bvh"):
        bvh.read(path)
