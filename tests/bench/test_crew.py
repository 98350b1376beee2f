# SPDX-License-Identifier: Apache-2.0
"""Processes with roles end with their coordinator, and leave nothing behind."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

import psutil
import pytest

from shmtf.bench import BenchError
from shmtf.bench._crew import Crew

LONG = {
    "wakeup": ["--waiters", "2", "--n", "1000", "--gap-ms", "20", "--rounds", "99"],
    "idle": ["--processes", "2", "--duration", "60"],
    "recover": ["--frames", "4", "--n", "100000"],
}


def start(command: str, members: int) -> tuple[subprocess.Popen[str], list[psutil.Process]]:
    """A run of a minute at least, and its members."""
    code = "import sys; from shmtf import bench; sys.exit(bench.main(sys.argv[1:]))"
    process = subprocess.Popen(
        [sys.executable, "-c", code, command, *LONG[command]],
        cwd="/",
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline and process.poll() is None:
        children = psutil.Process(process.pid).children()
        if len(children) >= members and all(child.num_threads() > 1 for child in children):
            return process, children
        time.sleep(0.01)
    process.kill()
    pytest.fail(f"no members: {process.communicate()}")


def assert_gone(process: subprocess.Popen[str], members: list[psutil.Process]) -> None:
    _, alive = psutil.wait_procs(members, timeout=30)
    assert not alive
    assert not [name for name in os.listdir("/dev/shm") if f"shmtf-bench-{process.pid}-" in name]


@pytest.mark.parametrize(("command", "members"), [("wakeup", 3), ("idle", 3), ("recover", 1)])
@pytest.mark.parametrize("ending", [signal.SIGINT, signal.SIGKILL])
def test_nothing_is_left(command: str, members: int, ending: signal.Signals) -> None:
    process, children = start(command, members)
    process.send_signal(ending)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == (130 if ending == signal.SIGINT else -signal.SIGKILL)
    assert "Traceback" not in errors
    assert_gone(process, children)


def test_a_dead_member_is_an_error() -> None:
    process, children = start("idle", 3)
    children[-1].kill()
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 1
    assert "is dead: killed by SIGKILL" in errors and len(errors.splitlines()) == 1
    assert_gone(process, children)


def test_an_error_in_a_member_is_said() -> None:
    with Crew() as crew, pytest.raises(BenchError, match=r"the victim is dead: .*shmtf-bench-none.*no such store"):
        crew.add("recover", "victim", store="shmtf-bench-none", frames=1).hear()
    assert all(member.process.poll() is not None for member in crew.members)
