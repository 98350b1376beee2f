# SPDX-License-Identifier: Apache-2.0
"""Shared memory is full: creating is refused and leaves nothing, what exists works on.  Tier: test."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from textwrap import dedent

import pytest

from .conftest import WATCHDOG_S


@pytest.fixture
def small_shm(unshare: Callable[..., list[str]]) -> list[str]:
    """The command under which another file system may be mounted over /dev/shm."""
    namespace = unshare("--mount")
    mount = [*namespace, "mount", "-t", "tmpfs", "tmpfs", "/dev/shm"]
    if subprocess.run(mount, check=False, capture_output=True, timeout=WATCHDOG_S).returncode:
        pytest.skip("mounting is refused here")
    return namespace


PRELUDE = """
    import errno, os, subprocess, sys, threading, shmtf
    def size(n):
        subprocess.run(["mount", "-o", f"remount,size={n}", "/dev/shm"], check=True)
    subprocess.run(["mount", "-t", "tmpfs", "-o", "size=1m", "tmpfs", "/dev/shm"], check=True)
    SMALL = dict(max_frames=16, history=8, stream_bytes=1 << 12)
    T = shmtf.Transform
    def free():
        s = os.statvfs("/dev/shm")
        return s.f_bavail * s.f_frsize
    def fill():
        with open("/dev/shm/filler", "ab", buffering=0) as file:
            try:
                while True:
                    file.write(bytes(4096))
            except OSError as error:
                assert error.errno == errno.ENOSPC
"""


def test_around_the_edge(python: Callable, small_shm: list[str]) -> None:
    code = """
        whole = shmtf.Store.create("probe", **SMALL)
        need = (os.stat("/dev/shm/probe").st_size + 4095) & ~4095
        whole.close()
        shmtf.Store.unlink("probe")
        made = refused = 0
        for pages in range(-6, 7):
            size(need + pages * 4096)
            before = free()
            for _ in range(2):
                try:
                    with shmtf.Store.create("edge", **SMALL) as store:
                        store.set_transform(T("map", "a", 1))
                        assert store.lookup_latest_transform("map", "a").stamp == 1
                        try:
                            store.wait_for_change(timeout=0.001)
                        except shmtf.TimeoutException:
                            pass
                    shmtf.Store.unlink("edge")
                    made += 1
                except shmtf.StoreFullError as error:
                    assert error.needed and error.sys_errno == errno.ENOSPC, error
                    refused += 1
                assert os.listdir("/dev/shm") == [], (pages, os.listdir("/dev/shm"))
                assert free() == before, (pages, before, free())
        print(made > 0, refused > 0)
    """
    assert python(dedent(PRELUDE) + dedent(code), before=small_shm) == "True True\n"


def test_existing_stores_work_on(python: Callable, small_shm: list[str]) -> None:
    """Without a page for the bell, writers do not mind and waiters look by themselves; later the bell is made."""
    code = """
        store = shmtf.Store.create("one", **SMALL)
        reader = shmtf.Store.attach("one", readonly=True)
        fill()
        assert free() == 0
        for i in range(1, 200):
            store.set_transforms([T("map", f"f{i % 9}", i), T("map", "a", i)])
        assert not [name for name in os.listdir("/dev/shm") if "bell" in name]
        assert reader.lookup_latest_transform("map", "a").stamp == 199
        def wait():
            reader.lookup_transform("map", "later", timeout=None)
        waiting = threading.Thread(target=wait, daemon=True)
        waiting.start()
        while not reader.counters()["waits"]:
            pass
        store.set_transform(T("map", "later", 1))
        waiting.join()
        try:
            shmtf.Store.create("two", **SMALL)
        except shmtf.StoreFullError as error:
            print("full", error.sys_errno == errno.ENOSPC)
        os.unlink("/dev/shm/filler")
        i = 200
        while not [name for name in os.listdir("/dev/shm") if "bell" in name]:
            i += 1
            store.set_transform(T("map", "a", i))
        shmtf.Store.unlink("one")
        print(os.listdir("/dev/shm"))
    """
    assert python(dedent(PRELUDE) + dedent(code), before=small_shm) == "full True\n[]\n"


def test_a_hole_in_a_full_shm(python: Callable, small_shm: list[str]) -> None:
    """Somebody gave a store's memory away, and now there is none: an error, not a signal."""
    code = """
        import ctypes
        store = shmtf.Store.create("one", **SMALL)
        store.set_transforms([T("map", "a", i) for i in (1, 2)])
        length = os.stat("/dev/shm/one").st_size
        fd = os.open("/dev/shm/one", os.O_RDWR)
        assert ctypes.CDLL(None).fallocate(fd, 3, ctypes.c_long(0), ctypes.c_long(length)) == 0
        fill()
        for call in (
            lambda: store.set_transform(T("map", "a", 3)),
            lambda: store.lookup_latest_transform("map", "a"),
            store.frames,
        ):
            try:
                call()
            except shmtf.StoreCorruptError as error:
                print("corrupt")
    """
    assert python(dedent(PRELUDE) + dedent(code), before=small_shm) == "corrupt\n" * 3
