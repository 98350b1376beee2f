# SPDX-License-Identifier: Apache-2.0
"""Attached processes: those that only read change nothing, those that end remove nothing, and a name that is unlinked
and made anew is another store.  Tier: test."""

from __future__ import annotations

import ctypes
import hashlib
import mmap
import os
import signal
import subprocess
import sys
import textwrap
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

import shmtf
from shmtf import Store, Transform

from .conftest import SMALL, WATCHDOG_S, path_of

# ---- read-only ----


def digest(name: str) -> str:
    with open(path_of(name), "rb") as file:
        return hashlib.sha256(file.read()).hexdigest()


READS = """
    import os, sys, threading, shmtf
    store = shmtf.Store.attach(sys.argv[1], readonly=True)
    def all_reads():
        frames = store.frames()
        for target in [*frames, "nobody"]:
            for source in [*frames, "nobody", ""]:
                for read in (
                    lambda: store.lookup_latest_transform(target, source).edges,
                    lambda: store.lookup_transform(target, source),
                    lambda: [store.lookup_transform(target, source, t) for t in (0, 55, 60, 10**9)],
                    lambda: store.lookup_transform(target, source, 10**9, timeout=0.001),
                    lambda: store.can_transform(target, source, timeout=0.001),
                    lambda: store.explain(target, source),
                    lambda: store.latest_common_time(target, source),
                    lambda: store.chain(target, source),
                    lambda: store.frame_info(source), lambda: store.parent(source), lambda: store.children(source),
                    lambda: store._records(source), lambda: store._frame_words(source),
                    lambda: store.wait_for_change(source, timeout=0.001),
                    lambda: store.set_transform(shmtf.Transform(target, source, 70)),
                    lambda: store.set_transforms([shmtf.Transform(target, source, 70)]),
                    lambda: store.remove_frame(source), store.clear,
                    lambda: store.declare_frame(source, history=4),
                ):
                    try:
                        read()
                    except (shmtf.TransformException, shmtf.StoreError):
                        pass
        with store.snapshot() as snap:
            snap.frames(), snap.all_frames_as_yaml(), snap.all_frames_as_dot(), store.all_frames_as_yaml()
        store._check(), store._writers(), store._info(), store.counters(), store.version
        try:
            store._check(True)
        except shmtf.ReadOnlyStoreError:
            pass
    threads = [threading.Thread(target=all_reads) for _ in range(3)]
    [t.start() for t in threads]
    [t.join() for t in threads]
    if os.fork() == 0:
        all_reads()
        os._exit(0)
    assert os.wait()[1] == 0
    store.close()
"""


def test_a_reader_changes_no_bit(store: Store, python: Callable, program: Callable[[str], Path]) -> None:
    """Every call there is, beside frames that a dead writer left locked, before and after its commit."""
    with Store.create(store.name + "-w", max_frames=16, history=14, cache_time=None, stream_bytes=1 << 14) as world:
        try:
            for i in range(1, 6):
                world.set_transforms([Transform("root", f, 10 * i, (i, 0, 0)) for f in "abc"])
            world.set_transform(Transform("c", "tool"), static=True)
            world.remove_frame("tool")
            for value, step in ((6, "staged-all"), (7, "committed")):
                kill = [program("failpoint_writer"), world.name, "update", str(value), "--at", step]
                assert subprocess.run(kill, check=False, timeout=WATCHDOG_S).returncode == -signal.SIGKILL
                assert world._frame_words("c")["locked"]
                before = digest(world.name)
                python(READS, world.name)
                assert digest(world.name) == before
        finally:
            Store.unlink(world.name)


def test_a_mapping_cannot_be_made_writable(store: Store) -> None:
    with Store.attach(store.name, readonly=True) as reader:
        store.close()
        with open("/proc/self/maps") as maps:
            lines = [line.split() for line in maps if line.rstrip().endswith(path_of(store.name))]
        assert [line[1] for line in lines] == ["r--s"]
        start, end = (int(part, 16) for part in lines[0][0].split("-"))
        libc = ctypes.CDLL(None, use_errno=True)
        for protection in (mmap.PROT_WRITE, mmap.PROT_READ | mmap.PROT_WRITE):
            assert libc.mprotect(ctypes.c_void_p(start), ctypes.c_size_t(end - start), protection) == -1
            assert ctypes.get_errno() == 13
        for fd in os.listdir("/proc/self/fd"):
            try:
                if os.readlink(f"/proc/self/fd/{fd}") == path_of(store.name):
                    with pytest.raises(OSError):
                        os.write(int(fd), b"x")
            except FileNotFoundError:
                pass
        assert reader.frames() == []


# ---- processes that end ----

