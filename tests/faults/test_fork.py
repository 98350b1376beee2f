# SPDX-License-Identifier: Apache-2.0
"""fork without exec, fork in the middle of a write, closed and replaced descriptors, exec, daemons.  Tier: test."""

from __future__ import annotations

import multiprocessing
import operator
import os
from collections.abc import Callable
from pathlib import Path

import pytest

from shmtf import Store, Transform

from .conftest import WATCHDOG_S


@pytest.mark.parametrize("method", ["fork", "forkserver", "spawn"])
@pytest.mark.parametrize("readonly", [False, True])
def test_multiprocessing(store: Store, method: str, readonly: bool) -> None:
    store.set_transform(Transform("map", "x", 7))
    with Store.attach(store.name, readonly=readonly) as given, multiprocessing.get_context(method).Pool(2) as pool:
        look = operator.methodcaller("lookup_latest_transform", "map", "x")
        answers = pool.map_async(look, [given] * 8).get(timeout=WATCHDOG_S)
        assert [a.stamp for a in answers] == [7] * 8
        if not readonly:
            write = operator.methodcaller("set_transform", Transform("map", "y", 1))
            assert all(pool.map_async(write, [given] * 4).get(timeout=WATCHDOG_S))
    assert store.lookup_latest_transform("map", "x").stamp == 7


def test_in_the_middle_of_a_write(python: Callable, store_name: str) -> None:
    """Threads write all the time while the main thread forks; the children write the same frames, and die or end."""
    code = """
        import os, signal, sys, threading, traceback, shmtf
        T = shmtf.Transform
        store = shmtf.Store.create(sys.argv[1], max_frames=32, history=64, cache_time=None)
        stamp = [0]
        def pair(k, side=""):
            return [T("map", f"a{side}", k, (k, 0, 0)), T("map", f"b{side}", k, (-k, 0, 0))]
        over = threading.Event()
        def write(side):
            k = 0
            while not over.is_set():
                k += 1
                store.set_transforms(pair(k, side), timeout=None)
        store.set_transforms(pair(0) + pair(0, "0") + pair(0, "1"))
        threads = [threading.Thread(target=write, args=(str(i),), daemon=True) for i in range(2)]
        for t in threads:
            t.start()
        def child(n):
            mine = {w["slot"] for w in store._writers() if w["alive"]}
            for k in range(1, 30):
                side = ("", "0", "1")[k % 3]
                store.set_transforms(pair(2**40 + n * 100 + k, side), timeout=None)
                try:
                    with store.snapshot() as snap:
                        for s in ("", "0", "1"):
                            x = [snap.lookup_latest_transform("map", f + s).translation[0] for f in "ab"]
                            assert x[0] + x[1] == 0, x
                except shmtf.SnapshotExpiredError:  # the parent has written on
                    pass
            own = [w for w in store._writers() if w["alive"] and w["pid"] == os.getpid()]
            assert len(own) == 1, own
            if n % 3 == 0:
                os.kill(os.getpid(), signal.SIGKILL)
            if n % 3 == 1:
                store.close()
        for n in range(30):
            pid = os.fork()
            if pid == 0:
                code = 1
                try:
                    child(n)
                    code = 0
                except BaseException:
                    traceback.print_exc()
                finally:
                    os._exit(code)
            code = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
            assert code == (-9 if n % 3 == 0 else 0), (n, code)
        over.set()
        for t in threads:
            t.join()
        store.set_transforms(pair(2**50) + pair(2**50, "0") + pair(2**50, "1"), timeout=0.0)
        report = store._check()
        assert not report["corrupt"] and report["locks_held"] == 0, report
        alive = [w["pid"] for w in store._writers() if w["alive"]]
        assert alive and set(alive) == {os.getpid()}, alive
        print("whole")
    """
    assert python(code, store_name) == "whole\n"


def test_grandchildren_and_daemons(python: Callable, store_name: str) -> None:
    """The double fork of a daemon: the middle one ends at once, the last one closes everything and works."""
    code = """
        import os, sys, shmtf
        T = shmtf.Transform
        store = shmtf.Store.create(sys.argv[1], max_frames=16, history=8)
        store.set_transform(T("map", "a", 1))
        if os.fork() == 0:
            os.setsid()
            if os.fork():
                os._exit(0)
            os.chdir("/")
            null = os.open("/dev/null", os.O_RDWR)
            for fd in range(3):
                os.dup2(null, fd)
            try:
                store.set_transform(T("map", "daemon", store.lookup_latest_transform("map", "a").stamp))
                os.closerange(3, 1024)
                store.set_transform(T("map", "daemon", 2))
                assert store.lookup_latest_transform("map", "daemon").stamp == 2
                store.set_transform(T("map", "done", 1))
            except BaseException:
                os._exit(1)
            os._exit(0)
        os.wait()
        print(store.lookup_transform("map", "done", 1, timeout=None).stamp)
    """
    assert python(code, store_name) == "1\n"


