# SPDX-License-Identifier: Apache-2.0
"""Many processes at once: no reader sees a mixture, no writer fails; random deaths leave nothing half-done."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Callable

import pytest

SECONDS = float(os.environ.get("SHMTF_STRESS_SECONDS", "3"))


@pytest.mark.parametrize(("processes", "updates"), [(2, 4000), (8, 1000), (32, 200)])
def test_readers_see_no_mixture(
    processes: int, updates: int, run: Callable[..., subprocess.CompletedProcess[str]], store_name: str
) -> None:
    """Half of them write 16 frames with one stamp per update, the other half read the chain of these frames."""
    done = run("mixture", store_name, processes, updates)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.stress
def test_random_kills(run: Callable[..., subprocess.CompletedProcess[str]], store_name: str) -> None:
    """About a hundred kills a second."""
    done = run("soak", store_name, 4, 2, int(100 * SECONDS))
    assert done.returncode == 0, done.stdout + done.stderr
