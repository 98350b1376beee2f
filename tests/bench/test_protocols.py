# SPDX-License-Identifier: Apache-2.0
"""The protocols of `shmtf-bench ycsb`: right answers, the guarantees that each states, and threads of a host."""

from __future__ import annotations

import itertools
import os
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import psutil
import pytest

from shmtf import _bench
from shmtf.bench import BenchError, _protocols, _transfers
from shmtf.bench._team import Job, Phase, Team
from shmtf.bench.ycsb import MIXED_RATE, Workload, measure

SHARED = [name for name, (_, threads, _) in _bench.protocols().items() if not threads]
ATOMIC = ["shmtf", "giant-atomic", "latest", "silo"]
# few frames: updates and lookups overlap all the time
SHORT = Workload(frames=40, duration=0.3, warm_up=0.05, rounds=1, check_every=1)


def until(
    workload: Workload, protocol: str, is_seen: Callable[[dict[str, Any]], bool], processes: tuple[int, ...] = (2, 3)
) -> dict[str, Any]:
    """What happens now and then happens at last; the suite's watchdog ends a wait in vain."""
    for n in itertools.cycle(processes):
        (case,) = measure(workload, [protocol], [n])
        assert case["failures"] == 0
        if protocol in ATOMIC:
            assert not case["mixed_reads"]
        if is_seen(case):
            return case
    raise AssertionError("not reached")


def everybody_works(case: dict[str, Any]) -> bool:
    return bool(case["least_reads_per_s"] and case["least_writes_per_s"])


def test_every_protocol_of_the_thesis_is_there() -> None:
    assert {"shmtf", "giant", "giant-atomic", "snapshot", "latest", "silo"} <= set(SHARED)


@pytest.mark.parametrize("name", SHARED)
@pytest.mark.parametrize(("read_len", "write_len"), [(1, 1), (16, 16), (39, 7), (5, 39)])
def test_answers_are_right(name: str, read_len: int, write_len: int) -> None:
    """create compares lookups with the product of what was written."""
    wish = f"shmtf-bench-test-{os.getpid()}"
    _bench.remove(name, _bench.create(name, wish, 40, 8, read_len, write_len))


@pytest.mark.parametrize("name", ATOMIC)
@pytest.mark.parametrize("opposite", [False, True])
def test_atomic_protocols_never_mix_two_updates(name: str, opposite: bool) -> None:
    for n in (2, 4):
        case = until(replace(SHORT, opposite=opposite), name, everybody_works, (n,))
        assert case["mixed_reads"] == 0


@pytest.mark.parametrize("name", ["giant", "snapshot"])
def test_locks_taken_one_at_a_time_do(name: str) -> None:
    """So the check can see a mixture."""
    until(SHORT, name, lambda case: case["mixed_reads"] > 0)


def test_optimistic_lookups_begin_again() -> None:
    until(SHORT, "silo", lambda case: case["retries_per_read"] > 0)


def test_writers_that_never_wait_begin_again() -> None:
    until(replace(SHORT, opposite=True), "latest", lambda case: case["retries_per_write"] > 0)


@pytest.mark.parametrize("name", SHARED)
def test_every_process_gets_something_done(name: str) -> None:
    until(replace(SHORT, frames=500, history=256, by="handle", frequency=1000.0), name, everybody_works, (6,))


# ---- mixed rates ----


def test_mixed_rates() -> None:
    """Of edges at different rates the newest are fresher in the mean than the newest that all have."""
    latest, common = measure(replace(MIXED_RATE, duration=1.5, rounds=1), ["shmtf", "shmtf-common"], [2])
    for case in (latest, common):
        assert case["failures"] == 0
        assert case["mixed_reads"] is None
        assert 0 < case["writes_per_s"]["median"] <= 1.01 * case["asked_writes_per_s"]
    assert latest["age_mean_ns"]["p50"] < common["age_mean_ns"]["p50"]
    assert latest["span_ns"]["p50"] > latest["deviation_ns"]["p50"] > 0
    assert common["span_ns"]["max"] == common["deviation_ns"]["max"] == 0


def test_asked_rate_is_the_sum_of_all_edges() -> None:
    assert _bench.mixed_rate(2) == 1  # the slow edge alone
    assert 1 + 63 * 30 <= _bench.mixed_rate(65) <= 1 + 63 * 200


@pytest.mark.parametrize(
    ("change", "processes", "part"),
    [
        ({"engine": "python"}, 2, "native only"),
        ({"write_len": 4}, 2, "--write-len 4"),
        ({}, 1, "--processes 2"),
        ({"warm_up": 0.0}, 2, "--warm-up 0"),
        ({"frames": 16}, 2, "16 frames"),
    ],
)
def test_mixed_rates_refuse(change: dict[str, Any], processes: int, part: str) -> None:
    with pytest.raises(BenchError, match=part):
        measure(replace(MIXED_RATE, **change), ["shmtf"], [processes])


