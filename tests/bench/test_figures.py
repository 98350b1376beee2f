# SPDX-License-Identifier: Apache-2.0
"""`shmtf-bench figures`: two groups at the smallest size, their report, and a run that goes on."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from shmtf import bench
from shmtf.bench import _plot, figures
from shmtf.bench._figure_list import FIGURES
from shmtf.bench._groups import GROUPS, QUICK, REDUCED

SHORT = ["figures", "--quick", "--protocol", "shmtf,giant"]


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("figures")
    assert bench.main([*SHORT, "--out", str(path), "--groups", "ycsb-a,drones", "--no-pictures"]) == 0
    return path


def test_a_file_per_group(out: Path) -> None:
    assert sorted(p.name for p in out.iterdir()) == ["drones.json", "report.md", "ycsb-a.json"]
    result = json.loads((out / "ycsb-a.json").read_text())
    assert result["kind"] == "figures" and result["group"] == "ycsb-a" and result["machine"]["cpus"]
    assert {c["protocol"] for c in result["cases"]} == {"shmtf", "giant"}


def test_report(out: Path) -> None:
    text = (out / "report.md").read_text()
    for figure in FIGURES:
        if figure.group in ("ycsb-a", "drones"):
            assert figure.title in text and figure.question in text
    assert "![" not in text  # no pictures were asked for
    assert re.search(r"\| processes \| shmtf \| giant \|\n\| --- \| ---: \| ---: \|\n\| 1 \| \S+", text)


def test_pictures_of_what_is_there(out: Path) -> None:
    pytest.importorskip("matplotlib")
    times = {p.name: p.stat().st_mtime_ns for p in out.glob("*.json")}
    assert bench.main([*SHORT, "--out", str(out), "--groups", "ycsb-a,drones"]) == 0
    assert {p.name: p.stat().st_mtime_ns for p in out.glob("*.json")} == times  # measured once
    linked = re.findall(r"!\[.*\]\((.*)\)", (out / "report.md").read_text())
    assert "figure-5-6.png" in linked and "figure-drones-read.png" in linked
    assert sorted(linked) == sorted(p.name for p in out.glob("*.png"))
    assert all((out / name).read_bytes().startswith(b"\x89PNG") for name in linked)


def test_other_parameters_are_measured_anew(out: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    for path in out.glob("*.json"):
        (tmp_path / path.name).write_bytes(path.read_bytes())
    args = ["figures", "--quick", "--protocol", "shmtf", "--out", str(tmp_path), "--groups", "ycsb-a", "--no-pictures"]
    assert bench.main(args) == 0
    assert "kept" not in capsys.readouterr().out
    assert {c["protocol"] for c in json.loads((tmp_path / "ycsb-a.json").read_text())["cases"]} == {"shmtf"}


def test_a_damaged_file_is_no_result(out: Path, tmp_path: Path) -> None:
    text = (out / "drones.json").read_text()
    parameters = json.loads(text)["parameters"]
    path = tmp_path / "drones.json"
    assert figures._load(path, parameters) is None
    path.write_text(text[:100])
    assert figures._load(path, parameters) is None
    path.write_text(text)
    assert figures._load(path, parameters)


def test_interrupt_leaves_a_report_of_what_is_complete(tmp_path: Path) -> None:
    code = "import sys; from shmtf import bench; sys.exit(bench.main(sys.argv[1:]))"
    args = [*SHORT, "--out", str(tmp_path), "--groups", "snakes,drones", "--no-pictures"]
    process = subprocess.Popen([sys.executable, "-c", code, *args], cwd="/", stdout=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 60
    while not (tmp_path / "snakes.json").exists() and time.monotonic() < deadline:
        time.sleep(0.01)
    process.send_signal(signal.SIGINT)
    text, _ = process.communicate(timeout=60)
    assert process.returncode == 130 and "interrupted" in text
    report = (tmp_path / "report.md").read_text()
    assert "Many snakes" in report and "Not measured: drones" in report
    assert not (tmp_path / "drones.json").exists()
    assert not [name for name in os.listdir("/dev/shm") if f"shmtf-bench-{process.pid}-" in name]


def test_every_group_has_figures_and_every_figure_a_group() -> None:
    assert {figure.group for figure in FIGURES} == {group.name for group in GROUPS}
    keys = [figure.key for figure in FIGURES]
    assert len(set(keys)) == len(keys)
    assert {f"5.{n}" for n in range(2, 29)} <= set(keys)


def test_reduced_sizes_take_less_than_half_an_hour() -> None:
    """By what the command itself expects; no clock is read."""
    protocols = ["shmtf", "giant", "snapshot", "latest", "silo", "tf2"]
    assert sum(group.seconds(REDUCED, protocols) for group in GROUPS) < 1800
    assert sum(group.seconds(QUICK, protocols) for group in GROUPS) < 120


def test_zero_has_no_place_on_a_logarithmic_axis() -> None:
    figure = next(f for f in FIGURES if f.key == "5.27")
    rounds = [{"deviation_ns": {"mean": 0.0}}]
    cases = [{"protocol": "tf2", "processes": 2, "rounds": rounds}]
    all_series = _plot.series(figure, cases)
    assert [s.protocol for s in all_series] == ["tf2"]
    assert _plot.drawable(figure, all_series) == []


def test_without_matplotlib(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    assert bench.main([*SHORT, "--out", str(tmp_path / "x")]) == 1
    assert "pip install 'shmtf[plot]'" in capsys.readouterr().err
    assert not (tmp_path / "x").exists()


def test_no_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").touch()
    assert bench.main([*SHORT, "--no-pictures", "--out", str(tmp_path / "file")]) == 1
    assert "exists" in capsys.readouterr().err
