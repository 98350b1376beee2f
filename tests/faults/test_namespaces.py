# SPDX-License-Identifier: Apache-2.0
"""Writers in PID namespaces of their own, and pids that are used again: neither decides who lives.  Tier: test."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import textwrap
from collections.abc import Callable, Iterator

import psutil
import pytest

import shmtf
from shmtf import Store, Transform

from .conftest import WATCHDOG_S

AS_SECOND = ["sh", "-c", '"$@"; exit $?', "sh"]  # the first process of a namespace cannot kill itself
PID = ["--pid", "--fork", "--mount-proc"]


@pytest.fixture
def world(store_name: str) -> Iterator[Store]:
    """What failpoint_writer's "update" expects."""
    with Store.create(store_name, max_frames=16, history=14, cache_time=None, stream_bytes=1 << 14) as store:
        for value in range(1, 5):
            write(store, value)
        yield store


def write(store: Store, value: int, **keywords: float) -> None:
    store.set_transforms([Transform("root", f, value * 10, (value, 0, 0)) for f in "abc"], **keywords)


def values(store: Store) -> set[float]:
    with store.snapshot() as snap:
        return {float(snap.lookup_latest_transform("root", f).translation[0]) for f in "ac"}  # it writes b late


def writer_in_its_own(unshare: Callable, program: Callable, store: Store, step: str, number: str) -> list[str]:
    victim = [program("failpoint_writer"), store.name, "update", "5", "--at", step, "--signal", number]
    return [*unshare(*PID), *AS_SECOND, *victim]


