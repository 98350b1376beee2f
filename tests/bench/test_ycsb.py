# SPDX-License-Identifier: Apache-2.0
"""Short real runs of `shmtf-bench ycsb`: real processes, every protocol, every number.  No test asserts a time."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import psutil
import pytest

from shmtf import bench

SHORT = ["--frames", "200", "--duration", "1", "--warm-up", "0.05", "--rounds", "1", "--check-every", "1"]
LATENCY = {"count", "mean", "p50", "p99", "p99_9", "max"}


def run(tmp_path: Path, *args: str) -> dict[str, Any]:
    path = tmp_path / "ycsb.json"
    assert bench.main(["ycsb", *SHORT, "--json", str(path), *args]) == 0
    return json.loads(path.read_text())  # type: ignore[no-any-return]


def leftovers() -> list[str]:
    return [name for name in os.listdir("/dev/shm") if name.startswith(f"shmtf-bench-{os.getpid()}")]


@pytest.fixture(scope="module")
def contended(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Few frames: updates and lookups overlap all the time."""
    path = tmp_path_factory.mktemp("ycsb")
    return run(path, "--frames", "40", "--processes", "2,4", "--protocol", "shmtf,giant,giant-atomic")


def test_result_describes_itself(contended: dict[str, Any]) -> None:
    assert contended["schema"] == "shmtf-bench/1"
    assert contended["kind"] == "ycsb"
    assert contended["parameters"]["read_ratio"] == 0.5
    assert contended["parameters"]["workload"] == "A"
    assert {"cpu", "cpus", "kernel", "load_before", "line_round_trip_ns"} <= contended["machine"].keys()
    assert {"shmtf", "commit", "compiler", "python"} <= contended["versions"].keys()
    cases = [(c["processes"], c["protocol"]) for c in contended["cases"]]
    assert cases == [(n, p) for n in (2, 4) for p in ("shmtf", "giant", "giant-atomic")]


def test_every_case_has_every_number(contended: dict[str, Any]) -> None:
    for case in contended["cases"]:
        assert case["failures"] == 0
        assert case["readers"] == case["processes"] // 2 and not case["coin"]
        for rate in ("reads_per_s", "writes_per_s"):
            assert 0 < case[rate]["min"] <= case[rate]["median"] <= case[rate]["max"]
        for histogram in ("read_ns", "write_ns", "age_oldest_ns", "age_mean_ns", "span_ns", "deviation_ns"):
            h = case[histogram]
            assert h.keys() == LATENCY
            assert h["count"] > 0
            assert h["p50"] <= h["p99"] <= h["p99_9"] <= h["max"]
        assert case["retries_per_write"] >= 0 and case["retries_per_read"] >= 0
        assert case["cpu_share"]["median"] > 0
        assert case["checked_reads"] > 0
        assert 0 < case["least_reads_per_s"] <= case["reads_per_s"]["max"]
        assert 0 < case["least_writes_per_s"] <= case["writes_per_s"]["max"]


def test_read_only_workload(tmp_path: Path) -> None:
    result = run(tmp_path, "--workload", "C", "--processes", "2")
    for case in result["cases"]:
        assert case["readers"] == 2
        assert case["writes_per_s"]["max"] == 0
        assert case["write_ns"] is None and case["retries_per_write"] is None
        assert case["mixed_reads"] == 0 and case["age_oldest_ns"] is None  # nothing is written: nothing to be fresh