ENDINGS = {
    "returns": "",
    "exit": "sys.exit(3)",
    "_exit": "os._exit(3)",
    "exception": "raise ValueError",
    "killed": "os.kill(os.getpid(), 9)",
    "terminated": "os.kill(os.getpid(), 15)",
    "closed": "store.close()",
    "deleted": "del store",
    "thread": "import threading; threading.Thread(target=store.wait_for_change, daemon=True).start()",
    "tracker": """
from multiprocessing import resource_tracker, shared_memory
import multiprocessing
other = shared_memory.SharedMemory(create=True, size=4096)  # brings the tracker to life
multiprocessing.get_context("spawn").Process(target=print).start()
other.close(); other.unlink()
""",
}


@pytest.mark.parametrize(
    ("ending", "flags"),
    [(e, ()) for e in ENDINGS] + [(e, ("-X", "dev")) for e in ("returns", "exception", "deleted", "tracker")],
)
def test_ending_removes_nothing(store: Store, ending: str, flags: tuple[str, ...]) -> None:
    store.set_transform(Transform("map", "a", 1))
    before = os.stat(path_of(store.name)).st_ino
    code = f"""
import os, sys, shmtf
if __name__ == "__main__":
    store = shmtf.Store.attach(sys.argv[1])
    store.set_transform(shmtf.Transform("map", "b", 1))
    reader = shmtf.Store.attach(sys.argv[1], readonly=True)
{textwrap.indent(ENDINGS[ending], "    ")}
"""
    command = [sys.executable, *flags, "-W", "error::ResourceWarning", "-c", code, store.name]
    done = subprocess.run(command, check=False, capture_output=True, text=True, cwd="/", timeout=WATCHDOG_S)
    assert "shared_memory" not in done.stderr and "leaked" not in done.stderr, done.stderr
    assert os.stat(path_of(store.name)).st_ino == before
    assert store.name in shmtf.list_stores()
    assert store.lookup_latest_transform("map", "b").stamp == 1
    store.set_transforms([Transform("map", "a", 2), Transform("map", "b", 2)], timeout=0.0)
    assert [w["alive"] for w in store._writers() if w["pid"] != os.getpid()] == [False]


# ---- unlink and make anew ----


def test_the_old_and_the_new_store_of_a_name(store_name: str) -> None:
    """Who was there keeps the old one, who comes gets the new one, and no waiter is woken by the other."""
    with Store.create(store_name, **SMALL) as old, Store.attach(store_name, readonly=True) as old_reader:
        old.set_transform(Transform("map", "a", 1))
        answers: list[int] = []
        waiter = threading.Thread(
            target=lambda: answers.append(old_reader.lookup_transform("map", "b", timeout=None).stamp)
        )
        waiter.start()
        while not old_reader.counters()["waits"]:
            pass
        Store.unlink(store_name)
        with Store.create(store_name, **SMALL) as new, Store.attach(store_name) as also_new:
            assert new._info()["uuid"] != old._info()["uuid"]
            assert also_new._info()["uuid"] == new._info()["uuid"]
            new.set_transforms([Transform("map", "b", 5), Transform("map", "c", 5)])
            assert sorted(also_new.frames()) == ["b", "c", "map"]
            assert sorted(old.frames()) == ["a", "map"]
            info = shmtf.store_info(store_name)
            assert (info.version, info.n_frames) == (1, 3)
            assert shmtf.list_stores().count(store_name) == 1
            assert waiter.is_alive() and not answers
            old.set_transform(Transform("map", "b", 9))
            waiter.join()
            assert answers == [9]
            assert new.lookup_latest_transform("map", "b").stamp == 5
            pid = os.fork()
            if pid == 0:  # it attaches to what its parent had, not to what has the name now
                os._exit(0 if sorted(old.frames()) == ["a", "b", "map"] else 1)
            assert os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) == 0
            dump = subprocess.run(
                [sys.executable, "-m", "shmtf.cli", "dump", store_name, "--json"],
                check=True, capture_output=True, text=True, cwd="/", timeout=WATCHDOG_S,
            )  # fmt: skip
            assert '"c"' in dump.stdout and '"a"' not in dump.stdout


def test_many_times_over(store_name: str, python: Callable) -> None:
    """A process makes and unlinks the name without end; whoever attaches meets a whole store or none."""
    code = f"""
        import sys, shmtf
        print("ready", flush=True)
        while True:
            with shmtf.Store.create(sys.argv[1], exist_ok=True, **{SMALL!r}) as store:
                store.set_transforms([shmtf.Transform("map", f, 1) for f in "ab"])
                shmtf.Store.unlink(sys.argv[1])
    """
    maker = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(code), store_name], stdout=subprocess.PIPE, text=True, cwd="/"
    )
    try:
        assert maker.stdout is not None and maker.stdout.readline()
        met = 0
        while met < 50:
            try:
                with Store.attach(store_name) as store:
                    assert sorted(store.frames()) in ([], ["a", "b", "map"])
                    met += 1
            except shmtf.StoreNotFoundError:
                pass
    finally:
        maker.kill()
        maker.wait()
