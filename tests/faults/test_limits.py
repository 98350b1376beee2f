# SPDX-License-Identifier: Apache-2.0
"""Limits of a process, and system calls that fail: typed errors, nothing left, and the next attempt succeeds.
Tier: test.  The same for the C library, call by call: tests/native/syscalls.c."""

from __future__ import annotations

from collections.abc import Callable
from textwrap import dedent

import pytest

EVERY_CALL = """
    import ctypes, errno, gc, os, sys, shmtf
    name = sys.argv[1]
    shim = ctypes.CDLL(None)
    SMALL = dict(max_frames=8, history=6, stream_bytes=0)
    T = shmtf.Transform
    def stock():
        gc.collect(0)
        with open("/proc/self/maps") as maps:
            mapped = sum(name in line for line in maps)
        names = sorted(n for n in os.listdir("/dev/shm") if name in n or n.startswith(".shmtf-new"))
        return len(os.listdir("/proc/self/fd")), mapped, names
    def wait(store):
        try:
            store.wait_for_change(timeout=0.002)
        except shmtf.TimeoutException:
            pass
    def attach_and_close(store):
        with shmtf.Store.attach(name, readonly=True) as reader:
            reader.frames()
    steps = {
        "create": lambda store: shmtf.Store.create(name, **SMALL),
        "attach": attach_and_close,
        "write": lambda store: store.set_transform(T("map", "a", 1)),
        "wait": wait,
        "list": lambda store: (store.frames(), store._writers()),
        "close": lambda store: store.close(),
        "unlink": lambda store: shmtf.Store.unlink(name),
    }
    def live(tested, n, error):
        before, store, failed = stock(), None, False
        bell = None
        for step, run in steps.items():
            if step == tested:
                shim.fail_arm(ctypes.c_long(n), error)
                try:
                    made = run(store)
                    wrong = None
                except (shmtf.StoreError, shmtf.TransformException, MemoryError, OSError) as problem:
                    wrong = problem
                finally:
                    failed = bool(shim.fail_disarm())
                if wrong is not None:
                    typed = isinstance(wrong, (shmtf.StoreError, MemoryError))
                    assert typed and not isinstance(wrong, shmtf.StoreCorruptError), (step, n, error, repr(wrong))
                    assert str(wrong) or isinstance(wrong, MemoryError)
                    wrong.__traceback__ = None
                    if step == "create" and os.path.exists("/dev/shm/" + name):
                        made = shmtf.Store.attach(name)  # it was made, and then could not be attached
                    else:
                        made = run(store)
                    wrong = None
            else:
                made = run(store)
            if step == "create":
                store = made
                bell = f"/dev/shm/.shmtf-bell-{store._info()['uuid']}"
            made = None
        if bell and os.path.exists(bell):
            os.unlink(bell)
            assert tested == "unlink" and error == errno.EACCES, (tested, n, error, "a bell is left")
        store = None
        after = stock()
        assert after == before, (tested, n, error, before, after)
        return failed
    live("", 0, 0)
    n_calls = 0
    for step in steps:
        for n in range(200):
            hit = [live(step, n, error) for error in (errno.ENOMEM, errno.EMFILE, errno.EACCES)]
            if not any(hit):
                break
            n_calls += 1
    print(n_calls > 40)
"""


def test_every_system_call_fails(python: Callable, preload: Callable[[str], str], store_name: str) -> None:
    assert python(EVERY_CALL, store_name, LD_PRELOAD=preload("fail_nth.c")) == "True\n"


PRELUDE = """
    import errno, os, resource, sys, shmtf
    name = sys.argv[1]
    T = shmtf.Transform
    store = shmtf.Store.create(name, max_frames=16, history=8)
    store.set_transform(T("map", "a", 1))
    shmtf.list_stores()
    def limit(which, soft):
        resource.setrlimit(which, (soft, resource.getrlimit(which)[1]))
"""


@pytest.fixture
def limited(python: Callable, store_name: str) -> Callable[[str], str]:
    return lambda code: python(dedent(PRELUDE) + dedent(code), store_name)


@pytest.mark.parametrize("free", range(6))
def test_no_free_descriptor(limited: Callable[[str], str], free: int) -> None:
    code = f"""
        soft = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
        before = len(os.listdir("/proc/self/fd"))
        limit(resource.RLIMIT_NOFILE, max(int(fd) for fd in os.listdir("/proc/self/fd")) + {free})
        results = set()
        for attempt in range(3):
            for call in (
                lambda: shmtf.Store.attach(name), lambda: shmtf.Store.attach(name, readonly=True),
                lambda: shmtf.Store.create(name + "-2", max_frames=16, history=8),
            ):
                try:
                    with call() as other:
                        other.set_transform(T("map", "b", 1)) if not other.readonly else other.frames()
                    results.add("done")
                except shmtf.StoreError as error:
                    assert type(error) in (shmtf.StoreError, shmtf.StoreExistsError), error
                    if type(error) is shmtf.StoreError:
                        assert error.sys_errno == errno.EMFILE or "Too many open files" in str(error), error
                    results.add("refused")
            store.set_transform(T("map", "a", 2 + attempt))  # what is attached needs none
            store.lookup_latest_transform("map", "a")
        limit(resource.RLIMIT_NOFILE, soft)
        assert len(os.listdir("/proc/self/fd")) == before
        try:
            shmtf.Store.unlink(name + "-2")
        except shmtf.StoreNotFoundError:
            pass
        with shmtf.Store.attach(name) as other:
            other.set_transform(T("map", "b", 1))
        print(sorted(results))
    """
    said = limited(code)
    assert "refused" in said if free < 2 else said


def test_no_address_space(limited: Callable[[str], str]) -> None:
    code = """
        with open("/proc/self/statm") as file:
            used = int(file.read().split()[0]) * 4096
        big = shmtf.Store.create(name + "-big", max_frames=16, history=8, stream_bytes=24 << 20)
        big.close()
        before = len(os.listdir("/proc/self/fd"))
        limit(resource.RLIMIT_AS, used + (8 << 20))
        for call in (
            lambda: shmtf.Store.attach(name + "-big"), lambda: shmtf.Store.attach(name + "-big", readonly=True),
            lambda: shmtf.Store.create(name + "-other", max_frames=16, history=8, stream_bytes=24 << 20),
        ):
            try:
                call()
            except shmtf.StoreError as error:
                assert error.sys_errno == errno.ENOMEM, error
            else:
                raise AssertionError("there was room")
        store.set_transform(T("map", "a", 2))
        assert not os.path.exists("/dev/shm/" + name + "-other")
        limit(resource.RLIMIT_AS, resource.RLIM_INFINITY)
        assert len(os.listdir("/proc/self/fd")) == before
        shmtf.Store.attach(name + "-big").close()
        shmtf.Store.unlink(name + "-big")
        print("room again")
    """
    assert limited(code) == "room again\n"


@pytest.mark.parametrize("which", ["MEMLOCK", "FSIZE", "STACK", "CORE", "SIGPENDING"])
def test_limits_that_do_not_matter_once_attached(limited: Callable[[str], str], which: str) -> None:
    """A file-size limit of 4 KiB has room for a bell, and a write through a mapping is no write to a file."""
    code = f"""
        limit(resource.RLIMIT_{which}, 4096)
        with shmtf.Store.attach(name) as other:
            other.set_transforms([T("map", f"f{{i}}", 1) for i in range(9)])
            try:
                other.wait_for_change(timeout=0.001)
            except shmtf.TimeoutException:
                print(len(other.frames()))
    """
    assert limited(code) == "11\n"
