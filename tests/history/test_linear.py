# SPDX-License-Identifier: Apache-2.0
"""The exhaustive search on histories made by hand: each anomaly, and beside it the history next to it that is legal.

Tier: test. Registers hold None at first; an operation is (begin, end, reads, writes).
"""

from __future__ import annotations

import pytest
from linear import Operation, first_impossible, registers

Plain = tuple[int, int | None, dict[str, object], dict[str, object]]

BOTH = (1, 2, {}, {"x": 1, "y": 1})
AGAIN = (3, 4, {}, {"x": 2, "y": 2})

HISTORIES: dict[str, tuple[list[Plain], list[Plain]]] = {  # impossible, and a legal neighbour
    "torn: half of an update of two": (
        [BOTH, AGAIN, (5, 6, {"x": 2, "y": 1}, {})],
        [BOTH, AGAIN, (5, 6, {"x": 2, "y": 2}, {})],
    ),
    "torn while it is written": (
        [BOTH, (3, 8, {}, {"x": 2, "y": 2}), (4, 5, {"x": 2, "y": 1}, {})],
        [BOTH, (3, 8, {}, {"x": 2, "y": 2}), (4, 5, {"x": 1, "y": 1}, {})],
    ),
    "stale: an answer that was overwritten before the question": (
        [BOTH, AGAIN, (5, 6, {"x": 1}, {})],
        [BOTH, AGAIN, (2, 6, {"x": 1}, {})],
    ),
    "back in time: an older answer after a newer one": (
        [BOTH, (3, 9, {}, {"x": 2}), (4, 5, {"x": 2}, {}), (6, 7, {"x": 1}, {})],
        [BOTH, (3, 9, {}, {"x": 2}), (4, 7, {"x": 2}, {}), (5, 6, {"x": 1}, {})],
    ),
    "long fork: two readers see two writes in two orders": (
        [(1, 9, {}, {"x": 1}), (1, 9, {}, {"y": 1}), (2, 3, {"x": 1, "y": None}, {}), (2, 3, {"x": None, "y": 1}, {})],
        [(1, 9, {}, {"x": 1}), (1, 9, {}, {"y": 1}), (2, 3, {"x": 1, "y": None}, {}), (2, 4, {"x": 1, "y": 1}, {})],
    ),
    "lost update: two add to what they both read": (
        [(1, 2, {}, {"x": 0}), (3, 6, {"x": 0}, {"x": 1}), (3, 6, {"x": 0}, {"x": 2})],
        [(1, 2, {}, {"x": 0}), (3, 6, {"x": 0}, {"x": 1}), (3, 6, {"x": 1}, {"x": 2})],
    ),
    "phantom: what was listed lacks what had been added": (
        [(1, 2, {}, {"a": "is"}), (3, 4, {}, {"b": "is"}), (5, 6, {"a": "is", "b": None}, {})],
        [(1, 2, {}, {"a": "is"}), (3, 6, {}, {"b": "is"}), (5, 6, {"a": "is", "b": None}, {})],
    ),
    "phantom: two make sure that the other is absent": (
        [(1, 4, {"a": None}, {"b": "is"}), (1, 4, {"b": None}, {"a": "is"})],
        [(1, 4, {"a": None}, {"b": "is"}), (1, 4, {"b": "is"}, {"a": "is"})],
    ),
    "write skew: each reads both and writes one": (
        [BOTH, (3, 6, {"x": 1, "y": 1}, {"x": 0}), (3, 6, {"x": 1, "y": 1}, {"y": 0})],
        [BOTH, (3, 6, {"x": 1, "y": 1}, {"x": 0}), (3, 6, {"x": 0, "y": 1}, {"y": 0})],
    ),
    "a value from nowhere": ([(1, 2, {"x": 7}, {})], [(1, 2, {"x": None}, {})]),
    "dirty: read before it was written": (
        [(1, 2, {"x": 1}, {}), (3, 4, {}, {"x": 1})],
        [(1, 3, {"x": 1}, {}), (2, 4, {}, {"x": 1})],
    ),
}


def made(plain: list[Plain]) -> list[Operation]:
    return [Operation(b, e, registers(r, w), f"{r} {w}", pure=not w) for b, e, r, w in plain]


@pytest.mark.parametrize("name", HISTORIES)
def test_impossible_history_is_rejected(name: str) -> None:
    assert first_impossible(made(HISTORIES[name][0])) is not None


@pytest.mark.parametrize("name", HISTORIES)
def test_legal_neighbour_is_accepted(name: str) -> None:
    assert first_impossible(made(HISTORIES[name][1])) is None


def killed(end: int | None, *later: Plain) -> Operation | None:
    return first_impossible([Operation(1, end, registers({}, {"x": 1}), "killed", maybe=True), *made(list(later))])


@pytest.mark.parametrize("seen", [[None, None], [None, 1], [1, 1]])
def test_killed_write_may_have_happened_or_not(seen: list[object]) -> None:
    assert killed(None, (2, 3, {"x": seen[0]}, {}), (4, 5, {"x": seen[1]}, {})) is None


def test_killed_write_does_not_come_and_go() -> None:
    assert killed(None, (2, 3, {"x": 1}, {}), (4, 5, {"x": None}, {})) is not None


def test_killed_write_does_not_happen_after_the_death() -> None:
    assert killed(6, (2, 3, {"x": None}, {}), (7, 8, {"x": None}, {}), (9, 10, {"x": 1}, {})) is not None
    assert killed(6, (2, 7, {"x": None}, {}), (9, 10, {"x": 1}, {})) is None


def test_killed_write_is_not_needed_twice() -> None:
    overwritten = (4, 5, {"x": 1}, {"x": 2})
    assert killed(3, overwritten, (6, 7, {"x": 2}, {})) is None
    assert killed(3, overwritten, (6, 7, {"x": 1}, {})) is not None
