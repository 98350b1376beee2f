# SPDX-License-Identifier: Apache-2.0
"""The board of the long run, as worker/board.h has it: words in a file that every member maps."""

from __future__ import annotations

import mmap
import os
import time

PAGE_WORDS, SINGLES, BUCKETS = 512, 48, 160
PAGE = 8 * PAGE_WORDS
OPS = (
    "one frame written", "one frame, late stamp", "16-frame chain", "16 frames, two groups", "1,000 frames", "births",
    "removals", "new parents", "cycles refused", "static or not", "declared", "cleared", "busy, not waited for",
    "latest", "at a time", "at a time without data", "16 frames of one snapshot", "16-edge lookups",
    "40 or 1,000 frames of one snapshot", "moving shapes", "full dumps", "expired snapshots", "woken by a change",
    "waits without one",
)  # fmt: skip
(SINGLE, _LATE, CHAIN, GROUPS, _BIG, BIRTH, REMOVE, _REPARENT, _CYCLE, _FLIP, _DECLARE, _CLEAR, BUSY, LATEST,
 AT_TIME, NO_ANSWER, SNAPSHOT, READ_CHAIN, _READ_BIG, _READ_SHAPE, DUMP, EXPIRED, WOKEN,
 TIMED_OUT) = range(len(OPS))  # fmt: skip
LUCK = {BUSY, NO_ANSWER, EXPIRED, TIMED_OUT}  #: what may not happen in a short run
COUNTERS = (
    "commits", "aborts", "helps", "recoveries", "rereads", "restarts", "waits", "late_dropped", "repeats",
)  # fmt: skip

_OVER, _STAMP, _VERSION, _SINGLE_STAMP = 0, 1, 2, 16
_SINGLE_VERSION, _PY_STAMP = _SINGLE_STAMP + SINGLES, _SINGLE_STAMP + 2 * SINGLES
_PY_VERSION = _SINGLE_STAMP + 3 * SINGLES
_PID, _STOPS, _VIOLATED, _OPS, _COUNTERS, _WORST, _READ, _WRITE, _TEXT = 0, 1, 2, 8, 32, 41, 64, 224, 448


class Board:
    """All words, and those that everybody shares."""

    def __init__(self, path: str, cells: int | None = None) -> None:
        with open(path, "r+b" if cells is None else "w+b") as file:
            if cells is not None:
                file.truncate((cells + 1) * PAGE)
            self._memory = mmap.mmap(file.fileno(), 0)
        self.words = memoryview(self._memory).cast("q")
        self.path = path
        self.cells = [Cell(self.words, k) for k in range(len(self.words) // PAGE_WORDS - 1)]

    @property
    def over(self) -> bool:
        return self.words[_OVER] != 0

    def end(self) -> None:
        self.words[_OVER] = 1

    @property
    def stamp(self) -> int:
        """The next stamp, which the C members take from here."""
        return self.words[_STAMP]

    def version(self, store: int = 0) -> int:
        """The last commit whose writer has been told so."""
        return self.words[_VERSION + store]

    def known_stamp(self, single: int) -> int:
        return max(self.words[_SINGLE_STAMP + single], self.words[_PY_STAMP + single])

    def known_version(self, single: int) -> int:
        return max(self.words[_SINGLE_VERSION + single], self.words[_PY_VERSION + single])

    def acknowledge(self, single: int, stamp: int, version: int) -> None:
        """Of the one member in Python that writes."""
        for at, value in ((_PY_STAMP + single, stamp), (_PY_VERSION + single, version)):
            if self.words[at] < value:
                self.words[at] = value


class Cell:
    """A member's page."""

    def __init__(self, words: memoryview, number: int) -> None:
        self._words = words[(number + 1) * PAGE_WORDS : (number + 2) * PAGE_WORDS]

    @property
    def ops(self) -> list[int]:
        return list(self._words[_OPS : _OPS + len(OPS)])

    @property
    def counters(self) -> list[int]:
        return list(self._words[_COUNTERS : _COUNTERS + len(COUNTERS)])

    @property
    def worst(self) -> tuple[int, int, int]:
        """Of a read, of a read in processor time, of a write; ns."""
        worst = self._words[_WORST : _WORST + 3]
        return worst[0], worst[1], worst[2]

    @property
    def reads(self) -> list[int]:
        """How many took how long; see bucket_ns."""
        return list(self._words[_READ : _READ + BUCKETS])

    @property
    def writes(self) -> list[int]:
        return list(self._words[_WRITE : _WRITE + BUCKETS])

    @property
    def violation(self) -> str | None:
        if not self._words[_VIOLATED]:
            return None
        return bytes(self._words[_TEXT:]).split(b"\0")[0].decode(errors="replace")

    def violate(self, text: str) -> None:
        data = text.encode()[:511].ljust(512, b"\0")
        self._words[_TEXT:] = memoryview(data).cast("q")
        self._words[_VIOLATED] = 1

    def begin(self) -> None:
        self._words[_PID] = os.getpid()

    def count(self, op: int) -> None:
        self._words[_OPS + op] += 1

    def add_counters(self, now: dict[str, int], last: dict[str, int]) -> None:
        for i, name in enumerate(COUNTERS):
            self._words[_COUNTERS + i] += now[name] - last.get(name, 0)

    def will_stop(self) -> None:
        """Before SIGSTOP: what is under way is not timed."""
        self._words[_STOPS] += 1

    def start(self) -> tuple[int, int, int]:
        return self._words[_STOPS], time.thread_time_ns(), time.monotonic_ns()

    def took(self, start: tuple[int, int, int], read: bool) -> None:
        wall, cpu = time.monotonic_ns() - start[2], time.thread_time_ns() - start[1]
        if self._words[_STOPS] != start[0]:
            return
        self._words[(_READ if read else _WRITE) + bucket_of(wall)] += 1
        for i, ns in ((0, wall), (1, cpu)) if read else ((2, wall),):
            if ns > self._words[_WORST + i]:
                self._words[_WORST + i] = ns


def bucket_of(ns: int) -> int:
    """Four for each power of two."""
    ns = max(ns, 4)
    log = ns.bit_length() - 1
    return min(4 * log + (ns >> (log - 2) & 3), BUCKETS - 1)


def bucket_ns(bucket: int) -> int:
    """Where a bucket ends."""
    log, quarter = divmod(bucket, 4)
    return (5 + quarter << log) // 4


def quantile_ns(histogram: list[int], q: float) -> int | None:
    """At most so long took a share q of them; None: there are none."""
    total, so_far = sum(histogram), 0
    for bucket, n in enumerate(histogram):
        so_far += n
        if n and so_far >= q * total:
            return bucket_ns(bucket)
    return None
