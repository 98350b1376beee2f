# SPDX-License-Identifier: Apache-2.0
"""Programs built by CMake with failpoints, and what the tests ask them to do."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

WATCHDOG_S = 240


@pytest.fixture
def run(program: Callable[[str], Path]) -> Callable[..., subprocess.CompletedProcess[str]]:
    """Runs a program to its end."""

    def start(name: str, *args: object) -> subprocess.CompletedProcess[str]:
        command = [str(program(name)), *map(str, args)]
        return subprocess.run(command, check=False, capture_output=True, text=True, timeout=WATCHDOG_S)

    return start
