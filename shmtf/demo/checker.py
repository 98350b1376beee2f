# SPDX-License-Identifier: Apache-2.0
"""Compares the store's answers with a world: every edge, every stamp, every digit."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from .poses import IDENTITY, Pose, angle, compose, distance, interpolate, inverse
from .world import World

if TYPE_CHECKING:
    from ..transform import Transform

TOLERANCE = 1e-9  # metres, radians
_MAX_GAPS = 4096  # remembered

Edge = tuple[str, str, int | None]
Stamps = Callable[[str], list[int]]  # of the records that the store keeps of a frame


class Wrong(Exception):
    """The store gave a wrong answer."""


class Checker:
    """Checks transforms.

    kept_stamps: what the store keeps of a frame.  It is asked only where a sensor has left out reports (it was killed,
    stopped or late), to know between which two the store had to interpolate.
    """

    def __init__(self, world: World, kept_stamps: Stamps) -> None:
        self._source = world.locate()
        self._statics = {child: (parent, pose) for parent, child, pose in world.statics}
        self._kept_stamps = kept_stamps
        self._after: dict[tuple[str, int], int] = {}  # of a frame's stamp, the next one that it has: across gaps
        self.gaps = 0  #: interpolations across reports that were left out

    def latest(self, T: Transform, target: str, source: str) -> None:
        """An answer of lookup_latest_transform."""
        self._frames(T, target, source)
        stamps = self._stamps(T)
        if (T.stamp, T.stamp_range) != (min(stamps, default=None), (min(stamps), max(stamps)) if stamps else None):
            raise Wrong(f"{target} <- {source}: stamp {T.stamp}, range {T.stamp_range}, edges {T.edges}")
        self._one_commit(T)
        poses = {child: self._recorded(parent, child, stamp) for parent, child, stamp in T.edges}
        self._compare(T, target, source, poses)

    def at(self, T: Transform, target: str, source: str, time: int | None) -> None:
        """An answer of lookup_transform at a time; None: at the newest common time."""
        self._frames(T, target, source)
        stamps = self._stamps(T)
        if stamps and (T.stamp is None or T.stamp != (time if time is not None else T.stamp)):
            raise Wrong(f"{target} <- {source}: asked for {time}, stamp {T.stamp}")
        if stamps and time is None and T.stamp not in stamps:
            raise Wrong(f"{target} <- {source}: no edge has its newest record at the common time {T.stamp}")
        self._one_commit(T)
        if not stamps or T.stamp is None:
            self._compare(T, target, source, {c: self._recorded(p, c, s) for p, c, s in T.edges})
            return
        try:
            self._compare(T, target, source, self._interpolated(T.edges, T.stamp))
        except Wrong:
            if not self._learn_gaps(T.edges, T.stamp):
                raise
            self._compare(T, target, source, self._interpolated(T.edges, T.stamp))
            self.gaps += 1

    def truth(self, T: Transform, time: int) -> Pose:
        """Where the source of an answer really was in its target at a time."""
        poses = {}
        for parent, child, stamp in T.edges:
            if stamp is None:
                poses[child] = self._recorded(parent, child, None)
            else:
                track, index = self._source[child]
                poses[child] = track.truth(index, time)
        return _along(T.edges, T.parent, T.child, poses)

    # ---- parts ----

    @staticmethod
    def _frames(T: Transform, target: str, source: str) -> None:
        if (T.parent, T.child) != (target, source):
            raise Wrong(f"asked for {target} <- {source}, got {T.parent} <- {T.child}")

    @staticmethod
    def _stamps(T: Transform) -> list[int]:
        return [stamp for _, _, stamp in T.edges if stamp is not None]

    def _one_commit(self, T: Transform) -> None:
        """Edges that a sensor writes together must carry one stamp: no mixture of two commits."""
        seen: dict[str, int] = {}
        for _, child, stamp in T.edges:
            if stamp is None or child not in self._source:
                continue
            track = self._source[child][0].name
            if seen.setdefault(track, stamp) != stamp:
                raise Wrong(f"{T.parent} <- {T.child}: {track} wrote its frames together, the answer mixes: {T.edges}")

    def _recorded(self, parent: str, child: str, stamp: int | None) -> Pose:
        """What was reported for an edge at a stamp."""
        if stamp is None:
            above, pose = self._statics.get(child, ("nothing", IDENTITY))
            if above != parent:
                raise Wrong(f"static edge {parent} -> {child}: the mount is on {above}")
            return pose
        if child not in self._source:
            raise Wrong(f"edge {parent} -> {child} at {stamp}: nobody reports it")
        track, index = self._source[child]
        if track.edges[index][0] != parent or not track.has_stamp(stamp):
            raise Wrong(f"edge {parent} -> {child} at {stamp}: {track.name} never reported it")
        return track.poses(stamp)[index]

    def _interpolated(self, edges: tuple[Edge, ...], time: int) -> dict[str, Pose]:
        """Every edge at a time, between the report that the store says it used and the next one."""
        poses = {}
        for parent, child, stamp in edges:
            before = self._recorded(parent, child, stamp)
            if stamp is None or stamp == time:
                poses[child] = before
                continue
            later = self._after.get((child, stamp)) or self._source[child][0].next_stamp(stamp)
            if not stamp < time <= later:
                raise Wrong(f"edge {parent} -> {child}: {time} is not between {stamp} and {later}")
            after = self._recorded(parent, child, later)
            poses[child] = interpolate(before, after, (time - stamp) / (later - stamp))
        return poses

    def _learn_gaps(self, edges: tuple[Edge, ...], time: int) -> bool:
        """Ask the store which report follows the one it used; whether that is news."""
        news = False
        for _, child, stamp in edges:
            if stamp is None or stamp == time or (child, stamp) in self._after:
                continue
            kept = self._kept_stamps(child)
            later = min((s for s in kept if s > stamp), default=None)
            if stamp not in kept or later is None or later == self._source[child][0].next_stamp(stamp):
                continue
            if len(self._after) >= _MAX_GAPS:
                self._after.clear()
            self._after[child, stamp] = later
            news = True
        return news

    @staticmethod
    def _compare(T: Transform, target: str, source: str, poses: dict[str, Pose]) -> None:
        expected = _along(T.edges, target, source, poses)
        found: tuple[float, ...] = (*map(float, T.translation), *map(float, T.rotation))
        off, turned = distance(found, expected), angle(found, expected)
        if not (off <= TOLERANCE and turned <= TOLERANCE):
            raise Wrong(f"{target} <- {source} at {T.stamp}: {off:.3g} m and {turned:.3g} rad off; edges {T.edges}")


def _along(edges: tuple[Edge, ...], target: str, source: str, poses: dict[str, Pose]) -> Pose:
    """T_target_source from T_parent_child of every edge between them."""
    parents = {child: parent for parent, child, _ in edges}

    def to_top(name: str) -> tuple[str, Pose]:
        T_top_name = IDENTITY
        for _ in range(len(parents) + 1):
            if name not in parents:
                break
            T_top_name = compose(poses[name], T_top_name)
            name = parents[name]
        return name, T_top_name

    top_target, T_top_target = to_top(target)
    top_source, T_top_source = to_top(source)
    if top_target != top_source:
        raise Wrong(f"{target} <- {source}: the edges {edges} do not join them")
    return compose(inverse(T_top_target), T_top_source)