# ---- threads of a host ----


def names_left() -> list[str]:
    return [name for name in os.listdir("/dev/shm") if name.startswith(f"shmtf-bench-{os.getpid()}")]


@pytest.fixture
def hosted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Any protocol can be hosted; only some must."""
    chosen = {"silo", "shmtf-common"}
    monkeypatch.setattr(_protocols, "is_hosted", lambda engine, name: name in chosen or engine == "python")


@pytest.mark.usefixtures("hosted")
def test_workers_that_are_threads() -> None:
    case = until(SHORT, "silo", everybody_works, (3,))
    assert case["mixed_reads"] == 0
    assert len(case["rounds"][0]["workers"]) == 3


@pytest.mark.usefixtures("hosted")
def test_threads_and_processes_in_one_run() -> None:
    silo, shmtf = measure(SHORT, ["silo", "shmtf"], [2])
    assert silo["failures"] == shmtf["failures"] == 0
    assert silo["reads_per_s"]["median"] + silo["writes_per_s"]["median"] > 0
    assert shmtf["reads_per_s"]["median"] + shmtf["writes_per_s"]["median"] > 0


@pytest.mark.usefixtures("hosted")
def test_workers_that_are_threads_in_python() -> None:
    (case,) = measure(replace(SHORT, engine="python"), ["shmtf"], [2])
    assert case["failures"] == 0
    assert case["mixed_reads"] == 0


JOB = Job("native", 40, 8, 4, 4, True, 0.0, False, False, 1)


@pytest.fixture
def team(hosted: None) -> Iterator[Team]:
    with Team(JOB, ["silo"], 2) as team:
        yield team


def test_a_dead_host_is_an_error(team: Team) -> None:
    (host,) = (c for c in psutil.Process().children() if "shmtf.bench.worker" in c.cmdline())  # not of other tests
    assert host.num_threads() >= 3
    host.kill()
    with pytest.raises(BenchError, match="the host of silo is dead: killed by SIGKILL"):
        team.run(Phase("silo", 2, 1, False, 0.5, False), 0.0, 60.0, 1)


@pytest.mark.usefixtures("hosted")
def test_a_host_that_cannot_make_its_memory_says_why() -> None:
    with (
        pytest.raises(BenchError, match="bytes of memory"),
        Team(replace(JOB, frames=10**7, history=10**5), ["silo"], 2),
    ):
        pass


@pytest.mark.usefixtures("hosted")
def test_a_thread_that_fails_ends_its_host() -> None:
    job: Any = replace(JOB, engine="python", check_every=None)  # type: ignore[arg-type]
    with Team(job, ["shmtf"], 2) as team, pytest.raises(BenchError, match="the host of shmtf is dead: TypeError"):
        team.run(Phase("shmtf", 2, 1, False, 0.5, False), 0.0, 60.0, 1)
    assert names_left() == []


@pytest.mark.usefixtures("hosted")
def test_a_host_removes_names_as_soon_as_all_are_attached() -> None:
    with Team(JOB, ["shmtf-common"], 2):
        while names_left():  # the suite's watchdog ends a wait in vain
            time.sleep(0.01)


# ---- what is loaded, what is said ----


def test_a_library_that_is_no_peer(tmp_path: Any) -> None:
    with pytest.raises(OSError, match="cannot open shared object"):
        _bench.load(str(tmp_path / "none.so"))
    with pytest.raises(OSError, match="shmtf_bench_peer"):
        _bench.load("libm.so.6")


def test_opposite_is_said_for_each() -> None:
    notes = "\n".join(_protocols.opposite_notes(["shmtf", "latest", "giant"]))
    assert "does not act on shmtf:" in notes
    assert "acts on latest:" in notes
    assert "does not act on giant:" in notes


def test_line_transfers_are_counted_or_not_said() -> None:
    (case,) = measure(replace(SHORT, rounds=2), ["giant"], [2])
    known = case["line_transfers_per_operation"]
    assert (known is not None and known["median"] >= 0) if _transfers.event() else known is None


@pytest.fixture
def countable(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """An event that counts wherever perf may count at all, in place of the hardware's."""
    monkeypatch.setattr(_transfers, "_EVENTS", ("no-such-event", "context-switches"))
    _transfers.event.cache_clear()
    yield
    _transfers.event.cache_clear()


@pytest.mark.usefixtures("countable")
def test_events_of_all_workers_are_counted() -> None:
    if _transfers.event() is None:
        pytest.skip("perf is not here, or may not count")
    assert _transfers.event() == "context-switches"
    (case,) = measure(replace(SHORT, frequency=1000.0), ["giant"], [2])
    assert case["rounds"][0]["line_transfers"] > 10  # each operation ends in a sleep
