# SPDX-License-Identifier: Apache-2.0
"""Short real runs of `shmtf-bench wakeup`, `idle` and `recover`.  No test asserts a time."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from shmtf import bench


def run(tmp_path: Path, *args: str) -> dict[str, Any]:
    path = tmp_path / "result.json"
    assert bench.main([*args, "--json", str(path)]) == 0
    result: dict[str, Any] = json.loads(path.read_text())
    assert result["schema"] == "shmtf-bench/1" and result["kind"] == args[0]
    assert result["machine"]["cpus"] and result["versions"]["shmtf"]
    return result


def test_wakeup(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    result = run(tmp_path, "wakeup", "--waiters", "1,2", "--n", "20", "--rounds", "2", "--gap-ms", "5")
    cases = {(c["case"], c["waiters"]): c for c in result["cases"]}
    assert list(cases) == [("semaphore", 1), ("nobody", 0), ("same", 1), ("same", 2), ("different", 2)]
    for (kind, waiters), case in cases.items():
        commits = 0 if kind == "nobody" else 40 if kind == "different" else 40 * waiters
        assert case["wakes"] + case["late"] == commits
        assert 0 < case["commit_ns"]["p50"]["min"] <= case["commit_ns"]["p50"]["max"]
        if case["wakes"]:
            assert 0 < case["wake_ns"]["p50"]["min"] <= case["wake_ns"]["max"]["max"]
    assert cases["same", 2]["wakes"] > 0
    assert "floor: sem_post, sem_wait" in capsys.readouterr().out


def test_idle(tmp_path: Path) -> None:
    args = ["--processes", "0,2", "--duration", "0.3", "--rounds", "2", "--rate", "200"]
    cases = {(c["processes"], c["mode"]): c for c in run(tmp_path, "idle", *args)["cases"]}
    assert list(cases) == [(0, "nobody"), (2, "attached"), (2, "waiting")]
    for (processes, _), case in cases.items():
        assert case["commits_per_s"]["median"] > 0
        assert (case["cpu_share"] is None) == (processes == 0)
        assert len(case["rounds"]) == 2
    attached, waiting = cases[2, "attached"], cases[2, "waiting"]
    assert 0 <= attached["cpu_share"]["min"] <= attached["cpu_share_max"]["max"]
    # who waits for a frame that nobody writes is not woken by commits to others: 0.3 s hold about 60 of them
    assert waiting["sleeps_per_s"]["median"] < 100


def test_recover(tmp_path: Path) -> None:
    (case,) = run(tmp_path, "recover", "--frames", "64", "--n", "12")["cases"]
    assert case["kills"] == len(case["rounds"]) == 12
    assert 0 <= case["left_committed"] <= case["left_locks"] <= 12
    assert case["next_ns"]["count"] == 12
    counts = [case[key]["count"] for key in ("update_after_locks_ns", "update_after_no_locks_ns") if case[key]]
    assert sum(counts) == 12


@pytest.mark.parametrize(
    "args",
    [
        ["wakeup", "--waiters", "0"],
        ["wakeup", "--gap-ms", "0"],
        ["idle", "--processes", "-1"],
        ["idle", "--rate", "none"],
        ["recover", "--frames", "0"],
        ["recover", "--n", "0"],
        ["scale", "--sweep", "width"],
        ["scale", "--history", "3"],
        ["figures"],
        ["figures", "--out", "x", "--groups", "ycsb-d"],
        ["figures", "--out", "x", "--full", "--quick"],
    ],
)
def test_bad_arguments(args: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stopped:
        bench.main(args)
    assert stopped.value.code == 2
    assert "usage: " in capsys.readouterr().err
