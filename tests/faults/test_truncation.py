# SPDX-License-Identifier: Apache-2.0
"""Somebody truncates the file of a live store, or punches holes into it: typed errors, never a signal.  Tier: test."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import textwrap
from collections.abc import Callable

import pytest

import shmtf
from shmtf import Store, Transform

from .conftest import SMALL, WATCHDOG_S, path_of

EVERY_CALL = """
    import faulthandler, os, sys, threading, shmtf
    name, other, bytes_left, readonly, late = sys.argv[1:]
    bytes_left, readonly = int(bytes_left), readonly == "True"
    T = shmtf.Transform
    with shmtf.Store.create(name, max_frames=16, history=8) as made:
        made.set_transforms([T("map", "a", t, (t, 0, 0)) for t in (1, 2)])
    neighbour = shmtf.Store.create(other, max_frames=16, history=8)
    neighbour.set_transform(T("map", "a", 1))
    stores = [shmtf.Store.attach(name, readonly=readonly) for _ in range(30)]
    if late == "late":
        faulthandler.enable()
    for store in stores:
        assert store.lookup_latest_transform("map", "a").translation[0] == 2
    snapshots = [store.snapshot() for store in stores]
    os.truncate("/dev/shm/" + name, bytes_left)
    calls = [
        lambda s, n: s.lookup_latest_transform("map", "a"),
        lambda s, n: s.lookup_transform("map", "a", 1),
        lambda s, n: s.lookup_transform("map", "a", 9, timeout=None),
        lambda s, n: s.can_transform("map", "a", timeout=None),
        lambda s, n: s.explain("map", "a"),
        lambda s, n: s.latest_common_time("map", "a"),
        lambda s, n: s.frames(),
        lambda s, n: s.frame_exists("a"),
        lambda s, n: s.frame_info("a"),
        lambda s, n: s.parent("a"),
        lambda s, n: s.children("map"),
        lambda s, n: s.chain("map", "a"),
        lambda s, n: s.all_frames_as_yaml(),
        lambda s, n: s.all_frames_as_dot(),
        lambda s, n: s.version,
        lambda s, n: s.wait_for_change(),
        lambda s, n: s.wait_for_change("a", since=1),
        lambda s, n: s._info(),
        lambda s, n: s._writers(),
        lambda s, n: s._records("a"),
        lambda s, n: s._frame_words("a"),
        lambda s, n: n.frames(),
        lambda s, n: n.lookup_latest_transform("map", "a"),
    ]
    writes = [
        lambda s, n: s.set_transform(T("map", "a", 3)),
        lambda s, n: s.set_transforms([T("map", "b", 3), T("map", "a", 3)]),
        lambda s, n: s.declare_frame("d", history=3),
        lambda s, n: s.remove_frame("a"),
        lambda s, n: s.clear(),
    ]
    def expect_corrupt(call, store, snapshot):
        try:
            answer = call(store, snapshot)
        except shmtf.StoreCorruptError as error:
            assert "cut short" in str(error), error
        else:
            raise AssertionError(f"{calls.index(call)} answered {answer!r}")
    for i, call in enumerate(calls + ([] if readonly else writes)):  # each is the first to find out, in its handle
        if bytes_left:  # what is still there is still right, until somebody looks at the rest
            expect_corrupt(calls[0], stores[i], snapshots[i])
        expect_corrupt(call, stores[i], snapshots[i])
        for again in calls:
            expect_corrupt(again, stores[i], snapshots[i])
        report = stores[i]._check()
        assert report["corrupt"] and "cut short" in report["first_problem"], report
        stores[i].close()
        stores[i].close()
    neighbour.set_transform(T("map", "a", 2))
    assert neighbour.lookup_latest_transform("map", "a").stamp == 2
    try:
        shmtf.Store.attach(name)
    except (shmtf.StoreVersionError, shmtf.StoreCorruptError):
        print("survived")
