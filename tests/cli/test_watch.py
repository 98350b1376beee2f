# SPDX-License-Identifier: Apache-2.0
"""`shmtf-dump --watch` on a terminal of its own."""

from __future__ import annotations

import os
import re
import signal
import subprocess
from collections.abc import Callable, Iterator

import pytest

import shmtf

from .conftest import script

ENTER, LEAVE = b"\x1b[?1049h", b"\x1b[?1049l"


class Terminal:
    """A program on a pseudo terminal."""

    def __init__(self, ends: tuple[int, int], *words: str) -> None:
        master, slave = ends
        self.master = master
        self.seen = b""
        self.process = subprocess.Popen(
            words,
            stdin=slave,
            stdout=slave,
            stderr=slave,
            cwd="/",
            env={**os.environ, "TERM": "xterm"},
            process_group=0,
        )
        os.close(slave)

    def read_until(self, pattern: bytes, start: int = 0) -> int:
        """Read until it has appeared after `start`; returns where it ends."""
        while not (found := re.compile(pattern).search(self.seen, start)):
            self.seen += os.read(self.master, 65536)
        return found.end()

    def read_to_end(self) -> None:
        try:
            while chunk := os.read(self.master, 65536):
                self.seen += chunk
        except OSError:  # how Linux says that the other side is closed
            pass


@pytest.fixture
def terminal(open_terminal: Callable[[], tuple[int, int]]) -> Iterator[Callable[..., Terminal]]:
    made: list[Terminal] = []

    def start(*words: str) -> Terminal:
        made.append(Terminal(open_terminal(), *words))
        return made[-1]

    yield start
    for one in made:
        one.process.kill()
        one.process.wait()
        os.close(one.master)


def test_q_quits(live: shmtf.Store, terminal: Callable[..., Terminal]) -> None:
    screen = terminal(script("shmtf-dump"), live.name, "--watch", "--interval", "0.05")
    at = screen.read_until(rb"arm6[^\n]*odometry")
    screen.read_until(rb"arm6[^\n]*odometry", at)  # and again
    os.write(screen.master, b"q")
    screen.read_to_end()
    assert screen.process.wait() == 0
    assert screen.seen.count(ENTER) == screen.seen.count(LEAVE) == 1
    assert screen.seen.rstrip().endswith(LEAVE)
    assert b"Traceback" not in screen.seen


def test_interrupt_quits(live: shmtf.Store, terminal: Callable[..., Terminal]) -> None:
    screen = terminal(script("shmtf-dump"), live.name, "--watch", "--frame", "base")
    screen.read_until(rb"ring capacity")
    screen.process.send_signal(signal.SIGINT)
    screen.read_to_end()
    assert screen.process.wait() == 0
    assert screen.seen.rstrip().endswith(LEAVE)
    assert b"Traceback" not in screen.seen


def test_frame_that_goes(store: shmtf.Store, terminal: Callable[..., Terminal]) -> None:
    store.set_transform(shmtf.Transform("map", "base"))
    screen = terminal(script("shmtf-dump"), store.name, "--watch", "--frame", "base", "--interval", "0.05")
    screen.read_until(rb"ring capacity")
    store.remove_frame("base")
    screen.read_until(rb"does not exist")
    os.write(screen.master, b"q")
    screen.read_to_end()
    assert screen.process.wait() == 0
