# SPDX-License-Identifier: Apache-2.0
"""`shmtf-bench compare`: numbers of the same case side by side, and what makes them hard to compare said first."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from shmtf import bench


def spread(median: float, least: float, most: float) -> dict[str, float]:
    return {"median": median, "min": least, "max": most}


def result(cpu: str, rate: dict[str, float], p99: list[float], **changes: Any) -> dict[str, Any]:
    rounds = [{"read_ns": {"p50": 1, "p99": x, "p99_9": 2 * x}, "workers": []} for x in p99]
    case = {"protocol": "shmtf", "processes": 2, "reads_per_s": rate, "rounds": rounds}
    other = {"protocol": "giant", "processes": 2, "reads_per_s": rate, "rounds": []}
    trip = {"machine": {"cpu": cpu, "load_before": [0, 0, 0], "line_round_trip_ns": None}}
    parts = {"versions": {"shmtf": "1"}, "parameters": {"frames": 10}, "cases": [case, other]}
    return {"schema": "shmtf-bench/1", "kind": "ycsb", **trip, **parts, **changes}


def compare(tmp_path: Path, a: dict[str, Any], b: dict[str, Any], *more: str) -> dict[str, Any]:
    for name, content in (("a", a), ("b", b)):
        (tmp_path / f"{name}.json").write_text(json.dumps(content))
    paths = [str(tmp_path / f"{name}.json") for name in ("a", "b", "out")]
    assert bench.main(["compare", paths[0], paths[1], "--json", paths[2], *more]) == 0
    return json.loads(Path(paths[2]).read_text())  # type: ignore[no-any-return]


def test_ratio_and_overlap(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    a = result("x", spread(100, 90, 110), [10, 20, 30])
    b = result("y", spread(200, 111, 210), [15, 25, 35], parameters={"frames": 20})
    del b["cases"][1]  # what only one of them has is not compared
    found = compare(tmp_path, a, b)
    rows = {row["number"]: row for row in found["rows"]}
    assert {row["case"] for row in found["rows"]} == {"protocol shmtf, processes 2"}
    assert rows["reads_per_s"]["ratio"] == 2 and not rows["reads_per_s"]["overlap"]
    assert rows["read_ns.p99"]["a"] == spread(20, 10, 30) and rows["read_ns.p99"]["overlap"]
    assert found["of"] == "ycsb" and len(found["differences"]) == 2
    text = capsys.readouterr().out
    assert text.startswith("differs: machine, cpu: x in A, y in B\ndiffers: parameters, frames: 10 in A, 20 in B\n")
    assert text.count("apart") == 2  # the row, and what the word means


def test_only(tmp_path: Path) -> None:
    a = result("x", spread(1, 1, 1), [1])
    assert [row["number"] for row in compare(tmp_path, a, a, "--only", "p99_9")["rows"]] == ["read_ns.p99_9"]


def test_a_result_with_itself(tmp_path: Path) -> None:
    path = str(tmp_path / "micro.json")
    assert (
        bench.main(["micro", "--frames", "17", "--history", "4", "--rounds", "1", "--round-ms", "1", "--json", path])
        == 0
    )
    out = tmp_path / "out.json"
    assert bench.main(["compare", path, path, "--json", str(out)]) == 0
    found = json.loads(out.read_text())
    assert found["differences"] == [] and len(found["rows"]) > 10
    assert all(row["ratio"] == 1 and row["overlap"] for row in found["rows"])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (None, "No such file"),
        ("{", "no JSON"),
        ("[1]", "no result of shmtf-bench"),
        ('{"schema": "shmtf-bench/1", "kind": "compare"}', "has no cases"),
        ('{"schema": "shmtf-bench/1", "kind": "idle", "cases": []}', "results of one command"),
    ],
)
def test_errors(tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str | None, message: str) -> None:
    good, bad = tmp_path / "good.json", tmp_path / "bad.json"
    good.write_text(json.dumps(result("x", spread(1, 1, 1), [1])))
    if text is not None:
        bad.write_text(text)
    assert bench.main(["compare", str(good), str(bad)]) == 1
    errors = capsys.readouterr().err
    assert message in errors and len(errors.splitlines()) == 1
