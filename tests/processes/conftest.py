# SPDX-License-Identifier: Apache-2.0
"""Programs built by CMake with failpoints, and what the tests ask them to do."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
WATCHDOG_S = 240


@pytest.fixture(scope="session")
def program() -> Callable[[str], Path]:
    """Path of a program of tests/processes; skips where the C tests are not built."""

    def find(name: str) -> Path:
        build = os.environ.get("SHMTF_NATIVE_BUILD")
        path = Path(build or ROOT / "build" / "native") / "programs" / name
        if not path.exists():
            if build:
                pytest.fail(f"{path} was not built")
            pytest.skip(f"{name} is not built: tools/dev native")
        return path

    return find


@pytest.fixture
def run(program: Callable[[str], Path]) -> Callable[..., subprocess.CompletedProcess[str]]:
    """Runs a program to its end."""

    def start(name: str, *args: object) -> subprocess.CompletedProcess[str]:
        command = [str(program(name)), *map(str, args)]
        return subprocess.run(command, check=False, capture_output=True, text=True, timeout=WATCHDOG_S)

    return start
