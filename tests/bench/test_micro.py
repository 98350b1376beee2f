# SPDX-License-Identifier: Apache-2.0
"""`shmtf-bench micro` runs, compares with its floor, and says so in its result.  No test asserts a time."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from shmtf import bench

NATIVE = {"latest hot", "latest handle", "latest name", "recent handle", "any time handle", "common handle"}
NATIVE |= {
    "write 16 handle",
    "write 16 name",
    "write 1 handle",
    "write 1 name",
    "any time name",
    "common name",
    "can name",
}
PYTHON = {"call", "latest", "recent", "common", "can", "set 1", "set 16", "make 1", "make 16"}


def run(tmp_path: Path, *args: str) -> dict[str, Any]:
    path = tmp_path / "micro.json"
    assert bench.main(["micro", "--rounds", "2", "--round-ms", "1", "--json", str(path), *args]) == 0
    return json.loads(path.read_text())  # type: ignore[no-any-return]


@pytest.fixture
def result(tmp_path: Path) -> dict[str, Any]:
    return run(tmp_path, "--frames", "17,40", "--history", "8")


def test_result_describes_itself(result: dict[str, Any]) -> None:
    assert result["schema"] == "shmtf-bench/1"
    assert result["kind"] == "micro"
    assert result["machine"]["cpu"] and result["machine"]["cpus"]
    assert {"shmtf", "commit", "compiler", "python"} <= result["versions"].keys()
    assert result["parameters"]["rounds"] == 2
    assert [(c["frames"], c["history"]) for c in result["configurations"]] == [(17, 8), (40, 8)]


def test_every_row_has_a_time_and_a_ratio(result: dict[str, Any]) -> None:
    for config in result["configurations"]:
        assert config["skipped"] is None
        rows = {(row["engine"], row["name"]): row for row in config["rows"] if row["peer"] is None}
        assert {name for engine, name in rows if engine == "native"} >= NATIVE
        assert {name for engine, name in rows if engine == "python"} == PYTHON
        for (_, name), row in rows.items():
            assert 0 < row["ns"]["min"] <= row["ns"]["median"] <= row["ns"]["max"]
            has_floor = not name.startswith("floor") and name != "call"
            assert (row["ratio"] is not None) == has_floor
            assert (row["floor"] is not None) == has_floor


def test_ratio_is_over_the_floor_of_the_same_run(result: dict[str, Any]) -> None:
    rows = {row["name"]: row for row in result["configurations"][0]["rows"] if row["engine"] == "native"}
    assert all(rows[row["floor"]]["peer"] is None for row in rows.values() if row["floor"])
    latest = rows["latest handle"]
    assert latest["ratio"] == pytest.approx(latest["ns"]["median"] / rows[latest["floor"]]["ns"]["median"])


def test_floors_are_measured_for_python_alone_too(tmp_path: Path) -> None:
    config = run(tmp_path, "--frames", "17", "--history", "8", "--engine", "python")["configurations"][0]
    names = {row["name"] for row in config["rows"] if row["engine"] == "native"}
    assert names and all(name.startswith("floor") for name in names)


def test_table(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    run(tmp_path, "--frames", "17", "--history", "8")
    text = capsys.readouterr().out
    assert "17 frames, history 8" in text
    assert "lookup_latest_transform" in text


@pytest.mark.parametrize("args", [["--frames", "16"], ["--rounds", "0"], ["--engine", "rust"], ["--history", "x"]])
def test_bad_arguments(args: list[str]) -> None:
    with pytest.raises(SystemExit) as stopped:
        bench.main(["micro", *args])
    assert stopped.value.code == 2


@pytest.mark.parametrize("args", [["--frames", "40", "--depth", "40"], ["--cpu", "100000"]])
def test_what_cannot_be_is_one_line(args: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert bench.main(["micro", *args]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert args[-1] in line


def test_depth(tmp_path: Path) -> None:
    """A lookup over more edges costs more arithmetic: the floor's times are of one run, and far apart."""
    args = ("--frames", "400", "--history", "8", "--engine", "native", "--no-peers")
    near = run(tmp_path, *args, "--depth", "1")
    far = run(tmp_path, *args, "--depth", "300")
    assert near["parameters"]["depth"] == 1
    compose = [r["configurations"][0]["rows"][0] for r in (near, far)]
    assert compose[0]["name"] == compose[1]["name"] == "floor compose"
    assert compose[0]["ns"]["min"] < compose[1]["ns"]["min"]


def test_unwritable_result_is_refused_before_the_work(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert bench.main(["micro", "--json", str(tmp_path / "none" / "x.json")]) == 1
    assert "No such file" in capsys.readouterr().err
