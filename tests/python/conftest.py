# SPDX-License-Identifier: Apache-2.0
"""Fixtures of processes that are stopped or interrupted in the middle."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import textwrap
from collections.abc import Callable, Iterator

import pytest

import shmtf
from shmtf import Store, Transform

SMALL = {"max_frames": 16, "history": 8, "stream_bytes": 1 << 12}


def path_of(name: str) -> str:
    return os.path.join("/dev/shm", name)


def map_lines(name: str) -> list[str]:
    """Permissions of this process' mappings of a store."""
    with open("/proc/self/maps") as maps:
        return [line.split()[1] for line in maps if line.rstrip().endswith(path_of(name))]


def write(name: str, data: bytes) -> None:
    with open(path_of(name), "wb") as file:
        file.write(data)


def read(name: str) -> bytes:
    with open(path_of(name), "rb") as file:
        return file.read()


@pytest.fixture
def image(new_name: Callable[[], str]) -> bytes:
    """A whole store with some contents."""
    name = new_name()
    with Store.create(name, **SMALL) as store:
        for k in range(20):
            store.set_transforms([Transform("map", "a", k, (k, 0, 0)), Transform("a", "b", k, (0, k, 0))])
        store.set_transform(Transform("b", "c"), static=True)
    data = read(name)
    Store.unlink(name)
    return data


@pytest.fixture
def held(store: Store) -> Iterator[subprocess.Popen[bytes]]:
    """Keeps the frame "held" busy: a writer of it is stopped somewhere in the middle of a commit."""
    store.set_transform(Transform("map", "held", 0))
    code = f"""
        import shmtf
        store = shmtf.Store.attach({store.name!r}, authority="the stopped one")
        batch = [shmtf.Transform("map", "held", 1), *(shmtf.Transform("map", f"f{{i}}", 1) for i in range(40))]
        i = 1
        while True:
            i += 1
            store.set_transforms([shmtf.Transform("map", t.child, i) for t in batch])
    """
    process = subprocess.Popen([sys.executable, "-c", textwrap.dedent(code)], cwd="/")
    try:
        while True:
            store.wait_for_change("held")
            os.kill(process.pid, signal.SIGSTOP)
            os.waitid(os.P_PID, process.pid, os.WSTOPPED)
            if store._frame_words("held")["locked"]:
                try:  # a commit that was decided before the stop is finished by others
                    store.set_transform(Transform("map", "held", 0, (1, 0, 0)), timeout=0)
                except shmtf.BusyError:
                    break
            os.kill(process.pid, signal.SIGCONT)
        yield process
    finally:
        process.kill()
        process.wait()


@pytest.fixture
def interrupt() -> Callable[[str], None]:
    def run(code: str) -> None:
        """Runs `code`, sends SIGINT once it sleeps in the kernel, and expects it to say so."""
        process = subprocess.Popen(
            [sys.executable, "-c", textwrap.dedent(code)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            cwd="/",
        )
        try:
            assert process.stdout.readline() == "ready\n"
            while process.poll() is None:  # until it sleeps: a signal before that would find no wait to end
                with open(f"/proc/{process.pid}/stat") as file:
                    if file.read().rsplit(")", 1)[1].split()[0] == "S":
                        break
            os.kill(process.pid, signal.SIGINT)
            out, err = process.communicate(timeout=60)
            assert out == "interrupted\n", err
            assert process.returncode == 0
        finally:
            process.kill()
            process.wait()

    return run
