# SPDX-License-Identifier: Apache-2.0
"""The models beside this file, quickly; all of them: tools/dev model. Tier: test.

The scheduler itself runs as CTest xsim_*. Here: the Promela model with planted errors found, and that the scenarios
for weak memory, whose checkers are not packaged, still fit the source that they take apart.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

MODEL = Path(__file__).resolve().parent
sys.path.insert(0, str(MODEL))
import models  # noqa: E402
import weak  # noqa: E402

needs_spin = pytest.mark.skipif(shutil.which("spin") is None, reason="spin is not installed")


@needs_spin
def test_commit_model_has_no_violation(tmp_path: Path) -> None:
    errors, states = models.spin(["ATOMICITY", "CRASHES=0"], tmp_path)
    assert errors == 0
    assert float(states) > 100_000


@needs_spin
@pytest.mark.parametrize(
    ("error", "check"),
    [("WITHOUT_VERSIONS", "ATOMICITY"), ("WITHOUT_TOPOLOGY_CHECK", "SHAPE")],
)
def test_planted_error_is_found(tmp_path: Path, error: str, check: str) -> None:
    errors, _ = models.spin([check, "CRASHES=0", error], tmp_path)
    assert errors > 0


def test_every_planted_error_of_the_model_is_run() -> None:
    switches = set(re.findall(r"#ifn?def (WITH(?:OUT)?_\w+)", (MODEL / "commit.pml").read_text()))
    assert switches == {error for error, _, _ in models.PLANTED}


def test_scenario_names_are_found() -> None:
    names = models.scenarios()
    assert len(names) == len(set(names)) > 30


def test_weak_scenarios_fit_the_source(tmp_path: Path) -> None:
    compiler = shutil.which("clang") or shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler")
    weak.prepare(tmp_path, "")
    for scenario in sorted({check.scenario for check in weak.CHECKS}):
        command = [compiler, "-fsyntax-only", "-w", "-I.", "-Iinclude", scenario]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=120, check=False)
        assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("broken", sorted({check.broken for check in weak.CHECKS if check.broken}))
def test_ends_are_found_in_the_source(tmp_path: Path, broken: str) -> None:
    weak.prepare(tmp_path, broken)  # exits if no line carries the label


def test_an_end_that_nothing_carries_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SystemExit, match="no line carries"):
        weak.prepare(tmp_path, "E99 release")


def test_every_edge_is_taken_away() -> None:
    edges = {end.split()[0] for check in weak.CHECKS if check.broken for end in check.broken.split(", ")}
    assert edges == {f"E{n}" for n in range(1, 12)}


def test_litmus_files_say_what_they_expect() -> None:
    for path in weak.WEAK.glob("*.litmus"):
        expected = re.search(r"expect: (never|sometimes)", path.read_text())
        assert expected, path
        assert (expected[1] == "sometimes") == ("-with" in path.name), path