def other_writer(unshare: Callable, store: Store, code: str) -> str:
    """Code in another PID namespace, with `store` and `write`; what it prints."""
    lines = f"""
        import shmtf
        store = shmtf.Store.attach({store.name!r}, authority="the other")
        def write(value, **keywords):
            batch = [shmtf.Transform("root", f, value * 10, (value, 0, 0)) for f in "abc"]
            store.set_transforms(batch, **keywords)
    """
    done = subprocess.run(
        [*unshare(*PID), sys.executable, "-c", textwrap.dedent(lines) + textwrap.dedent(code)],
        check=False, capture_output=True, text=True, cwd="/", timeout=WATCHDOG_S,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


@pytest.mark.parametrize("attached", [True, False])
@pytest.mark.parametrize(("step", "committed"), [("locked", False), ("prepared", False), ("committed", True)])
def test_the_dead_of_another_namespace_are_recovered(
    unshare: Callable, program: Callable, world: Store, step: str, committed: bool, attached: bool
) -> None:
    victim = writer_in_its_own(unshare, program, world, step, "KILL")
    assert subprocess.run(victim, check=False, timeout=WATCHDOG_S).returncode == 128 + signal.SIGKILL
    assert values(world) == {5.0 if committed else 4.0}
    if attached:  # asks the kernel who lives
        write(world, 6, timeout=0.0)
    else:  # takes over the slot of the dead
        assert other_writer(unshare, world, "write(6, timeout=0.0); print(store.counters()['commits'])") == "1"
    assert values(world) == {6.0}
    assert world._check()["locks_held"] == 0


def stopped_below(process: subprocess.Popen[bytes]) -> psutil.Process:
    """The descendant that has stopped itself."""
    while process.poll() is None:
        for found in psutil.Process(process.pid).children(recursive=True):
            try:
                if found.status() == psutil.STATUS_STOPPED:
                    return found
            except psutil.NoSuchProcess:
                continue
    return pytest.fail(f"exit {process.returncode}")


def test_the_living_of_another_namespace_are_not_robbed(unshare: Callable, program: Callable, world: Store) -> None:
    """Its pid means nothing, or somebody else, where the others live."""
    holder = subprocess.Popen(writer_in_its_own(unshare, program, world, "staged-all", "STOP"))
    try:
        stopped = stopped_below(holder)
        code = """
            import os
            try:
                write(6, timeout=0.05)
            except shmtf.BusyError as error:
                print(error.holder, error.holder_pid != os.getpid(), [w["alive"] for w in store._writers()])
        """
        for _ in range(2):
            assert other_writer(unshare, world, code).startswith("failpoint_writer True")
            with pytest.raises(shmtf.BusyError) as caught:
                write(world, 6, timeout=0.0)
            assert caught.value.holder_pid != stopped.pid  # it says the pid that its own namespace knows
        assert values(world) == {4.0}
        stopped.send_signal(signal.SIGCONT)
        assert holder.wait(timeout=WATCHDOG_S) == 0
        assert values(world) == {5.0}
    finally:
        holder.kill()
        holder.wait()
    write(world, 6, timeout=0.0)


REUSE = """
    import os, subprocess, sys, shmtf
    program, name = sys.argv[1:]
    store = shmtf.Store.attach(name)
    store.set_transform(shmtf.Transform("root", "elsewhere", 1))  # it has a slot, and takes nobody's over
    victim = subprocess.Popen([program, name, "update", "5", "--at", "staged-all"])
    victim.wait()
    assert victim.returncode == -9, victim.returncode
    for attempt in range(200):
        with open("/proc/sys/kernel/ns_last_pid", "w") as file:
            file.write(str(victim.pid - 1))
        said, say = os.pipe()
        pid = os.fork()
        if pid == 0:
            os.setsid()
            if os.getpid() == victim.pid:  # it uses the store, and stays
                mine = shmtf.Store.attach(name, readonly=True)
                mine.frames()
                os.write(say, b"x")
                import signal
                signal.pause()
            os._exit(0)
        if pid == victim.pid:
            os.read(said, 1)
            break
        os.waitpid(pid, 0)
        os.close(said), os.close(say)
    else:
        sys.exit("the pid did not come again")
    alive = [w["alive"] for w in store._writers() if w["pid"] == victim.pid]
    batch = [shmtf.Transform("root", f, 60, (6, 0, 0)) for f in "abc"]
    store.set_transforms(batch, timeout=0.0)
    assert store._check()["locks_held"] == 0
    print("recovered", alive)
    os.kill(pid, 9)
    os.waitpid(pid, 0)
"""


def test_a_pid_that_is_used_again_keeps_no_lock(
    unshare: Callable, program: Callable, world: Store, python: Callable
) -> None:
    if os.geteuid() or not os.access("/proc/sys/kernel/ns_last_pid", os.W_OK):
        pytest.skip("pids cannot be chosen here")
    said = python(REUSE, program("failpoint_writer"), world.name, before=unshare(*PID))
    assert said == "recovered [False]\n"
    assert values(world) == {6.0}


# ---- time namespaces ----


def test_another_monotonic_clock(unshare: Callable, store: Store) -> None:
    """A process whose CLOCK_MONOTONIC is years ahead, or that has woken from a long sleep, waits as long as it says."""
    namespace = unshare("--time", "--fork", "--monotonic", "100000000")
    code = f"""
        import time, shmtf
        assert time.monotonic() > 100000000
        store = shmtf.Store.attach({store.name!r})
        start = time.monotonic()
        try:
            store.lookup_transform("map", "base", timeout=0.2)
        except shmtf.LookupTimeout:
            assert time.monotonic() - start >= 0.2
        print("ready", flush=True)
        print(store.lookup_transform("map", "base", timeout=None).stamp)
        store.set_transform(shmtf.Transform("map", "answer", 2))
    """
    process = subprocess.Popen(
        [*namespace, sys.executable, "-c", textwrap.dedent(code)], stdout=subprocess.PIPE, text=True, cwd="/"
    )
    try:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        store.set_transform(Transform("map", "base", 7))
        assert store.lookup_transform("map", "answer", timeout=None).stamp == 2
        assert process.communicate(timeout=WATCHDOG_S)[0] == "7\n"
    finally:
        process.kill()
        process.wait()
