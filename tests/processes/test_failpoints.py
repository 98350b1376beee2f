# SPDX-License-Identifier: Apache-2.0
"""A writer is killed or stopped inside a write, at every named step, and watched from Python.

Readers answer at once and see all of the write or nothing.  After a kill the next writer goes on; beside a stopped
writer it is told who holds the frame, and other frames can be written.  Before every store: test_prove.py.
"""

from __future__ import annotations

import os
import signal
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

import shmtf

OPERATIONS = ("update", "birth", "remove", "clear", "declare", "fixed")
BEFORE, AFTER = "before", "after"
COMMITTED = {"committed", "topology-raised", "half-unlocked", "tagged"}
IDENTITY = (0.0, 0.0, 0.0, 1.0)


class World:
    """A store with three frames below "root", seen through two handles."""

    def __init__(self, name: str) -> None:
        self.writer = shmtf.Store.create(name, max_frames=16, history=14, cache_time=None, stream_bytes=1 << 14)
        self.reader = shmtf.Store.attach(name, readonly=True)
        self.name = name
        self.value = 0
        self.write("other", static=True)
        for _ in range(4):
            self.write("a", "b", "c")

    def close(self) -> None:
        self.reader.close()
        self.writer.close()

    def write(self, *frames: str, static: bool = False, timeout: float = 60.0) -> None:
        """All of them at the next value, whose stamp is ten times as much."""
        self.value += 1
        batch = [
            shmtf.Transform("root", f, None if static else self.value * 10, (self.value, 0, 0), IDENTITY)
            for f in frames
        ]
        self.writer.set_transforms(batch, static=static, timeout=timeout)

    def state_of(self, operation: str, value: int) -> str:
        """Before, after, or whatever else the readers see; both handles and two looks must agree."""
        seen = {look(store, operation, value, self.value) for store in (self.reader, self.writer, self.reader)}
        assert len(seen) == 1, f"readers disagree: {seen}"
        return seen.pop()


def x_of(reads: shmtf.Store | shmtf.Snapshot, frame: str, time: int | None = None) -> float | None:
    try:
        if time is None:
            return float(reads.lookup_latest_transform("root", frame).translation[0])
        return float(reads.lookup_transform("root", frame, time).translation[0])
    except (shmtf.LookupException, shmtf.ConnectivityException):
        return None


def look(store: shmtf.Store, operation: str, value: int, last: int) -> str:
    """Which state of the world does one snapshot show?"""
    with store.snapshot() as snap:
        if operation == "update":
            late = x_of(snap, "b", value * 10 - 15)
            seen: tuple[object, ...] = (x_of(snap, "a"), x_of(snap, "c"), late)
            states = {
                (float(last), float(last), value - 1.5): BEFORE,
                (float(value), float(value), float(value)): AFTER,
            }
        elif operation == "fixed":
            seen = (x_of(snap, "a"), x_of(snap, "c"))
            states = {(float(last), float(last)): BEFORE, (float(value), float(value)): AFTER}
        elif operation == "birth":
            seen = (snap.frame_exists("n"), snap.frame_exists("m"))
            states = {(False, False): BEFORE, (True, True): AFTER}
        elif operation == "remove":
            seen = (snap.frame_exists("a"), x_of(snap, "a"))
            states = {(True, float(last)): BEFORE, (False, None): AFTER}
        elif operation == "clear":
            seen = (x_of(snap, "a"), x_of(snap, "b"), x_of(snap, "c"))
            states = {(float(last),) * 3: BEFORE, (None,) * 3: AFTER}
        else:
            seen = (snap.frame_exists("d"),)
            states = {(False,): BEFORE, (True,): AFTER}
        return states.get(seen, f"a mixture: {seen}")


@pytest.fixture
def world(store_name: str) -> Iterator[World]:
    made = World(store_name)
    yield made
    made.close()


@pytest.fixture
def new_world(new_name: Callable[[], str]) -> Iterator[Callable[[], World]]:
    made: list[World] = []

    def make() -> World:
        made.append(World(new_name()))
        return made[-1]

    yield make
    for one in made:
        one.close()


@pytest.fixture
def named_steps(
    run: Callable[..., subprocess.CompletedProcess[str]], new_world: Callable[[], World]
) -> Callable[[str], dict[str, int]]:
    """The failpoints that an operation comes by, and how often."""

    def ask(operation: str) -> dict[str, int]:
        world = new_world()
        done = run("failpoint_writer", world.name, operation, world.value + 1, "--list")
        assert done.returncode == 0, done.stderr
        return {name: int(n) for name, n in (line.split() for line in done.stdout.splitlines())}

    return ask