def test_few_processes_draw_each_operation(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    result = run(tmp_path, "--workload", "B", "--processes", "2", "--protocol", "shmtf")
    (case,) = result["cases"]
    assert case["coin"] and case["readers"] is None
    n_reads, n_writes = case["reads_per_s"]["median"], case["writes_per_s"]["median"]
    assert 0.85 < n_reads / (n_reads + n_writes) < 0.99
    assert any("coin" in note for note in result["notes"])
    assert "coin" in capsys.readouterr().out


def test_twenty_processes_have_one_writer() -> None:
    from shmtf.bench.ycsb import MIXED_RATE, Workload, _roles

    assert _roles(20, Workload(read_ratio=0.95)) == (19, False)
    assert _roles(19, Workload(read_ratio=0.95)) == (0, True)
    assert _roles(1, Workload()) == (0, True)
    assert _roles(2, Workload()) == (1, False)
    assert _roles(4, Workload(read_ratio=1.0)) == (4, False)
    assert _roles(4, Workload(read_ratio=0.0)) == (0, False)
    assert _roles(2, MIXED_RATE) == (1, False)
    assert _roles(3, replace(MIXED_RATE, read_ratio=1.0)) == (2, False)


def test_frequency_paces(tmp_path: Path) -> None:
    (case,) = run(tmp_path, "--frequency", "100", "--processes", "2", "--protocol", "shmtf")["cases"]
    assert 0 < case["reads_per_s"]["median"] <= 101  # after each operation it waits 1/100 s


def test_by_handle_and_opposite_write(tmp_path: Path) -> None:
    result = run(tmp_path, "--by", "handle", "--opposite-write", "--processes", "2")
    assert all(c["reads_per_s"]["median"] > 0 and c["writes_per_s"]["median"] > 0 for c in result["cases"])
    assert sum("--opposite-write does not act on" in note for note in result["notes"]) == 2


def test_python_engine(tmp_path: Path) -> None:
    result = run(tmp_path, "--engine", "python", "--processes", "2", "--protocol", "shmtf")
    (case,) = result["cases"]
    assert case["reads_per_s"]["median"] > 0 and case["writes_per_s"]["median"] > 0
    assert case["checked_reads"] > 0 and case["mixed_reads"] == 0


def test_nothing_is_left(contended: dict[str, Any]) -> None:
    assert contended["cases"] and leftovers() == []


@pytest.mark.parametrize(
    "args",
    [
        ["--protocol", "cicada"],
        ["--workload", "D"],
        ["--read-ratio", "1.5"],
        ["--processes", "0"],
        ["--workload", "A", "--read-ratio", "0.5"],
    ],
)
def test_bad_arguments(args: list[str]) -> None:
    with pytest.raises(SystemExit) as stopped:
        bench.main(["ycsb", *args])
    assert stopped.value.code == 2


def test_list(capsys: pytest.CaptureFixture[str]) -> None:
    assert bench.main(["ycsb", "--list"]) == 0
    out = capsys.readouterr().out
    assert all(f"  {name} " in out for name in ("shmtf", "giant-atomic", "silo", "numpy-lock"))


def test_errors_are_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert bench.main(["ycsb", "--frames", "16"]) == 1
    assert bench.main(["ycsb", "--engine", "python", "--protocol", "giant"]) == 1
    assert bench.main(["ycsb", "--frames", "2000000", "--history", "1000000"]) == 1  # more than shared memory
    assert len(capsys.readouterr().err.splitlines()) == 3


# ---- processes that end ----


def start_long(engine: str = "native") -> tuple[subprocess.Popen[str], list[psutil.Process]]:
    """A run of a minute, and its workers once they work."""
    code = "import sys; from shmtf import bench; sys.exit(bench.main(sys.argv[1:]))"
    args = [
        "ycsb",
        "--frames",
        "200",
        "--duration",
        "60",
        "--processes",
        "2",
        "--protocol",
        "shmtf",
        "--engine",
        engine,
    ]
    process = subprocess.Popen(
        [sys.executable, "-c", code, *args], cwd="/", stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline:
        workers = psutil.Process(process.pid).children()
        if len(workers) == 2 and all(w.cpu_times().user > 0.3 for w in workers):
            return process, workers
        time.sleep(0.05)
    process.kill()
    pytest.fail(f"no workers: {process.communicate()}")


def assert_gone(process: subprocess.Popen[str], workers: list[psutil.Process]) -> None:
    _, alive = psutil.wait_procs(workers, timeout=30)
    assert not alive
    assert not [name for name in os.listdir("/dev/shm") if name.startswith(f"shmtf-bench-{process.pid}-")]


@pytest.mark.parametrize("engine", ["native", "python"])
def test_interrupt_cleans_up(engine: str) -> None:
    process, workers = start_long(engine)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=30)
    assert process.returncode == 130
    assert "interrupted" in errors and "Traceback" not in errors
    assert_gone(process, workers)


def test_a_dead_worker_is_an_error() -> None:
    process, workers = start_long()
    workers[0].kill()
    _, errors = process.communicate(timeout=30)
    assert process.returncode == 1
    assert "is dead: killed by SIGKILL" in errors
    assert_gone(process, workers)


def test_workers_end_with_their_coordinator() -> None:
    process, workers = start_long()
    process.kill()
    process.communicate(timeout=30)
    assert_gone(process, workers)
