# SPDX-License-Identifier: Apache-2.0
"""What `shmtf-bench figures` measures: groups of runs, each of which feeds several figures."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

from . import BenchError, _scenes
from ._report import Bar
from .ycsb import MIXED_RATE, Workload, measure

Case = dict[str, Any]

START_S = 0.12  # a worker's start and attachment, on one CPU
PAUSE_S = 0.05  # between two rounds
DEEPEST_TF2 = 999  # edges that tf2 climbs
_FILL_S = 1.5e-6  # a record of a new store


@dataclass(frozen=True)
class Size:
    """How much is measured; times in seconds."""

    name: str
    rounds: int
    duration: float
    warm_up: float
    frames: int
    processes: list[int]
    frequencies: list[float]
    frequency_processes: int
    long_frames: int
    long_len: int
    long_processes: int
    joints: list[int]
    joints_processes: int
    mixed_processes: list[int]
    mixed_duration: float
    cars: list[int]
    car_frames: int
    snakes: list[int]
    snake_joints: int
    drones: int
    drone_duration: float


QUICK = Size(
    name="quick",
    rounds=1,
    duration=0.1,
    warm_up=0.02,
    frames=400,
    processes=[1, 2],
    frequencies=[100, 1000],
    frequency_processes=2,
    long_frames=2000,
    long_len=200,
    long_processes=2,
    joints=[100, 1000],
    joints_processes=2,
    mixed_processes=[2],
    mixed_duration=0.5,
    cars=[2, 4],
    car_frames=80,
    snakes=[1, 4],
    snake_joints=20,
    drones=50,
    drone_duration=0.5,
)

REDUCED = Size(
    name="reduced",
    rounds=3,
    duration=0.7,
    warm_up=0.2,
    frames=10000,
    processes=[1, 2, 4, 8, 16],
    frequencies=[100, 1000, 10000, 100000],
    frequency_processes=8,
    long_frames=100000,
    long_len=1000,
    long_processes=8,
    joints=[100, 1000, 10000, 100000, 1000000],
    joints_processes=2,
    mixed_processes=[2, 4, 8],
    mixed_duration=2.0,
    cars=[8, 16, 32, 67],
    car_frames=400,
    snakes=[1, 10, 100, 1000],
    snake_joints=100,
    drones=1000,
    drone_duration=3.0,
)

# of the thesis and of its follow-up, on 224 hardware threads
FULL = Size(
    name="full",
    rounds=3,
    duration=60.0,
    warm_up=1.0,
    frames=10000,
    processes=[1, 2, 4, 8, 16, 28, 56, 84, 112, 140, 168, 196, 224],
    frequencies=[100, 1000, 10000, 100000],
    frequency_processes=200,
    long_frames=1000000,
    long_len=10000,
    long_processes=200,
    joints=[100, 1000, 10000, 100000, 1000000],
    joints_processes=200,
    mixed_processes=[2, 8, 32, 112, 224],
    mixed_duration=60.0,
    cars=[67, 100, 150, 200, 250, 300],
    car_frames=400,
    snakes=[1, 10, 100, 1000, 10000],
    snake_joints=100,
    drones=1000,
    drone_duration=60.0,
)

SIZES = {size.name: size for size in (QUICK, REDUCED, FULL)}


@dataclass(frozen=True)
class Step:
    """One call of ycsb.measure; `told` is added to its cases."""

    workload: Workload
    protocols: list[str]
    processes: list[int]
    told: dict[str, Any]

    def seconds(self) -> float:
        w, n = self.workload, len(self.protocols)
        rows = n * len(self.processes) * w.rounds * (w.duration + w.warm_up + PAUSE_S)
        slots = 2 * w.history * w.frames
        return rows + START_S * sum(self.processes) + n * len(self.processes) * slots * _FILL_S

    def measure(self) -> list[Case]:
        told = {**self.told, "duration_s": self.workload.duration}
        return [{**told, **case} for case in measure(self.workload, self.protocols, self.processes)]


@dataclass(frozen=True)
class Group:
    name: str
    title: str
    steps: Callable[[Size, list[str]], list[Step]] | None = None
    scene: Callable[[Size], Iterator[Case]] | None = None
    scene_seconds: Callable[[Size], float] | None = None

    def seconds(self, size: Size, protocols: list[str]) -> float:
        if self.scene_seconds:
            return self.scene_seconds(size)
        return sum(step.seconds() for step in self.steps(size, protocols)) if self.steps else 0.0

    def measure(self, size: Size, protocols: list[str]) -> tuple[list[Case], list[str]]:
        """Its cases, and what had to be left out."""
        if self.scene:
            return list(self.scene(size)), []
        cases: list[Case] = []
        notes = []
        steps = self.steps(size, protocols) if self.steps else []
        with Bar(sum(step.seconds() for step in steps)) as bar:
            for step in steps:
                bar.begin("", weight=step.seconds())
                try:
                    cases += step.measure()
                except BenchError as error:
                    notes.append(f"left out, {step.workload.frames} frames, {','.join(step.protocols)}: {error}")
        for case in cases:
            if case["failures"]:
                why = next(r["first_failure"] for r in case["rounds"] if r["failures"])
                notes.append(f"{case['protocol']}, {case['processes']} processes: {case['failures']} failures: {why}")
        if steps and not cases:
            raise BenchError(f"{self.name}: nothing could be measured; {notes[0]}")
        return cases, notes


def _base(size: Size, **changes: Any) -> Workload:
    workload = Workload(frames=size.frames, duration=size.duration, warm_up=size.warm_up, rounds=size.rounds)
    return replace(workload, **changes)


def _threads(**changes: Any) -> Callable[[Size, list[str]], list[Step]]:
    """The thesis' main sweep: throughput and the rest over the number of processes."""

    def steps(size: Size, protocols: list[str]) -> list[Step]:
        return [Step(_base(size, **changes), protocols, size.processes, {})]

    return steps