def start(program: Path, world: World, operation: str, *how: object) -> subprocess.Popen[bytes]:
    return subprocess.Popen([str(program), world.name, operation, str(world.value + 1), *map(str, how)])


def check_next_writer(world: World) -> None:
    """After a death: every frame can be written, at the first attempt's leisure, and nothing stays locked."""
    world.write("new one")
    world.write("a", "b", "c")
    world.write("a", "b", "c")
    with world.reader.snapshot() as snap:
        assert {x_of(snap, f) for f in "abc"} == {float(world.value)}
    report = world.writer._check(True)
    assert report["bad_words"] == 0
    assert world.writer._check()["locks_held"] == 0


@pytest.mark.parametrize("operation", OPERATIONS)
def test_killed_at_every_failpoint(
    operation: str,
    program: Callable[[str], Path],
    named_steps: Callable[[str], dict[str, int]],
    new_world: Callable[[], World],
) -> None:
    steps = named_steps(operation)
    assert steps
    for name, times in steps.items():
        for nth in {1, times}:
            world = new_world()
            victim = start(program("failpoint_writer"), world, operation, "--at", name, "--nth", nth)
            assert victim.wait() == -signal.SIGKILL, (name, nth)
            expected = AFTER if name in COMMITTED else BEFORE
            assert world.state_of(operation, world.value + 1) == expected, (name, nth)
            check_next_writer(world)


def is_stopped(victim: subprocess.Popen[bytes]) -> bool:
    _, status = os.waitpid(victim.pid, os.WUNTRACED)
    if os.WIFSTOPPED(status):
        return True
    victim.returncode = os.waitstatus_to_exitcode(status)
    return False


def check_beside_stopped(world: World, victim: subprocess.Popen[bytes], operation: str) -> str:
    """Readers, then writers, beside a writer that stands still.  Returns what the readers saw."""
    value = world.value + 1
    seen = world.state_of(operation, value)
    assert seen in (BEFORE, AFTER)
    assert x_of(world.reader, "other") is not None
    world.write("other", static=True, timeout=0.0)
    held = 0
    for frame in "abc":
        try:
            world.write(frame, timeout=0.0)
        except shmtf.BusyError as error:
            assert error.holder_pid == victim.pid
            assert error.holder == "failpoint_writer"
            held += 1
    assert not (held and seen == AFTER), "what is committed must be finished by others"
    return seen


@pytest.mark.parametrize("operation", OPERATIONS)
def test_stopped_at_every_failpoint(
    operation: str,
    program: Callable[[str], Path],
    named_steps: Callable[[str], dict[str, int]],
    new_world: Callable[[], World],
) -> None:
    steps = named_steps(operation)
    assert steps
    for name in steps:
        world = new_world()
        victim = start(program("failpoint_writer"), world, operation, "--at", name, "--signal", "STOP")
        try:
            assert is_stopped(victim), name
            seen = check_beside_stopped(world, victim, operation)
            assert seen == (AFTER if name in COMMITTED else BEFORE), name
        finally:
            victim.send_signal(signal.SIGCONT)
        assert victim.wait() == 0, name
        check_next_writer(world)


def kill_twice(program: Path, world: World, first: str, *second: object) -> tuple[int, str]:
    """A victim dies at `first`, then whoever takes over its slot.  The exit code of the second, and what is seen."""
    value = world.value + 1
    victim = start(program, world, "update", "--at", first)
    assert victim.wait() == -signal.SIGKILL
    code = start(program, world, "update", *second).wait()
    state = world.state_of("update", value)
    assert state in (BEFORE, AFTER)
    assert state == AFTER or first not in COMMITTED, "a commit was lost"
    check_next_writer(world)
    return code, state


@pytest.mark.parametrize(
    ("first", "second"),
    [(f, s) for f in ("staged-all", "prepared") for s in ("adopt-begun", "adopt-scanned", "undoing", "locked")]
    + [(f, s) for f in ("committed", "half-unlocked") for s in ("adopt-begun", "adopt-scanned", "tagged", "locked")],
)
def test_the_recoverer_is_killed_too(first: str, second: str, program: Callable[[str], Path], world: World) -> None:
    code, state = kill_twice(program("failpoint_writer"), world, first, "--at", second)
    assert code == -signal.SIGKILL
    assert state == (AFTER if first in COMMITTED else BEFORE)
