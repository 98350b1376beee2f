# SPDX-License-Identifier: Apache-2.0
"""history_replay on histories made by hand: each anomaly is rejected, the legal history next to it is accepted.

Tier: test. All but a few are about two frames, X and Y, below the world.
"""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path

import log
import pytest
from log import Entry, Item

X, Y = log.FIRST_BANK, log.FIRST_BANK + 1
A, B = log.FIRST_FREE, log.FIRST_FREE + 1
HANDLE = {name: 2 << 24 | name for name in range(log.N_NAMES)}
SEEN = log.VERSION | log.IN_SNAPSHOT

Judge = Callable[[list[Entry]], str]


@pytest.fixture
def judge(replay: Callable[[Path], subprocess.CompletedProcess[str]], tmp_path: Path) -> Judge:
    """ "": accepted; else what was said."""

    def run(entries: list[Entry]) -> str:
        log.write(tmp_path / "log", entries)
        done = replay(tmp_path / "log")
        assert done.returncode in {0, 1}, done.stdout + done.stderr
        assert (done.returncode == 1) == ("VIOLATION" in done.stdout), done.stdout
        return done.stdout if done.returncode else ""

    return run


def write(begin: int, end: int, version: int, values: dict[int, float], parent: int = log.WORLD, **more: int) -> Entry:
    items = [Item(name, parent, 0, HANDLE[name], HANDLE[parent], stamp=begin * 10, x=x) for name, x in values.items()]
    entry = Entry(log.SET, begin, end, version, 0, version, flags=log.COMMITTED | log.VERSION, items=items)
    return change(entry, **more)


def change(entry: Entry, **fields: int) -> Entry:
    for key, value in fields.items():
        assert hasattr(entry, key)
        setattr(entry, key, value)
    return entry


def killed(begin: int, values: dict[int, float], high: int = 0) -> Entry:
    return write(begin, 0, 0, values, status=log.PENDING, flags=0, high=high)


def read(begin: int, end: int, version: int, name: int, x: float, stamp: int, flags: int = log.VERSION) -> Entry:
    items = [Item(flags=0, child_handle=HANDLE[name], parent_handle=HANDLE[log.WORLD], stamp=stamp)]
    return Entry(log.LATEST, begin, end, version, 0, version, x=x, flags=flags, source=name, items=items)


def lookup_fails(begin: int, end: int, name: int, low: int, high: int, status: int = log.LOOKUP) -> Entry:
    return Entry(log.LATEST, begin, end, 0, low, high, status=status, source=name)


def transfer(begin: int, end: int, version: int, name: int, seen: float, x: float) -> Entry:
    item = Item(name, stamp=begin * 10, x=x, seen_x=seen)
    return Entry(log.TRANSFER, begin, end, version, 0, version, flags=log.COMMITTED | log.VERSION, items=[item])


def remove(begin: int, end: int, version: int, name: int) -> Entry:
    return Entry(log.REMOVE, begin, end, version, 0, version, flags=log.COMMITTED | log.VERSION, target=name)


def frames(begin: int, end: int, version: int, names: list[int]) -> Entry:
    items = [Item(child_handle=HANDLE[name]) for name in names]
    return Entry(log.FRAMES, begin, end, version, 0, version, flags=SEEN, items=items)


BOTH = write(1, 2, 1, {X: 1, Y: 1})  # each moment is a begin or an end, once
AGAIN = write(4, 5, 2, {X: 2, Y: 2})
SKEWED = [write(1, 2, 1, {A: 1, B: 1}), write(3, 6, 2, {A: 2}, parent=B)]
FORKED = [BOTH, write(3, 11, 2, {X: 2}), write(4, 12, 3, {Y: 2}), read(5, 6, 3, Y, 2, 40, SEEN)]
UPDATED = [BOTH, transfer(3, 6, 2, X, 1, 2)]
REMOVED = [BOTH, write(3, 4, 2, {A: 1}), remove(5, 6, 3, A)]
KILLED = [BOTH, killed(3, {X: 7, Y: 7}), write(5, 6, 3, {A: 2}), read(7, 8, 3, X, 7, 30, SEEN)]