def _frequency(size: Size, protocols: list[str]) -> list[Step]:
    n = [size.frequency_processes]
    return [Step(_base(size, frequency=float(hz)), protocols, n, {"frequency": hz}) for hz in size.frequencies]


def _long_chain(size: Size, protocols: list[str]) -> list[Step]:
    workload = _base(
        size,
        frames=size.long_frames,
        history=4,
        read_len=size.long_len,
        write_len=size.long_len,
        frequency=100.0,
        warm_up=max(size.warm_up, 10 * size.long_frames * 1e-6),
    )
    able = [name for name in protocols if name != "tf2" or size.long_len <= DEEPEST_TF2]
    told = {"frames": size.long_frames}
    return [Step(workload, [name], [size.long_processes], told) for name in able]


def _joints(size: Size, protocols: list[str]) -> list[Step]:
    """One protocol at a time: a million frames of each together are more than most memories."""
    steps = []
    for n in size.joints:
        workload = _base(size, frames=n, history=4, warm_up=max(size.warm_up, 2 * n * 1e-6))
        steps += [Step(workload, [name], [size.joints_processes], {"joints": n}) for name in protocols]
    return steps


def _mixed_rate(size: Size, protocols: list[str]) -> list[Step]:
    from ._protocols import names

    more = [name for name in ("shmtf-common",) if name in names() and name not in protocols]
    workload = replace(
        MIXED_RATE, duration=size.mixed_duration, warm_up=max(1.2, size.warm_up), rounds=size.rounds, check_every=1
    )
    return [Step(workload, [*protocols, *more], size.mixed_processes, {})]


def _cars(size: Size, protocols: list[str]) -> list[Step]:
    """A vehicle is a process: it looks up all the others, or writes its own frame."""
    steps = []
    for hz in (10.0, 100.0, 150.0):
        workload = _base(size, frames=size.car_frames, read_len=67, write_len=1, frequency=hz)
        steps.append(Step(workload, protocols, size.cars, {"frequency": hz}))
    return steps


GROUPS = [
    Group("ycsb-c", "YCSB-C: all read", _threads(read_ratio=1.0)),
    Group(
        "ycsb-a", "YCSB-A: half of the processes write, in the order in which lookups lock", _threads(read_ratio=0.5)
    ),
    Group("ycsb-a-opposite", "YCSB-A with opposite_write", _threads(read_ratio=0.5, opposite=True)),
    Group("ycsb-b", "YCSB-B: one operation in twenty writes", _threads(read_ratio=0.95)),
    Group("frequency", "The control frequency", _frequency),
    Group("long-chain", "Very long lookups and updates", _long_chain),
    Group("joints", "The number of joints", _joints),
    Group("mixed-rate", "One edge at 1 Hz, the others at 30 to 200 Hz", _mixed_rate),
    Group("cars", "Vehicles that see each other", _cars),
    Group("snakes", "Many snakes in one store", None, _scenes.snakes, _scenes.snakes_seconds),
    Group("drones", "Obstacles that are born while drones fly", None, _scenes.drones, _scenes.drones_seconds),
]