"""


@pytest.mark.parametrize("readonly", [False, True])
@pytest.mark.parametrize(("flags", "late"), [((), "no"), (("-X", "faulthandler"), "no"), ((), "late")])
@pytest.mark.parametrize("left", [0, 4096 * 9])
def test_every_call(
    python: Callable, new_name: Callable[[], str], readonly: bool, flags: tuple[str, ...], late: str, left: int
) -> None:
    assert python(EVERY_CALL, new_name(), new_name(), left, readonly, late, flags=flags) == "survived\n"


def test_threads_in_the_middle(python: Callable, store_name: str) -> None:
    """Readers, writers and waiters of one handle; a transform that is found is a right one."""
    code = """
        import os, sys, threading, shmtf
        name = sys.argv[1]
        store = shmtf.Store.create(name, max_frames=16, history=8)
        T, ends = shmtf.Transform, []
        store.set_transforms([T("map", "a", 1, (1, 0, 0)), T("a", "b", 1, (-1, 0, 0))])
        def until_corrupt(step):
            i = 1
            while True:
                i += 1
                try:
                    step(i)
                except shmtf.StoreCorruptError:
                    ends.append(1)
                    return
                except shmtf.SnapshotExpiredError:
                    pass
        def read(i):
            found = store.lookup_latest_transform("map", "b").translation[0]
            assert found == 0, found
        def write(i):
            store.set_transforms([T("map", "a", i, (i, 0, 0)), T("a", "b", i, (-i, 0, 0))])
        def wait(i):
            store.lookup_transform("map", "b", 2**60, timeout=None)
        def watch(i):
            store.wait_for_change("nobody")
        def show(i):
            store.all_frames_as_yaml(), store.frames()
        steps = read, read, write, wait, watch, show
        threads = [threading.Thread(target=until_corrupt, args=(f,), daemon=True) for f in steps]
        for t in threads:
            t.start()
        while store.version < 300 or store.counters()["waits"] < 2:
            pass
        os.truncate("/dev/shm/" + name, 0)
        for t in threads:
            t.join()
        store.close()
        print(len(ends))
    """
    assert python(code, store_name) == "6\n"


def test_a_foreign_bus_error_is_faulthandlers(store_name: str) -> None:
    code = """
        import mmap, os, sys, tempfile, shmtf
        store = shmtf.Store.create(sys.argv[1], max_frames=16, history=8)
        file = tempfile.TemporaryFile()
        file.truncate(4096)
        page = mmap.mmap(file.fileno(), 4096)
        file.truncate(0)
        page[0]
    """
    done = subprocess.run(
        [sys.executable, "-X", "faulthandler", "-c", textwrap.dedent(code), store_name],
        check=False, capture_output=True, text=True, cwd="/", timeout=WATCHDOG_S,
    )  # fmt: skip
    assert done.returncode == -signal.SIGBUS
    assert "Bus error" in done.stderr


def test_inherited_over_fork(python: Callable, store_name: str) -> None:
    code = """
        import os, sys, shmtf
        store = shmtf.Store.create(sys.argv[1], max_frames=16, history=8)
        store.set_transform(shmtf.Transform("map", "a", 1))
        pid = os.fork()
        if pid == 0:
            store.lookup_latest_transform("map", "a")
            os.truncate("/dev/shm/" + sys.argv[1], 0)
            try:
                store.lookup_latest_transform("map", "a")
            except shmtf.StoreCorruptError:
                os._exit(7)
            os._exit(1)
        assert os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) == 7
        try:
            store.set_transform(shmtf.Transform("map", "a", 2))
        except shmtf.StoreCorruptError:
            print("both")
    """
    assert python(code, store_name) == "both\n"


def bells() -> set[str]:
    return {name for name in os.listdir("/dev/shm") if name.startswith(".shmtf-bell-")}


def test_the_bell_goes_with_the_last_who_knows_its_name(store_name: str) -> None:
    with Store.create(store_name, **SMALL) as store:
        store.set_transform(Transform("map", "a", 1))
        bell = f".shmtf-bell-{store._info()['uuid']}"
        assert bell in bells()
        os.truncate(path_of(store_name), 0)
        with pytest.raises(shmtf.StoreCorruptError):
            store.frames()
    assert bell not in bells()


@pytest.mark.parametrize("part", ["header", "frames", "all"])
def test_holes_are_no_crash(store_name: str, python: Callable, part: str) -> None:
    """Zeros where there were words: an answer or a typed error, and a check that finds an end."""
    code = """
        import ctypes, os, sys, shmtf
        name, part = sys.argv[1:]
        T = shmtf.Transform
        store = shmtf.Store.create(name, max_frames=16, history=8)
        store.set_transforms([T("map", "a", t) for t in (1, 2)])
        size = os.stat("/dev/shm/" + name).st_size
        at, n = {"header": (0, 4096), "frames": (9 * 4096, size - 9 * 4096), "all": (0, size)}[part]
        bell = f"/dev/shm/.shmtf-bell-{store._info()['uuid']}"
        fd = os.open("/dev/shm/" + name, os.O_RDWR)
        libc = ctypes.CDLL(None, use_errno=True)
        PUNCH, KEEP = 2, 1
        assert libc.fallocate(fd, PUNCH | KEEP, ctypes.c_long(at), ctypes.c_long(n)) == 0, ctypes.get_errno()
        for call in (
            lambda: store.lookup_latest_transform("map", "a"), lambda: store.lookup_transform("map", "a", 1),
            store.frames, store.all_frames_as_yaml, store._check, store._writers,
            lambda: store.wait_for_change(since=0, timeout=0),
            lambda: store.set_transform(T("map", "a", 3), timeout=0.01),
            lambda: store.set_transform(T("map", "c", 3), timeout=0.01),
            lambda: store.clear(timeout=0.01),
        ):
            try:
                call()
            except (shmtf.StoreError, shmtf.TransformException) as error:
                str(error)
        store.close()
        os.unlink(bell)  # whose name the header told
        try:
            shmtf.Store.attach(name).close()
        except shmtf.StoreError as error:
            print(type(error).__name__)
    """
    assert (python(code, store_name, part) == "") == (part == "frames")


def test_watching_it_from_a_shell(store_name: str) -> None:
    """An `echo` that is running and a `check` end with a message, not a signal."""
    with Store.create(store_name, **SMALL) as store:
        store.set_transform(Transform("map", "a", 1))
        watching = subprocess.Popen(
            [sys.executable, "-m", "shmtf.cli", "echo", "map", "a", "--store", store_name, "--rate", "100"],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd="/",
        )  # fmt: skip
        try:
            assert watching.stdout is not None
            for _ in range(3):
                assert watching.stdout.readline()
            os.truncate(path_of(store_name), 0)
            _, err = watching.communicate(timeout=WATCHDOG_S)
            assert watching.returncode > 0
            with pytest.raises(shmtf.StoreCorruptError):
                store.frames()
            assert "Traceback" not in err and "cut short" in err, err
        finally:
            watching.kill()
            watching.wait()
    check = [sys.executable, "-m", "shmtf.cli", "check", store_name]
    assert subprocess.run(check, check=False, capture_output=True, cwd="/", timeout=WATCHDOG_S).returncode > 0
