# SPDX-License-Identifier: Apache-2.0
"""The calls of `shmtf-bench micro` as a Python program makes them."""

from __future__ import annotations

import math
import os
import random
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import psutil

import shmtf

from .. import _bench
from . import BenchError
from ._peers import Helper, tf2_python
from ._report import spread
from ._timing import ns_per_call

WRITE_LEN = 16
TF2_RECORD_BYTES = 160  # about what it keeps per record
PERIOD_NS = 10_000_000
RECENT_NS = 200_000_000

_Arguments = list[tuple[Any, ...]]


class Snake:
    """The chain of frames of bench/native/snake.h in a store of its own, and arguments for calls on it."""

    def __init__(self, role: str, frames: int, history: int, depth: int) -> None:
        self.depth = depth
        self.names = [f"link_{i:05}" for i in range(frames)]
        self.random = random.Random(1)
        self.newest = [0] * frames
        self.rounds = 2 * history
        name = f"shmtf-bench-{os.getpid()}-{role}"
        self.store = shmtf.Store.create(name, frames, history, cache_time=None, stream_bytes=0)
        try:
            self._fill()
        finally:
            shmtf.Store.unlink(name)  # at once: nothing is left however this process ends

    def _fill(self) -> None:
        self.end = shmtf.now()
        for k in range(self.rounds, 0, -1):
            start = self.end - k * PERIOD_NS
            for first in range(1, len(self.names), WRITE_LEN):
                children = range(first, min(first + WRITE_LEN, len(self.names)))
                self.store.set_transforms([self._transform(i, start + 7919000 * i % PERIOD_NS) for i in children])

    def _transform(self, child: int, stamp: int) -> shmtf.Transform:
        self.newest[child] = stamp
        half = 0.25 * math.sin(3.1e-9 * (stamp % 10**12) + 0.7 * child)
        rotation = (0.0, 0.0, math.sin(half), math.cos(half))
        return shmtf.Transform(self.names[child - 1], self.names[child], stamp, (0.1, 0.2, 0.3), rotation)

    def _next(self, child: int) -> shmtf.Transform:
        return self._transform(child, self.newest[child] + PERIOD_NS)

    def _first(self) -> int:
        return self.random.randrange(len(self.names) - max(self.depth, WRITE_LEN))

    def pairs(self, n: int) -> _Arguments:
        return [(self.names[i], self.names[i + self.depth]) for i in (self._first() for _ in range(n))]

    def pairs_at(self, n: int) -> _Arguments:
        newest = self.end - PERIOD_NS
        span = min(RECENT_NS, (self.rounds // 2 - 2) * PERIOD_NS) or 1
        return [(*pair, newest - self.random.randrange(span)) for pair in self.pairs(n)]

    def one(self, n: int) -> _Arguments:
        return [(self._next(1 + self._first()),) for _ in range(n)]

    def sixteen(self, n: int) -> _Arguments:
        firsts = (self._first() for _ in range(n))
        return [([self._next(i) for i in range(first + 1, first + 1 + WRITE_LEN)],) for first in firsts]

    def children(self, n: int) -> _Arguments:
        return [(1 + self._first(),) for _ in range(n)]

    def _built(self, child: int) -> shmtf.Transform:
        self.newest[child] += PERIOD_NS
        parent, name = self.names[child - 1], self.names[child]
        return shmtf.Transform(parent, name, self.newest[child], (0.1, 0.2, 0.3), (0.0, 0.0, 0.0, 1.0))

    def make(self, child: int) -> None:
        self.store.set_transform(self._built(child))

    def make_many(self, first: int) -> None:
        self.store.set_transforms([self._built(child) for child in range(first, first + WRITE_LEN)])


@dataclass(frozen=True)
class _Row:
    name: str
    what: str
    call: Callable[..., Any]
    make: Callable[[int], _Arguments]  # the arguments of n calls; not timed
    floor: str | None  # the row in C that does this work without a store


def _rows(read: Snake, write: Snake) -> list[_Row]:
    r, w = read.store, write.store
    pairs = read.pairs
    return [
        _Row("call", "a C function that takes two names and does nothing", _bench.nothing, pairs, None),
        _Row("latest", "lookup_latest_transform", r.lookup_latest_transform, pairs, "floor seqlock"),
        _Row("recent", "lookup_transform, newest 0.2 s", r.lookup_transform, read.pairs_at, "floor recent"),
        _Row("common", "lookup_transform, newest common time, staggered", r.lookup_transform, pairs, "floor newest"),
        _Row("can", "can_transform, newest common time", r.can_transform, pairs, "floor newest"),
        _Row("set 1", "set_transform of a ready Transform", w.set_transform, write.one, "floor write 1"),
        _Row("make 1", "build a Transform and set_transform it", write.make, write.children, "floor write 1"),
        _Row("set 16", "set_transforms of 16 ready Transforms", w.set_transforms, write.sixteen, "floor write 16"),
        _Row("make 16", "build 16 Transforms and set_transforms", write.make_many, write.children, "floor write 16"),
    ]


class _Tf2:
    """tf2_py's rows, measured in its interpreter; or why there are none.  It may end at any time: ours go on."""

    def __init__(self, frames: int, history: int, depth: int) -> None:
        self.rows: list[list[str]] = []  # name, what, our row beside it
        self.times: dict[str, list[float]] = {}
        self.missing = ""
        self._helper: Helper | None = None
        python, bytes_needed = tf2_python(8), 3 * frames * history * TF2_RECORD_BYTES
        free = psutil.virtual_memory().available
        if python is None:
            return
        if bytes_needed > free / 2:
            self.missing = f"{bytes_needed / 1e6:.0f} MB for three trees, and {free / 1e6:.0f} MB are free"
            return
        told = {"frames": frames, "history": history, "depth": depth, "write_len": WRITE_LEN, "period_ns": PERIOD_NS}
        self._helper = Helper(python, "_peer_tf2", {**told, "first_ns": shmtf.now() - history * PERIOD_NS})

    def wait(self) -> None:
        """Until its trees are full."""
        if self._helper:
            self._try(lambda helper: self.rows.extend(helper.answer()))
            self.times = {row[0]: [] for row in self.rows}

    def measure(self, round_ns: float, cpu: int) -> None:
        self._try(lambda helper: self._add(helper.ask({"round_ns": round_ns, "cpu": cpu})))

    def _add(self, times: dict[str, float]) -> None:
        for name, ns in times.items():
            self.times[name].append(ns)

    def _try(self, use: Callable[[Helper], None]) -> None:
        if self._helper is None:
            return
        try:
            use(self._helper)
        except BenchError as error:
            self.missing, self.rows = str(error), []
            self.close()

    def close(self) -> None:
        if self._helper:
            self._helper.close()
        self._helper = None


def _measure(rows: list[_Row], tf2: _Tf2 | None, rounds: int, round_ns: float, cpu: int) -> dict[str, list[float]]:
    times: dict[str, list[float]] = {row.name: [] for row in rows}
    if tf2:
        tf2.wait()
    _bench.pin(cpu)
    try:
        for _ in range(rounds):
            for row in rows:
                times[row.name].append(ns_per_call(row.call, row.make, round_ns))
            if tf2:
                tf2.measure(round_ns, cpu)
    finally:
        _bench.pin(-1)
    return times


def _result(
    name: str,
    what: str,
    peer: str | None,
    beside: str | None,
    times: list[float],
    floor: str | None,
    floors: dict[str, float],
) -> dict[str, Any]:
    ns = spread(times)
    return {
        "engine": "python",
        "peer": peer,
        "name": name,
        "what": what,
        "beside": beside,
        "ns": ns,
        "floor": f"{floor} + call" if floor else None,
        "ratio": ns["median"] / floors[floor] if floor else None,
    }


def python_rows(
    frames: int,
    history: int,
    depth: int,
    rounds: int,
    round_ns: float,
    cpu: int,
    floors: dict[str, float],
    peers: bool,
) -> tuple[list[dict[str, Any]], str] | None:
    """Rows like those of _bench.micro, and why a peer that is installed has none.  Their floor is that of the work in C
    and of the call together.  None: shared memory is too small."""
    tf2 = _Tf2(frames, history, depth) if peers else None  # it fills its trees while we fill ours
    try:
        read, write = Snake("read", frames, history, depth), Snake("write", frames, history, depth)
        rows = _rows(read, write)
        times = _measure(rows, tf2, rounds, round_ns, cpu)
    except shmtf.StoreFullError:
        return None
    finally:
        if tf2:
            tf2.close()
    read.store.close()
    write.store.close()
    call = spread(times["call"])["median"]
    with_call = {name: ns + call for name, ns in floors.items()}
    floor_of = {row.name: row.floor for row in rows}
    result = [_result(row.name, row.what, None, None, times[row.name], row.floor, with_call) for row in rows]
    if tf2 is None:
        return result, ""
    for name, what, beside in tf2.rows:
        result.append(_result(name, what, "tf2_py", beside, tf2.times[name], floor_of[beside], with_call))
    return result, tf2.missing
