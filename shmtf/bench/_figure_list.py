# SPDX-License-Identifier: Apache-2.0
"""The figures: of the thesis (5.2 to 5.28), of its follow-up, and some that neither has."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

Unit = Literal["per second", "ns", "share"]


@dataclass(frozen=True)
class Figure:
    key: str  # "5.2": the thesis' number; a word: not in the thesis
    group: str
    title: str
    question: str
    x: str  # a number of the case
    x_label: str
    y: str  # a spread of the case; "key.q": quantile q of histogram `key`; or "operations_per_s"
    y_label: str
    unit: Unit
    reading: str = ""
    leave_out: tuple[str, ...] = ()  # protocols whose values hide the others
    log_x: bool = True
    log_y: bool = False
    only: tuple[tuple[str, float], ...] = ()  # cases with these numbers
    points: bool = False  # one value per protocol: no x

    @property
    def file(self) -> str:
        return f"figure-{self.key.replace('.', '-')}.png"


GIANTS = ("giant", "giant-atomic", "tf2")
_BETTER_UP = "Higher is better."
_BETTER_DOWN = "Lower is better."
_A = "half of the processes read, half write"
_SAME = "the order in which lookups lock (opposite_write off)"
_OPPOSITE = "the order opposite to that in which lookups lock (opposite_write on)"


def _over_processes(
    key: str, group: str, title: str, question: str, y: str, y_label: str, unit: Unit, **more: object
) -> Figure:
    return Figure(key, group, title, question, "processes", "processes", y, y_label, unit, **more)  # type: ignore[arg-type]


def _throughput(key: str, group: str, title: str, what: str, y: str = "operations_per_s") -> Figure:
    label = {"reads_per_s": "lookups/s", "writes_per_s": "updates/s"}.get(y, "operations/s")
    return _over_processes(
        key, group, title, f"How many {label[:-2]} does {what} get done?", y, label, "per second", reading=_BETTER_UP
    )


def _latency(key: str, group: str, title: str, kind: str, without_giants: bool) -> Figure:
    noun = "lookup" if kind == "read" else "update"
    question = f"How long does {'a' if kind == 'read' else 'an'} {noun} take on average as processes are added?"
    if without_giants:
        return _over_processes(
            key,
            group,
            f"{title}, without the single locks",
            question,
            f"{kind}_ns.mean",
            f"{noun}, mean",
            "ns",
            reading=f"{_BETTER_DOWN} The axis is linear.",
            leave_out=GIANTS,
        )
    reading = f"{_BETTER_DOWN} The axis is logarithmic; a straight rise is a lock that everybody queues for."
    return _over_processes(
        key, group, title, question, f"{kind}_ns.mean", f"{noun}, mean", "ns", reading=reading, log_y=True
    )


def _aborts(key: str, group: str, order: str) -> Figure:
    return _over_processes(
        key,
        group,
        "Abort rate",
        f"How often is an update begun again, when updates lock in {order}?",
        "retries_per_write",
        "retries per update",
        "share",
        reading=f"{_BETTER_DOWN} Only protocols that give up a lock instead of waiting have any.",
    )


def _delay(key: str, group: str, name: str, without_giants: bool) -> Figure:
    return _over_processes(
        key,
        group,
        f"{name}: delay" + ", without the single locks" * without_giants,
        "How old is the oldest record that a lookup used?",
        "age_oldest_ns.mean",
        "now - oldest stamp used, mean",
        "ns",
        reading=f"{_BETTER_DOWN} It falls with every update that is done, so it shows who writes often.",
        leave_out=GIANTS if without_giants else (),
        log_y=not without_giants,
    )


def _synchronicity(key: str, group: str, name: str) -> Figure:
    return _over_processes(
        key,
        group,
        f"{name}: synchronicity",
        "How far apart are the stamps that one lookup used?",
        "deviation_ns.mean",
        "standard deviation of the stamps, mean",
        "ns",
        reading=f"{_BETTER_DOWN} Frames are written at random, so it falls with the number of updates, too.",
        log_y=True,
    )


_LONG = Figure(
    "5.22",
    "long-chain",
    "Very long lookups and updates",
    "How long do operations over a large part of a very long chain take?",
    "frames",
    "frames",
    "read_ns.mean",
    "lookup, mean",
    "ns",
    reading=f"{_BETTER_DOWN} One row per protocol; 100 operations per second and process are asked for.",
    log_y=True,
    points=True,
)

_THESIS = [
    _throughput("5.2", "ycsb-c", "YCSB-C: throughput", "a tree that everybody only reads"),
    _latency("5.3", "ycsb-c", "YCSB-C: latency", "read", False),
    _latency("5.4", "ycsb-c", "YCSB-C: latency", "read", True),
    _throughput("5.5", "ycsb-a-opposite", "YCSB-A, opposite_write: throughput", f"a tree where {_A}, in {_OPPOSITE},"),
    _throughput("5.6", "ycsb-a", "YCSB-A: throughput", f"a tree where {_A}, in {_SAME},"),
    _aborts("5.7", "ycsb-a-opposite", _OPPOSITE),
    _aborts("5.8", "ycsb-a", _SAME),
    _latency("5.9", "ycsb-a-opposite", "YCSB-A, opposite_write: latency of lookups", "read", False),
    _latency("5.10", "ycsb-a-opposite", "YCSB-A, opposite_write: latency of lookups", "read", True),
    _latency("5.11", "ycsb-a-opposite", "YCSB-A, opposite_write: latency of updates", "write", False),
    _latency("5.12", "ycsb-a-opposite", "YCSB-A, opposite_write: latency of updates", "write", True),
    _latency("5.13", "ycsb-a", "YCSB-A: latency of lookups", "read", False),
    _latency("5.14", "ycsb-a", "YCSB-A: latency of lookups", "read", True),
    _latency("5.15", "ycsb-a", "YCSB-A: latency of updates", "write", False),
    _latency("5.16", "ycsb-a", "YCSB-A: latency of updates", "write", True),
    _throughput("5.17", "ycsb-a-opposite", "YCSB-A, opposite_write: lookups", f"a tree where {_A}", "reads_per_s"),
    _throughput("5.18", "ycsb-a-opposite", "YCSB-A, opposite_write: updates", f"a tree where {_A}", "writes_per_s"),
    _throughput("5.19", "ycsb-a", "YCSB-A: lookups", f"a tree where {_A}", "reads_per_s"),
    _throughput("5.20", "ycsb-a", "YCSB-A: updates", f"a tree where {_A}", "writes_per_s"),
    Figure(
        "5.21",
        "frequency",
        "Control frequency and latency",
        "How long does a lookup take when every process does something at a fixed rate?",
        "frequency",
        "operations per second of each process",
        "read_ns.mean",
        "lookup, mean",
        "ns",
        reading=f"{_BETTER_DOWN} To the left, processes sleep between operations; caches are cold after a sleep.",
        log_y=True,
    ),
    _LONG,
    replace(_LONG, key="5.22-updates", y="write_ns.mean", y_label="update, mean"),
    _delay("5.23", "ycsb-a", "YCSB-A", False),
    _delay("5.24", "ycsb-a", "YCSB-A", True),
    _delay("5.25", "ycsb-b", "YCSB-B", False),
    _delay("5.26", "ycsb-b", "YCSB-B", True),
    _synchronicity("5.27", "ycsb-a", "YCSB-A"),
    _synchronicity("5.28", "ycsb-b", "YCSB-B"),
]


def _cars(hz: int) -> Figure:
    return Figure(
        f"cars-{hz}",
        "cars",
        f"Vehicles at {hz} Hz",
        "How long does a lookup over 67 vehicles take as vehicles are added, each a process?",
        "processes",
        "vehicles (processes)",
        "read_ns.p99",
        "lookup, 99 %",
        "ns",
        reading=f"{_BETTER_DOWN} Half of the processes look up, half write their one frame, {hz} times a second each.",
        log_y=True,
        only=(("frequency", hz),),
    )


def _mixed(key: str, y: str, y_label: str, question: str, reading: str) -> Figure:
    return Figure(
        key, "mixed-rate", "One slow edge among fast ones", question, "processes", "processes", y, y_label, "ns",
        reading=reading, log_y=True,
    )  # fmt: skip


def _joints(kind: str) -> Figure:
    noun = "lookup" if kind == "read" else "update"
    return Figure(
        f"joints-{kind}",
        "joints",
        f"Number of joints: {noun}s",
        f"What does the size of the tree do to {noun}s of the same length?",
        "joints",
        "joints",
        f"{kind}_ns.p50",
        f"{noun}, median",
        "ns",
        reading=f"{_BETTER_DOWN} Starts are random: with more joints, fewer of them are in a cache.",
        log_y=True,
    )


def _drones(key: str, y: str, y_label: str, question: str) -> Figure:
    return Figure(
        key, "drones", "Births beside lookups", question, "at_s", "seconds of the flight", y, y_label, "ns",
        reading=f"{_BETTER_DOWN} Births: a new frame every 5 ms; updates: a known frame instead. From Python.",
        log_x=False,
    )  # fmt: skip


def _snakes(kind: str) -> Figure:
    noun = "lookup" if kind == "read" else "update"
    return Figure(
        f"snakes-{kind}",
        "snakes",
        f"Many snakes: {noun}s",
        "Do robots that share a store, but no frame, disturb each other?",
        "snakes",
        "snakes",
        f"{kind}_ns.p50",
        f"{noun}, median",
        "ns",
        reading=f"{_BETTER_DOWN} One process reads, one writes, each over 16 joints of a random snake. From Python.",
    )


_OTHERS = [
    _throughput("ycsb-b", "ycsb-b", "YCSB-B: throughput", "a tree where one operation in twenty writes"),
    _over_processes(
        "ycsb-a-tail",
        "ycsb-a",
        "YCSB-A: slow lookups",
        "How long does the slowest lookup in a thousand take?",
        "read_ns.p99_9",
        "lookup, 99.9 %",
        "ns",
        reading=f"{_BETTER_DOWN} With more processes than CPUs, a process that is scheduled away is part of it.",
        log_y=True,
    ),
    _over_processes(
        "mixed-reads",
        "ycsb-a",
        "YCSB-A: mixed reads",
        "How many lookups saw half an update?",
        "mixed_reads",
        "lookups with edges of two updates",
        "share",
        reading="0 is right; anything else is a pose that never was.",
    ),
    _joints("read"),
    _joints("write"),
    _mixed(
        "mixed-rate-age",
        "age_mean_ns.p50",
        "now - mean stamp used, median",
        "How old is what a lookup uses, on the average of its edges, when one of them is written once a second?",
        f"{_BETTER_DOWN} The slow edge alone is up to 1 s old; a lookup at the newest common time takes all edges "
        "back to it.",
    ),
    _mixed(
        "mixed-rate-latency",
        "read_ns.p99",
        "lookup, 99 %",
        "What does a lookup cost then?",
        f"{_BETTER_DOWN} A lookup at a common time searches the fast edges' histories.",
    ),
    _cars(10),
    _cars(100),
    _cars(150),
    _snakes("read"),
    _snakes("write"),
    _drones("drones-read", "read_ns.p99", "lookup, 99 %", "Do births of frames slow lookups down?"),
    _drones("drones-write", "write_ns.p50", "write, median", "What does a birth cost beside an update?"),
]

FIGURES: list[Figure] = [*_THESIS, *_OTHERS]
