# SPDX-License-Identifier: Apache-2.0
"""The command lines as a user runs them, beside a store whose writers never rest."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import textwrap
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

import shmtf

WRITER = """
import itertools, math, sys
import shmtf

def T(parent, child, x=0.0):
    return shmtf.Transform(parent, child, None, (x, 0.0, 0.5))

with shmtf.Store.attach(sys.argv[1], authority="odometry") as store:
    store.set_transforms([T("base", "laser"), T("base", "rig")], static=True, authority="mounts")
    store.set_transform(T("map", "odom"), authority="localisation")
    for i in itertools.count():
        x = math.sin(i / 100)
        arm = [T(f"arm{j}" if j else "base", f"arm{j + 1}", x) for j in range(6)]
        store.set_transforms([T("odom", "base", x), *arm])
        if i % 50 == 0:
            store.set_transform(T("map", "odom", x), authority="localisation")
"""

BATCH = """
import sys
import shmtf
with shmtf.Store.attach(sys.argv[1], authority="big batch") as store:
    batch = [shmtf.Transform("map", f"part{i}") for i in range(400)]
    while True:
        store.set_transforms(batch)
"""


def script(name: str) -> str:
    """An installed command."""
    path = Path(sys.executable).parent / name
    if not path.exists():
        pytest.skip(f"{name} is not installed beside {sys.executable}")
    return str(path)


Run = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture
def command() -> Run:
    """Runs `shmtf ...` or `shmtf-dump ...` to its end; `code` is the exit code to expect."""

    def run(*words: str, code: int = 0, env: dict[str, str] | None = None) -> subprocess.CompletedProcess[str]:
        program, *arguments = words
        clean = {key: value for key, value in os.environ.items() if key != "SHMTF_STORE"}
        done = subprocess.run(
            [script(program), *arguments],
            check=False,
            capture_output=True,
            text=True,
            env={**clean, **(env or {})},
            cwd="/",
        )
        assert "Traceback" not in done.stderr, done.stderr
        assert done.returncode == code, done.stdout + done.stderr
        return done

    return run


@pytest.fixture
def start() -> Iterator[Callable[..., subprocess.Popen[str]]]:
    """Starts a Python program in the background; it is gone at the end of the test."""
    running: list[subprocess.Popen[str]] = []

    def popen(code: str, *arguments: str) -> subprocess.Popen[str]:
        running.append(subprocess.Popen([sys.executable, "-c", textwrap.dedent(code), *arguments], text=True, cwd="/"))
        return running[-1]

    yield popen
    for process in running:
        process.kill()
        process.wait()


def until_version(store: shmtf.Store, version: int, process: subprocess.Popen[str]) -> None:
    """Wait for so many commits of a living process."""
    while (since := store.version) < version:
        assert process.poll() is None, "the writer died"
        try:
            store.wait_for_change(since=since, timeout=1.0)
        except shmtf.TimeoutException:
            continue


@pytest.fixture
def live(store_name: str, start: Callable[..., subprocess.Popen[str]]) -> Iterator[shmtf.Store]:
    """A store that a process writes without pause: rings turn in well under a second."""
    with shmtf.Store.create(store_name, max_frames=64, history=32, stream_bytes=1 << 18) as store:
        until_version(store, 200, start(WRITER, store_name))
        yield store


class Holder:
    """A writer that holds frames, because it is stopped or was killed in the middle of a commit."""

    def __init__(self, store: shmtf.Store, process: subprocess.Popen[str]) -> None:
        self.store = store
        self.process = process

    def stop_inside(self) -> None:
        """Stop it again and again until it holds frames."""
        while True:
            self.process.send_signal(signal.SIGSTOP)
            os.waitpid(self.process.pid, os.WUNTRACED)
            if self.store._check()["locks_held"]:
                return
            self.process.send_signal(signal.SIGCONT)
            until_version(self.store, self.store.version + 3, self.process)

    def kill(self) -> None:
        self.process.kill()
        self.process.wait()

    def held_frame(self) -> str:
        """One of the frames that it holds."""
        return next(name for name in self.store.frames() if self.store._frame_words(name)["locked"])


@pytest.fixture
def holder(store_name: str, start: Callable[..., subprocess.Popen[str]]) -> Iterator[Holder]:
    """A store whose only writer is stopped while it holds frames."""
    with shmtf.Store.create(store_name, max_frames=512, history=16, stream_bytes=1 << 18) as store:
        process = start(BATCH, store_name)
        until_version(store, 10, process)
        made = Holder(store, process)
        made.stop_inside()
        yield made
