# SPDX-License-Identifier: Apache-2.0
"""A writer is killed, and stopped, before every store of every operation, and killed after machine instructions.

Tier: test, the short forms; `tools/dev prove` runs the long ones.  What is verified: tests/prove/prove.h.
"""

from __future__ import annotations

import subprocess
from collections.abc import Callable

import pytest

SKIPPED = 77
Run = Callable[..., subprocess.CompletedProcess[str]]


def rows_of(output: str, columns: int) -> dict[str, list[int]]:
    """The table: what was done, and its numbers."""
    rows = {}
    for line in output.splitlines():
        words = line.split()
        if len(words) > columns and all(word.isdigit() for word in words[-columns:]):
            rows[" ".join(words[:-columns])] = [int(word) for word in words[-columns:]]
    return rows


@pytest.fixture(scope="module")
def quick_run(program: Callable[[str], object]) -> subprocess.CompletedProcess[str]:
    command = [str(program("prove")), "--quick"]
    return subprocess.run(command, check=False, capture_output=True, text=True, timeout=240)


def test_killed_and_stopped_before_every_store(quick_run: subprocess.CompletedProcess[str]) -> None:
    assert quick_run.returncode == 0, quick_run.stdout + quick_run.stderr
    rows = rows_of(quick_run.stdout, 6)
    stores, _, killed, killed_twice, stopped, failures = rows.pop("all")
    assert failures == 0
    for name, row in rows.items():
        if "80 frames" not in name:  # of which the short form takes a sample
            assert row[0] == row[2] or row[0] == row[3], f"{name}: not killed before every store"
    assert min(killed, killed_twice, stopped) > 500
    assert stores > 2500


def test_every_store_is_counted(quick_run: subprocess.CompletedProcess[str]) -> None:
    """Or a death between two of them would have been missed."""
    assert quick_run.returncode == 0, quick_run.stdout + quick_run.stderr
    watched = next(line for line in quick_run.stdout.splitlines() if "stores watched" in line)
    assert int(watched.split("each of ")[1].split()[0]) > 5000
    assert "nothing else changed" in watched


def test_killed_after_machine_instructions(run: Run) -> None:
    done = run("prove_instructions", "--quick")
    if done.returncode == SKIPPED:
        pytest.skip(done.stderr.strip())
    assert done.returncode == 0, done.stdout + done.stderr
    assert "all" in done.stdout
