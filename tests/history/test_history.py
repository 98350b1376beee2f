# SPDX-License-Identifier: Apache-2.0
"""Recorded histories of real processes are strictly serialisable, by two checkers that share the log's format alone.

Tier: test (about a million operations; SHMTF_STRESS_SECONDS: how many, SHMTF_HISTORY_SEED: which). On demand, for as
long as one likes: tools/dev history.
"""

from __future__ import annotations

import os
import subprocess
from collections.abc import Callable
from pathlib import Path

import log
import pytest
import tree
from linear import first_impossible

SECONDS = float(os.environ.get("SHMTF_STRESS_SECONDS", "3"))
SEED = int(os.environ.get("SHMTF_HISTORY_SEED", "1"))

RUNS = {  # seed, writers, readers, kills per second, chaos
    "at full speed, histories that expire by number": (0, 3, 3, 20, 0),
    "at full speed, histories that expire by age": (3, 3, 3, 20, 0),
    "disturbed between any two shared accesses": (1, 4, 3, 100, 16),
}


@pytest.mark.stress
@pytest.mark.parametrize("name", RUNS)
def test_recorded_history_is_strictly_serialisable(
    name: str, record: Callable[..., Path], replay: Callable[[Path], subprocess.CompletedProcess[str]]
) -> None:
    seed, *who = RUNS[name]
    path = record(SEED + seed, int(1000 * SECONDS), *who)
    done = replay(path)
    print(done.stdout)
    assert done.returncode == 0, done.stdout


@pytest.mark.parametrize(("seed", "kills", "chaos"), [(0, 0, 0), (1, 0, 16), (2, 10, 16)])
def test_short_history_has_a_serial_order_whatever_its_versions(
    seed: int,
    kills: int,
    chaos: int,
    record: Callable[..., Path],
    replay: Callable[[Path], subprocess.CompletedProcess[str]],
) -> None:
    path = record(SEED + seed, 250, 3, 2, kills, chaos, 128)
    impossible = first_impossible(tree.operations(log.read(path)), tree.NOTHING)
    assert impossible is None, impossible.name
    assert replay(path).returncode == 0
