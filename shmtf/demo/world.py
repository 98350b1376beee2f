# SPDX-License-Identifier: Apache-2.0
"""What moves and who reports it.  A world knows the truth: what each sensor reports at each stamp, and in between."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

from .poses import Pose


class Track(ABC):
    """What one sensor reports: all its edges at once, at its own stamps.  Times are int nanoseconds."""

    def __init__(self, name: str, edges: tuple[tuple[str, str], ...], rate: float, note: str) -> None:
        self.name = name
        self.edges = edges  #: (parent, child), in the order of poses()
        self.rate = rate  #: reports per second
        self.note = note  #: for people

    @abstractmethod
    def latest_stamp(self, time: int) -> int:
        """The newest stamp <= time."""

    @abstractmethod
    def next_stamp(self, stamp: int) -> int:
        """The stamp after one of this track's stamps."""

    def has_stamp(self, stamp: int) -> bool:
        """Whether the sensor reports at exactly this time."""
        return self.latest_stamp(stamp) == stamp

    @abstractmethod
    def poses(self, stamp: int) -> tuple[Pose, ...]:
        """What it reports at one of its stamps, T_parent_child by edge."""

    @abstractmethod
    def truth(self, index: int, time: int) -> Pose:
        """Where the child of an edge really is at any time."""


@dataclass(frozen=True)
class Task:
    """What a planner looks up: (target, source), the first one being what it shows."""

    name: str
    pairs: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class World:
    """Tracks, mounts, and what planners want to know."""

    title: str
    tracks: dict[str, Track]
    statics: tuple[tuple[str, str, Pose], ...]  #: parent, child, T_parent_child
    tasks: tuple[Task, ...]
    lesson: tuple[str, ...]  #: what is to be seen in the freshness of answers, in lines
    victims: tuple[str, str]  #: tracks to kill and to stop

    def locate(self) -> dict[str, tuple[Track, int]]:
        """Where each moving child comes from."""
        return {child: (track, i) for track in self.tracks.values() for i, (_, child) in enumerate(track.edges)}
