# SPDX-License-Identifier: Apache-2.0
"""The parts that the numbers rest on: histogram, stamps of updates, the check for mixtures, tables."""

from __future__ import annotations

import os

import pytest

from shmtf import _bench
from shmtf.bench import _report


@pytest.fixture
def control() -> _bench.Control:
    return _bench.Control(1)


def check(control: _bench.Control, write_len: int, first: int, stamps: list[int], start_ns: int = 0) -> bool:
    """Is it a mixture?"""
    before = control.result(1)["mixed"]
    control.check(0, write_len, first, stamps, max(stamps) + 1, start_ns)
    return bool(control.result(1)["mixed"] - before)


def test_histogram(control: _bench.Control) -> None:
    for ns in range(1, 100_001):
        control.operation(0, True, ns)
    h = control.result(1)["read_ns"]
    assert h["count"] == 100_000
    assert h["mean"] == pytest.approx(50_000.5)
    for name, value in (("p50", 50_000), ("p99", 99_000), ("p99_9", 99_900)):
        assert h[name] == pytest.approx(value, rel=0.01)
    assert h["max"] == 100_000


@pytest.mark.parametrize("ns", [0, 1, 255, 256, 257, 999, 123_456, 10**9, 10**12, 2**60])
def test_histogram_of_one_value(control: _bench.Control, ns: int) -> None:
    control.operation(0, False, ns)
    h = control.result(1)["write_ns"]
    assert h["max"] == ns
    assert h["p50"] == pytest.approx(min(ns, 2**42), rel=0.01)


def test_empty_histogram(control: _bench.Control) -> None:
    assert control.result(1)["read_ns"] is None


@pytest.mark.parametrize("write_len", [1, 2, 3, 16, 1000])
def test_stamp_of_an_update(write_len: int) -> None:
    now = 1_234_567_890_123_456_789
    stamps = {first: _bench.Control.update_stamp(write_len, first, now) for first in range(2 * write_len)}
    assert all(abs(stamp - now) < 2 * write_len for stamp in stamps.values())
    assert all(stamps[i] == stamps[i + write_len] for i in range(write_len))
    assert len(set(stamps.values())) == write_len


def snake_after(updates: list[tuple[int, int]], write_len: int, frames: int) -> list[int]:
    """The stamps of all frames after whole updates (first, now)."""
    stamps = [0] * frames
    for first, now in updates:
        for child in range(first + 1, first + 1 + write_len):
            stamps[child] = _bench.Control.update_stamp(write_len, first, now)
    return stamps


@pytest.mark.parametrize("write_len", [1, 3, 4, 16])
def test_whole_updates_are_no_mixture(control: _bench.Control, write_len: int) -> None:
    updates = [(7 * i % 40, 100_000 * (i + 1)) for i in range(60)]
    stamps = snake_after(updates, write_len, 40 + write_len + 1)
    for first in range(20):
        for read_len in (1, 4, 20):
            assert not check(control, write_len, first, stamps[first + 1 : first + 1 + read_len])


def test_half_an_update_is_a_mixture(control: _bench.Control) -> None:
    stamps = snake_after([(3, 100_000), (6, 200_000)], 8, 30)
    assert not check(control, 8, 0, stamps[1:25])
    for child in range(7, 15):  # one frame has not got the second update
        torn = list(stamps)
        torn[child] = _bench.Control.update_stamp(8, 3, 100_000) if child <= 11 else 0
        assert check(control, 8, 0, torn[1:25])
        assert check(control, 8, 5, torn[6:20])


def test_a_newer_update_over_half_of_it_is_no_mixture(control: _bench.Control) -> None:
    stamps = snake_after([(3, 100_000), (6, 300_000), (2, 200_000)], 8, 30)
    late = snake_after([(3, 100_000), (2, 200_000), (6, 300_000)], 8, 30)
    assert check(control, 8, 0, stamps[1:25])  # an older stamp over a newer one: no series does that
    assert not check(control, 8, 0, late[1:25])


def test_what_was_there_before_belongs_to_no_update(control: _bench.Control) -> None:
    assert not check(control, 4, 0, [17, 5, 99, 3, 12, 1, 40, 2], start_ns=100)


def test_freshness(control: _bench.Control) -> None:
    control.check(0, 1, 0, [1000, 3000, 2000], 11_000, 0)
    r = control.result(1)
    assert r["age_oldest_ns"]["max"] == 10_000
    assert r["age_mean_ns"]["max"] == 9_000
    assert r["span_ns"]["max"] == 2_000
    assert r["deviation_ns"]["max"] == 816  # of 1000, 2000, 3000


def test_control_is_shared_by_path(control: _bench.Control) -> None:
    other = _bench.Control(control.path)
    other.enter(0, os.getppid(), 1, "")
    assert control.state(0)[0] == 1
    control.stop()
    assert other.next_phase(0) is None


def test_control_refuses(control: _bench.Control) -> None:
    with pytest.raises(IndexError):
        control.state(1)
    with pytest.raises(ValueError):
        _bench.Control(0)
    with pytest.raises(OSError):
        _bench.Control("/proc/self/fd/none")
    with pytest.raises(ValueError):
        _bench.create("cicada", "x", 100, 8, 4, 4)


def test_round_trip_between_two_cpus() -> None:
    cpus = _bench.cpus()
    if len(cpus) > 1:
        ns = _bench.round_trip(cpus[0], cpus[1])
        assert ns is not None and ns > 0
    assert _bench.cpus() == cpus  # the caller is not left pinned
    assert os.sched_getaffinity(0) == set(cpus)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0, "0.00"),
        (12.345, "12.3"),
        (999, "999"),
        (1234567, "1.23 M"),
        (98765, "98.8 k"),
        (2.5e9, "2.50 G"),
        (None, "-"),
    ],
)
def test_quantity(value: float | None, text: str) -> None:
    assert _report.quantity(value) == text


@pytest.mark.parametrize(
    ("ns", "text"), [(0, "0"), (950, "950 ns"), (1500, "1.50 us"), (2.5e7, "25.0 ms"), (None, "-")]
)
def test_duration(ns: float | None, text: str) -> None:
    assert _report.duration(ns) == text


def test_share_shows_exact_zeros() -> None:
    assert _report.share(0, 10) == "0"
    assert _report.share(1, 1000) == "0.1 %"
    assert _report.share(999, 1000) == "100 %"
    assert _report.share(1, 0) == "-"


def test_table_is_aligned() -> None:
    text = _report.table(["a", "bb"], [["long", "1"], ["x", "100"]])
    assert text.splitlines() == ["  a      bb", "  long    1", "  x     100"]
