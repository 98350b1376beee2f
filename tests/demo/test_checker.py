# SPDX-License-Identifier: Apache-2.0
"""The demonstration's check is real: right answers pass it, and whatever is wrong with an answer, it says so."""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from itertools import pairwise

import pytest

import shmtf
from shmtf.demo import simulation
from shmtf.demo.checker import Checker, Wrong
from shmtf.demo.world import Track, World

NOW = 1_700_000_000_123_456_789
PAIRS = [pair for task in simulation.make().tasks for pair in task.pairs]


@pytest.fixture
def world() -> World:
    return simulation.make()


def report(store: shmtf.Store, track: Track, stamp: int) -> None:
    store.set_transforms(
        shmtf.Transform(parent, child, stamp, p[:3], p[3:])
        for (parent, child), p in zip(track.edges, track.poses(stamp), strict=True)
    )


@pytest.fixture
def filled(store: shmtf.Store, world: World) -> shmtf.Store:
    """Two seconds of the robot."""
    store.set_transforms([shmtf.Transform(p, c, None, t[:3], t[3:]) for p, c, t in world.statics], static=True)
    for track in world.tracks.values():
        stamp = track.latest_stamp(NOW - 2 * 10**9)
        while stamp <= NOW:
            report(store, track, stamp)
            stamp = track.next_stamp(stamp)
    return store


@pytest.fixture
def store(store_name: str) -> shmtf.Store:
    return shmtf.Store.create(store_name, max_frames=64, history=600, stream_bytes=1 << 22)


@pytest.fixture
def checker(filled: shmtf.Store, world: World) -> Checker:
    return Checker(world, lambda frame: [record["stamp"] for record in filled._records(frame)])