HISTORIES: dict[str, tuple[str, list[Entry], list[Entry]]] = {  # what is said of the first; the second is legal
    "torn": (
        "another record's stamp",
        [BOTH, AGAIN, read(6, 7, 2, X, 2, 40, SEEN), read(8, 9, 2, Y, 1, 10, SEEN)],
        [BOTH, AGAIN, read(6, 7, 2, X, 2, 40, SEEN), read(8, 9, 2, Y, 2, 40, SEEN)],
    ),
    "another value with the right stamp": (
        "another value",
        [BOTH, AGAIN, read(6, 7, 2, X, 1, 40)],
        [BOTH, AGAIN, read(6, 7, 2, X, 2, 40)],
    ),
    "stale": (
        "stale",
        [BOTH, AGAIN, read(6, 7, 1, X, 1, 10)],
        [BOTH, AGAIN, read(3, 7, 1, X, 1, 10)],
    ),
    "back in time": (
        "stale",
        [BOTH, write(3, 9, 2, {X: 2}), read(4, 5, 2, X, 2, 30), read(6, 7, 1, X, 1, 10)],
        [BOTH, write(3, 9, 2, {X: 2}), read(4, 7, 2, X, 2, 30), read(5, 6, 1, X, 1, 10)],
    ),
    "commits against real time": (
        "before one that it followed",
        [BOTH, write(3, 4, 3, {X: 2}), write(5, 6, 2, {Y: 2})],
        [BOTH, write(3, 5, 3, {X: 2}), write(4, 6, 2, {Y: 2})],
    ),
    "long fork": (
        "another record's stamp",
        [*FORKED, read(7, 8, 3, X, 1, 10, SEEN)],
        [*FORKED, read(7, 8, 3, X, 2, 30, SEEN)],
    ),
    "lost update": (
        "a lost update",
        [*UPDATED, transfer(4, 5, 3, X, 1, 3)],
        [*UPDATED, transfer(4, 5, 3, X, 2, 3)],
    ),
    "phantom: a list without what had been added": (
        "more frames, or fewer",
        [*REMOVED[:2], frames(5, 6, 2, [log.WORLD, X, Y])],
        [*REMOVED[:2], frames(5, 6, 2, [log.WORLD, X, Y, A])],
    ),
    "phantom: a list with what had been removed": (
        "a frame that was removed",
        [*REMOVED, frames(7, 8, 3, [log.WORLD, X, A])],
        [*REMOVED, frames(7, 8, 3, [log.WORLD, X, Y])],
    ),
    "write skew: two make a cycle together": (
        "it made a cycle",
        [*SKEWED, write(4, 5, 3, {B: 2}, parent=A)],
        [*SKEWED, write(4, 5, 3, {B: 2}, parent=X)],
    ),
    "absent, though it was there all the time": (
        "status 1 where 0 was right",
        [BOTH, AGAIN, lookup_fails(6, 7, X, 2, 2)],
        [BOTH, AGAIN, lookup_fails(6, 7, A, 2, 2)],
    ),
    "absent, though it was there since before": (
        "status 1 where 0 was right",
        [BOTH, AGAIN, lookup_fails(6, 7, X, 0, 2)],
        [write(1, 2, 1, {Y: 1}), write(3, 8, 2, {X: 2}), lookup_fails(4, 5, X, 1, 2)],
    ),
    "refused without a reason": (
        "status 7 where 0 was right",
        [BOTH, write(3, 4, 0, {X: 2}, status=log.CYCLE, flags=0, high=1)],
        [BOTH, write(3, 4, 0, {log.WORLD: 2}, parent=X, status=log.CYCLE, flags=0, high=1)],
    ),
    "two commits of one version": (
        "two commits of one version",
        [BOTH, write(3, 6, 2, {X: 2}), write(4, 5, 2, {Y: 2})],
        [BOTH, write(3, 6, 2, {X: 2}), write(4, 5, 3, {Y: 2})],
    ),
    "a commit that nobody made": (
        "a commit that nobody made",
        [BOTH, write(4, 5, 3, {X: 2})],
        [BOTH, killed(3, {Y: 7}), write(4, 5, 3, {X: 2})],
    ),
    "a commit after the death": (
        "a commit that nobody made",
        [BOTH, killed(3, {Y: 7}, high=1), write(5, 6, 3, {X: 2})],
        [BOTH, killed(3, {Y: 7}, high=2), write(5, 6, 3, {X: 2})],
    ),
    "half of what a killed writer committed": (
        "another record's stamp",
        [*KILLED, read(9, 10, 3, Y, 1, 10, SEEN)],
        [*KILLED, read(9, 10, 3, Y, 7, 30, SEEN)],
    ),
    "an error that no commit explains": (
        "status 13 where 0 was right",
        [BOTH, lookup_fails(3, 4, X, 1, 1, log.CORRUPT)],
        [BOTH, lookup_fails(3, 4, X, 1, 1, log.EXPIRED)],
    ),
    "an answer from the future": (
        "from the future",
        [BOTH, AGAIN, change(read(6, 7, 2, X, 2, 40), high=1)],
        [BOTH, AGAIN, change(read(6, 7, 2, X, 2, 40), high=2)],
    ),
}


@pytest.mark.parametrize("name", HISTORIES)
def test_impossible_history_is_rejected(name: str, judge: Judge) -> None:
    why, rejected, _ = HISTORIES[name]
    assert why in judge(rejected)


@pytest.mark.parametrize("name", HISTORIES)
def test_legal_neighbour_is_accepted(name: str, judge: Judge) -> None:
    assert judge(HISTORIES[name][2]) == ""


def test_of_two_killed_writers_either_may_have_committed(judge: Judge) -> None:
    """One version without a commit, two that may have made it: what was read decides."""
    two = [BOTH, killed(3, {X: 7}), killed(4, {Y: 8}), write(5, 6, 3, {A: 2})]
    assert judge([*two, read(7, 8, 3, X, 7, 30), read(9, 10, 3, Y, 1, 10)]) == ""
    assert judge([*two, read(7, 8, 3, X, 1, 10), read(9, 10, 3, Y, 8, 40)]) == ""
    assert judge([*two, read(7, 8, 3, X, 7, 30), read(9, 10, 3, Y, 8, 40)])
    assert judge([*two, read(7, 8, 3, X, 1, 10), read(9, 10, 3, Y, 1, 10)])


def test_what_is_no_history_is_not_accepted(
    replay: Callable[[Path], subprocess.CompletedProcess[str]], tmp_path: Path
) -> None:
    for content in (b"", b"\0" * 8192):
        (tmp_path / "log").write_bytes(content)
        assert replay(tmp_path / "log").returncode == 2
    log.write(tmp_path / "log", [Entry(99, 1, 2)])
    assert replay(tmp_path / "log").returncode == 2