DESCRIPTORS = """
    import os, resource, sys, shmtf
    T = shmtf.Transform
    how = sys.argv[2]
    store = shmtf.Store.create(sys.argv[1], max_frames=16, history=8)
    store.set_transform(T("map", "a", 1))
    foreign = os.open("/dev/null", os.O_RDWR)
    if how == "closerange":
        os.closerange(3, 1024)
    else:
        for fd in range(3, 64):
            if fd != foreign:
                os.dup2(foreign, fd)
    store.set_transform(T("map", "a", 2))
    assert store.lookup_latest_transform("map", "a").stamp == 2
    assert store.wait_for_change("a", since=0) > 0
    with shmtf.Store.attach(sys.argv[1]) as other:  # the slot of the first is held, whatever became of its descriptors
        other.set_transform(T("map", "b", 1))
        writers = other._writers()
        assert [w["alive"] for w in writers] == [True, True], writers
    pid = os.fork()
    if pid == 0:
        try:
            store.frames()
        except shmtf.ClosedError as error:  # it has nothing left to attach by
            os._exit(7)
        os._exit(0)
    print(os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]))
    for fd in range(3, 64) if how == "dup2" else ():
        os.dup2(sys.stdin.fileno(), fd)
    store.close()
    for fd in range(3, 64) if how == "dup2" else ():
        os.fstat(fd)  # a number that is somebody else's by now
"""


@pytest.mark.parametrize("how", ["closerange", "dup2"])
def test_descriptors_taken_away(python: Callable, store_name: str, how: str) -> None:
    """What is mapped works on; a forked child says that it cannot; no descriptor of somebody else is closed."""
    assert python(DESCRIPTORS, store_name, how) == "7\n"


def test_a_stolen_descriptor_is_nobodys_death(python: Callable, store_name: str) -> None:
    """Asked about a holder through a descriptor of something else, the answer is "alive"."""
    code = """
        import os, sys, shmtf
        T = shmtf.Transform
        store = shmtf.Store.create(sys.argv[1], max_frames=16, history=8)
        store.set_transform(T("map", "a", 1))
        other = shmtf.Store.attach(sys.argv[1])
        other.set_transform(T("map", "b", 1))
        null = os.open("/dev/null", os.O_RDWR)
        for fd in range(3, 64):
            if fd != null:
                os.dup2(null, fd)
        print([w["alive"] for w in store._writers() if w["pid"] == os.getpid()])
    """
    assert python(code, store_name) == "[True, True]\n"


def test_exec_gives_the_slot_back(python: Callable, store: Store) -> None:
    code = """
        import os, sys, shmtf
        store = shmtf.Store.attach(sys.argv[1], authority="before exec")
        store.set_transform(shmtf.Transform("map", "a", 1))
        lines = (
            "import sys, shmtf",
            "store = shmtf.Store.attach(sys.argv[1])",
            "print([w['alive'] for w in store._writers() if w['name'] == 'before exec'])",
            "store.set_transform(shmtf.Transform('map', 'a', 2))",
        )
        os.execv(sys.executable, [sys.executable, "-c", "; ".join(lines), sys.argv[1]])
    """
    assert python(code, store.name) == "[False]\n"
    assert store.lookup_latest_transform("map", "a").stamp == 2


def test_thousands_of_attachments(program: Callable[[str], Path], store: Store) -> None:
    import subprocess

    before = set(os.listdir("/dev/shm"))
    command = [program("cycles"), store.name, "2000", "200"]
    done = subprocess.run(command, check=True, capture_output=True, text=True, timeout=WATCHDOG_S)
    assert done.stdout == "descriptors 0 mappings 0 slots 0 locks 0\n", done.stderr
    uuid = store._info()["uuid"]
    left = {n for n in set(os.listdir("/dev/shm")) - before if store.name in n or uuid in n}
    assert left <= {f".shmtf-bell-{uuid}"}