@pytest.mark.parametrize("pair", PAIRS, ids=" ".join)
def test_right_answers_pass(filled: shmtf.Store, checker: Checker, pair: tuple[str, str]) -> None:
    checker.latest(filled.lookup_latest_transform(*pair), *pair)
    common = filled.lookup_transform(*pair)
    checker.at(common, *pair, None)
    assert common.stamp is not None
    r = random.Random(0)
    for _ in range(50):
        time = common.stamp - r.randrange(10**9 // 2)
        checker.at(filled.lookup_transform(*pair, time), *pair, time)
    assert checker.gaps == 0


@pytest.mark.parametrize("pair", PAIRS, ids=" ".join)
def test_the_other_way_round_passes(filled: shmtf.Store, checker: Checker, pair: tuple[str, str]) -> None:
    there = (pair[1], pair[0])
    checker.latest(filled.lookup_latest_transform(*there), *there)
    checker.at(filled.lookup_transform(*there), *there, None)


def test_static_answers_pass(filled: shmtf.Store, checker: Checker) -> None:
    checker.latest(filled.lookup_latest_transform("laser", "rig"), "laser", "rig")
    checker.at(filled.lookup_transform("laser", "rig"), "laser", "rig", None)


def test_gaps_pass(filled: shmtf.Store, checker: Checker, world: World) -> None:
    arm = world.tracks["arm"]
    stamps = [arm.latest_stamp(NOW) + 10**9]
    for _ in range(3):
        stamps.append(arm.next_stamp(stamps[-1]))
    for stamp in stamps:
        report(filled, arm, stamp)
    before = arm.latest_stamp(NOW)
    for time in (before + 1, before + 10**9 // 2, stamps[0] - 1, stamps[0], stamps[1] + 5):
        checker.at(filled.lookup_transform("arm_base", "tool", time), "arm_base", "tool", time)
    assert checker.gaps > 0


# ---- wrong answers ----


def altered(T: shmtf.Transform, **changes: object) -> shmtf.Transform:
    """The same answer, but for what is changed."""
    fields = {
        "parent": T.parent,
        "child": T.child,
        "stamp": T.stamp,
        "values": T._values(),
        "stamp_range": T.stamp_range,
        "version": T.version or 0,
        "edges": T.edges,
        **changes,
    }
    return shmtf.Transform._restore(*fields.values())  # type: ignore[arg-type]


def moved(by: float) -> Callable[[shmtf.Transform], shmtf.Transform]:
    def change(T: shmtf.Transform) -> shmtf.Transform:
        x, *rest = T._values()
        return altered(T, values=(x + by, *rest))

    return change


def turned(by: float) -> Callable[[shmtf.Transform], shmtf.Transform]:
    def change(T: shmtf.Transform) -> shmtf.Transform:
        x, y, z, qx, qy, qz, qw = T._values()
        c, s = math.cos(by / 2), math.sin(by / 2)
        return altered(T, values=(x, y, z, qx * c + qy * s, qy * c - qx * s, qz * c + qw * s, qw * c - qz * s))

    return change


def one_edge_older(T: shmtf.Transform) -> shmtf.Transform:
    """A mixture of two commits of the arm, with poses that fit their stamps."""
    edges = [(p, c, s - 10_000_000 if c == "arm_link_4" and s is not None else s) for p, c, s in T.edges]
    stamps = [s for *_, s in edges if s is not None]
    return altered(T, edges=tuple(edges), stamp=min(stamps), stamp_range=(min(stamps), max(stamps)))


@pytest.mark.parametrize(
    "change",
    [
        moved(2e-9),
        turned(2e-9),
        one_edge_older,
        lambda T: altered(T, stamp=T.stamp + 1),
        lambda T: altered(T, stamp_range=(T.stamp_range[0], T.stamp_range[1] + 1)),
        lambda T: altered(T, edges=T.edges[1:]),
        lambda T: altered(T, parent="odom"),
        lambda T: T.inv(),
        lambda T: altered(T, edges=tuple((p, c, None if c == "odom" else s) for p, c, s in T.edges)),
    ],
    ids=["moved", "turned", "mixed", "stamp", "range", "edge", "frame", "direction", "static"],
)
def test_wrong_latest(
    filled: shmtf.Store, checker: Checker, change: Callable[[shmtf.Transform], shmtf.Transform]
) -> None:
    T = filled.lookup_latest_transform("map", "tool")
    checker.latest(altered(T), "map", "tool")
    with pytest.raises(Wrong):
        checker.latest(change(T), "map", "tool")


@pytest.mark.parametrize("change", [moved(2e-9), turned(2e-9), one_edge_older], ids=["moved", "turned", "mixed"])
def test_wrong_at_a_time(
    filled: shmtf.Store, checker: Checker, change: Callable[[shmtf.Transform], shmtf.Transform]
) -> None:
    T = filled.lookup_transform("map", "tool")
    checker.at(T, "map", "tool", None)
    with pytest.raises(Wrong):
        checker.at(change(T), "map", "tool", None)
    with pytest.raises(Wrong, match="asked for"):
        checker.at(T, "map", "tool", (T.stamp or 0) - 1)


def test_a_wrong_robot(filled: shmtf.Store, monkeypatch: pytest.MonkeyPatch) -> None:
    """A constant of the simulation that differs by a nanometre from what the sensors used."""
    links = [list(link) for link in simulation._LINKS]
    links[3][1] += 3e-9  # type: ignore[operator]
    monkeypatch.setattr(simulation, "_LINKS", tuple(tuple(link) for link in links))
    checker = Checker(simulation.make(), lambda frame: [r["stamp"] for r in filled._records(frame)])
    for target, source in (("map", "tool"), ("arm_base", "tool")):
        with pytest.raises(Wrong, match="off"):
            checker.latest(filled.lookup_latest_transform(target, source), target, source)
        with pytest.raises(Wrong, match="off"):
            checker.at(filled.lookup_transform(target, source), target, source, None)
    checker.latest(filled.lookup_latest_transform("map", "laser"), "map", "laser")


def test_wrong_data_in_the_store(filled: shmtf.Store, checker: Checker, world: World) -> None:
    odometry = world.tracks["odometry"]
    stamp = odometry.next_stamp(odometry.latest_stamp(NOW))
    x, y, z, *q = odometry.poses(stamp)[0]
    filled.set_transform(shmtf.Transform("odom", "base_link", stamp, (x + 1e-6, y, z), q))
    with pytest.raises(Wrong, match="off"):
        checker.latest(filled.lookup_latest_transform("map", "laser"), "map", "laser")


def test_data_that_nobody_reported(filled: shmtf.Store, checker: Checker, world: World) -> None:
    odometry = world.tracks["odometry"]
    stamp = odometry.latest_stamp(NOW) + 1
    x, y, z, *q = odometry.poses(stamp)[0]
    filled.set_transform(shmtf.Transform("odom", "base_link", stamp, (x, y, z), q))
    with pytest.raises(Wrong, match="never reported"):
        checker.latest(filled.lookup_latest_transform("map", "laser"), "map", "laser")


def test_truth_lies_between(filled: shmtf.Store, checker: Checker, world: World) -> None:
    T = filled.lookup_latest_transform("odom", "base_link")
    stamps = [T.stamp or 0, (T.stamp or 0) + 20_000_000]
    for earlier, later in pairwise(stamps):
        ends = [checker.truth(T, s) for s in (earlier, later)]
        middle = checker.truth(T, (earlier + later) // 2)
        assert math.dist(middle[:3], ends[0][:3]) < math.dist(ends[0][:3], ends[1][:3])
