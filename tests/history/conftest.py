# SPDX-License-Identifier: Apache-2.0
"""Recordings and their verdicts; the modules of this folder."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

HERE = Path(__file__).resolve().parent
WATCHDOG_S = 240

sys.path.insert(0, str(HERE))


@pytest.fixture
def replay(program: Callable[[str], Path]) -> Callable[[Path], subprocess.CompletedProcess[str]]:
    """The exact checker's verdict on a log."""

    def run(path: Path) -> subprocess.CompletedProcess[str]:
        command = [str(program("history_replay")), str(path)]
        return subprocess.run(command, check=False, capture_output=True, text=True, timeout=WATCHDOG_S)

    return run


@pytest.fixture
def record(program: Callable[[str], Path], store_name: str, tmp_path: Path) -> Iterator[Callable[..., Path]]:
    """Records: seed, milliseconds, writers, readers, kills per second, chaos, KiB per process. Returns the log."""
    path = tmp_path / "log"

    def run(*args: int) -> Path:
        command = [str(program("history_record")), store_name, str(path), *map(str, args)]
        done = subprocess.run(command, check=False, capture_output=True, text=True, timeout=WATCHDOG_S)
        assert done.returncode == 0, done.stdout + done.stderr
        return path

    yield run
    path.unlink(missing_ok=True)  # some hundred megabytes
