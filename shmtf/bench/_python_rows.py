# SPDX-License-Identifier: Apache-2.0
"""The calls of `shmtf-bench micro` as a Python program makes them."""

from __future__ import annotations

import math
import os
import random
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import shmtf

from .. import _bench
from ._report import spread

CHAIN = 16
BATCH = 500  # calls between two looks at the clock
PERIOD_NS = 10_000_000
RECENT_NS = 200_000_000

_Arguments = list[tuple[Any, ...]]


class Snake:
    """The chain of frames of bench/native/snake.h in a store of its own, and arguments for calls on it."""

    def __init__(self, role: str, frames: int, history: int) -> None:
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
            for first in range(1, len(self.names), CHAIN):
                children = range(first, min(first + CHAIN, len(self.names)))
                self.store.set_transforms([self._transform(i, start + 7919000 * i % PERIOD_NS) for i in children])

    def _transform(self, child: int, stamp: int) -> shmtf.Transform:
        self.newest[child] = stamp
        half = 0.25 * math.sin(3.1e-9 * (stamp % 10**12) + 0.7 * child)
        rotation = (0.0, 0.0, math.sin(half), math.cos(half))
        return shmtf.Transform(self.names[child - 1], self.names[child], stamp, (0.1, 0.2, 0.3), rotation)

    def _next(self, child: int) -> shmtf.Transform:
        return self._transform(child, self.newest[child] + PERIOD_NS)

    def _first(self) -> int:
        return self.random.randrange(len(self.names) - CHAIN)

    def pairs(self, n: int) -> _Arguments:
        return [(self.names[i], self.names[i + CHAIN]) for i in (self._first() for _ in range(n))]

    def pairs_at(self, n: int) -> _Arguments:
        newest = self.end - PERIOD_NS
        span = min(RECENT_NS, (self.rounds // 2 - 2) * PERIOD_NS) or 1
        return [(*pair, newest - self.random.randrange(span)) for pair in self.pairs(n)]

    def one(self, n: int) -> _Arguments:
        return [(self._next(1 + self._first()),) for _ in range(n)]

    def sixteen(self, n: int) -> _Arguments:
        firsts = (self._first() for _ in range(n))
        return [([self._next(i) for i in range(first + 1, first + 1 + CHAIN)],) for first in firsts]


# One loop per number of arguments: a call with a star would be measured too.  By this thread's processor time: what
# other processes do meanwhile does not count, except to the caches.


def _time_1(call: Callable[..., Any], arguments: _Arguments) -> int:
    start = time.thread_time_ns()
    for (a,) in arguments:
        call(a)
    return time.thread_time_ns() - start


def _time_2(call: Callable[..., Any], arguments: _Arguments) -> int:
    start = time.thread_time_ns()
    for a, b in arguments:
        call(a, b)
    return time.thread_time_ns() - start


def _time_3(call: Callable[..., Any], arguments: _Arguments) -> int:
    start = time.thread_time_ns()
    for a, b, c in arguments:
        call(a, b, c)
    return time.thread_time_ns() - start


_TIME = {1: _time_1, 2: _time_2, 3: _time_3}


def _time_loop(arguments: _Arguments) -> int:
    start = time.thread_time_ns()
    for _ in arguments:
        pass
    return time.thread_time_ns() - start


@dataclass(frozen=True)
class _Row:
    name: str
    what: str
    call: Callable[..., Any]
    make: Callable[[int], _Arguments]  # the arguments of n calls; not timed
    floor: str | None  # the row in C that does this work without a store

    def measure(self, round_ns: float) -> float:
        """ns per call, the loop around it subtracted."""
        total = calls = 0
        self.call(*self.make(1)[0])
        while total < round_ns:
            arguments = self.make(BATCH)
            total += _TIME[len(arguments[0])](self.call, arguments) - _time_loop(arguments)
            calls += BATCH
        return total / calls


def _rows(read: Snake, write: Snake) -> list[_Row]:
    r, w = read.store, write.store
    return [
        _Row("call", "a C function that takes two names and does nothing", _bench.nothing, read.pairs, None),
        _Row("latest", "lookup_latest_transform", r.lookup_latest_transform, read.pairs, "floor seqlock"),
        _Row("recent", "lookup_transform, newest 0.2 s", r.lookup_transform, read.pairs_at, "floor recent"),
        _Row(
            "common",
            "lookup_transform, newest common time, staggered stamps",
            r.lookup_transform,
            read.pairs,
            "floor newest",
        ),
        _Row("can", "can_transform, newest common time", r.can_transform, read.pairs, "floor newest"),
        _Row("set 1", "set_transform of a ready Transform", w.set_transform, write.one, "floor write 1"),
        _Row("set 16", "set_transforms of 16 ready Transforms", w.set_transforms, write.sixteen, "floor write 16"),
    ]


def python_rows(
    frames: int, history: int, rounds: int, round_ns: float, floors: dict[str, float]
) -> list[dict[str, Any]] | None:
    """Rows like those of _bench.micro.  Their floor is that of the work in C and of the call together.  None: shared
    memory is too small."""
    try:
        read, write = Snake("read", frames, history), Snake("write", frames, history)
    except shmtf.StoreFullError:
        return None
    rows = _rows(read, write)
    times: dict[str, list[float]] = {row.name: [] for row in rows}
    for _ in range(rounds):
        for row in rows:
            times[row.name].append(row.measure(round_ns))
    read.store.close()
    write.store.close()
    call = spread(times["call"])["median"]
    result = []
    for row in rows:
        ns = spread(times[row.name])
        floor = floors[row.floor] + call if row.floor in floors else None
        result.append(
            {
                "engine": "python",
                "name": row.name,
                "what": row.what,
                "ns": ns,
                "floor": f"{row.floor} + call" if floor else None,
                "ratio": ns["median"] / floor if floor else None,
            }
        )
    return result
