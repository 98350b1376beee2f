# SPDX-License-Identifier: Apache-2.0
"""The calls of `shmtf-bench micro` on tf2_py; a program for the interpreter that has it, started by _peers.Helper.

It fills its trees, says which rows it has, and measures each of them once for every line of its input."""

from __future__ import annotations

import json
import math
import os
import random
import sys
from collections.abc import Callable
from typing import Any

from ._timing import ns_per_call

RECENT_NS = 200_000_000


class Tree:
    """The snake of bench/native/snake.h in a tf2_py.BufferCore."""

    def __init__(self, told: dict[str, Any], cache_s: float, staggered: bool) -> None:
        import genpy
        import tf2_py
        from geometry_msgs.msg import TransformStamped

        self._time = genpy.Time
        self.new = TransformStamped
        self.period_ns: int = told["period_ns"]
        self.names = [f"link_{i:05}" for i in range(told["frames"])]
        self.core = tf2_py.BufferCore(genpy.Duration(cache_s))
        phases = [7919000 * i % self.period_ns if staggered else 0 for i in range(len(self.names))]
        self.newest_ns = [0] * len(self.names)
        messages = [self.message(child, 0) for child in range(1, len(self.names))]
        for k in range(told["history"]):
            for child, message in enumerate(messages, 1):
                stamp = told["first_ns"] + k * self.period_ns + phases[child]
                self.newest_ns[child] = stamp
                message.header.stamp = self.time(stamp)
                self.core.set_transform(message, "shmtf-bench")

    def time(self, ns: int) -> Any:
        return self._time(ns // 10**9, ns % 10**9)

    def message(self, child: int, stamp_ns: int) -> Any:
        message = self.new()
        message.header.frame_id = self.names[child - 1]
        message.child_frame_id = self.names[child]
        message.header.stamp = self.time(stamp_ns)
        half = 0.25 * math.sin(3.1e-9 * (stamp_ns % 10**12) + 0.7 * child)
        t, r = message.transform.translation, message.transform.rotation
        t.x, t.y, t.z = 0.1, 0.2, 0.3
        r.z, r.w = math.sin(half), math.cos(half)
        return message

    def next_stamp(self, child: int) -> int:
        self.newest_ns[child] += self.period_ns
        return self.newest_ns[child]


class Rows:
    """(name, what, our row beside it, call, arguments)."""

    def __init__(self, told: dict[str, Any]) -> None:
        self.depth: int = told["depth"]
        self.write_len: int = told["write_len"]
        self.history: int = told["history"]
        self.random = random.Random(1)
        history_s = told["history"] * told["period_ns"] * 1e-9
        self.together = Tree(told, 1e6, False)
        self.staggered = Tree(told, 1e6, True)
        self.written = Tree(told, history_s, True)
        self.newest_ns = min(self.staggered.newest_ns[1:])
        lookup, latest = self.staggered.core.lookup_transform_core, self.together.core.lookup_transform_core
        can, set_1 = self.staggered.core.can_transform_core, self.written.core.set_transform
        self.table: list[tuple[str, str, str, Callable[..., Any], Callable[[int], list[tuple[Any, ...]]]]] = [
            ("tf2_py latest", "lookup_transform_core(Time(0)), all frames share stamps", "latest", latest, self.pairs),
            ("tf2_py recent", "lookup_transform_core, newest 0.2 s", "recent", lookup, self.pairs_at),
            ("tf2_py common", "lookup_transform_core(Time(0)), staggered stamps", "common", lookup, self.pairs),
            ("tf2_py can", "can_transform_core(Time(0)), staggered stamps", "can", can, self.pairs),
            ("tf2_py set 1", "set_transform of a ready message", "set 1", set_1, self.one),
            ("tf2_py make 1", "build a message and set_transform it", "make 1", self.make, self.children),
            ("tf2_py set 16", "16 set_transform of ready messages", "set 16", self.set_many, self.many),
            ("tf2_py make 16", "build 16 messages, set_transform each", "make 16", self.make_many, self.children),
        ]

    def _first(self) -> int:
        return self.random.randrange(len(self.written.names) - max(self.depth, self.write_len))

    def _pair(self) -> tuple[str, str]:
        first = self._first()
        return self.staggered.names[first], self.staggered.names[first + self.depth]

    def pairs(self, n: int) -> list[tuple[Any, ...]]:
        zero = self.staggered.time(0)
        return [(*self._pair(), zero) for _ in range(n)]

    def pairs_at(self, n: int) -> list[tuple[Any, ...]]:
        tree = self.staggered
        span = min(RECENT_NS, (self.history - 2) * tree.period_ns) or 1
        return [(*self._pair(), tree.time(self.newest_ns - self.random.randrange(span))) for _ in range(n)]

    def _next(self, child: int) -> Any:
        return self.written.message(child, self.written.next_stamp(child))

    def one(self, n: int) -> list[tuple[Any, ...]]:
        return [(self._next(1 + self._first()), "shmtf-bench") for _ in range(n)]

    def many(self, n: int) -> list[tuple[Any, ...]]:
        firsts = (self._first() for _ in range(n))
        return [([self._next(i) for i in range(first + 1, first + 1 + self.write_len)],) for first in firsts]

    def children(self, n: int) -> list[tuple[Any, ...]]:
        return [(1 + self._first(),) for _ in range(n)]

    def make(self, child: int) -> None:
        tree = self.written
        message = tree.new()
        message.header.frame_id, message.child_frame_id = tree.names[child - 1], tree.names[child]
        message.header.stamp = tree.time(tree.next_stamp(child))
        translation, rotation = message.transform.translation, message.transform.rotation
        translation.x, translation.y, translation.z = 0.1, 0.2, 0.3
        rotation.w = 1.0
        tree.core.set_transform(message, "shmtf-bench")

    def make_many(self, first: int) -> None:
        for child in range(first, first + self.write_len):
            self.make(child)

    def set_many(self, messages: list[Any]) -> None:
        set_transform = self.written.core.set_transform
        for message in messages:
            set_transform(message, "shmtf-bench")


def main(args: list[str]) -> int:
    told = json.loads(args[0])
    rows = Rows(told)
    print(json.dumps([row[:3] for row in rows.table]), flush=True)
    for line in sys.stdin:
        asked = json.loads(line)
        os.sched_setaffinity(0, {asked["cpu"]})
        times = {name: ns_per_call(call, make, asked["round_ns"]) for name, _, _, call, make in rows.table}
        print(json.dumps(times), flush=True)
    return 0
