# SPDX-License-Identifier: Apache-2.0
"""CLOCK_REALTIME is stepped: waits do not notice, stamps that go back are late data.  Tier: test.

The step is made by a preloaded clock_gettime(); everything else is real.
"""

from __future__ import annotations

from collections.abc import Callable
from textwrap import dedent

import pytest

PRELUDE = """
    import ctypes, sys, threading, time, shmtf
    T = shmtf.Transform
    step_by = ctypes.CDLL(None).clock_step
    def step(seconds):
        before = time.time()
        step_by(ctypes.c_longlong(int(seconds * 10**9)))
        assert abs(time.time() - before - seconds) < 60
    store = shmtf.Store.create(sys.argv[1], max_frames=16, history=32, cache_time=10.0)
    store.set_transform(T("map", "a", 1))
"""
DAY = 86400


@pytest.fixture
def stepped(python: Callable, preload: Callable[[str], str], store_name: str) -> Callable[[str], str]:
    library = preload("clock.c")
    return lambda code: python(dedent(PRELUDE) + dedent(code), store_name, LD_PRELOAD=library)


@pytest.mark.parametrize("seconds", [DAY, -DAY])
def test_a_step_does_not_end_a_wait(stepped: Callable[[str], str], seconds: int) -> None:
    """The wait of an hour is still there after the step, and gets its answer."""
    code = f"""
        answers = []
        waits = [
            lambda: answers.append(store.lookup_transform("map", "b", timeout=3600).stamp),
            lambda: answers.append(store.wait_for_change("b", timeout=3600) > 0),
            lambda: answers.append(store.can_transform("map", "b", timeout=3600)),
        ]
        threads = [threading.Thread(target=w, daemon=True) for w in waits]
        for t in threads:
            t.start()
        def asleep():
            before = store.counters()["waits"]
            while store.counters()["waits"] < before + 6:  # all of them have gone round once more
                pass
        asleep()
        step({seconds})
        asleep()
        assert answers == [] and all(t.is_alive() for t in threads)
        store.set_transform(T("map", "b", 7))
        for t in threads:
            t.join()
        print(sorted(map(int, answers)))
    """
    assert stepped(code) == "[1, 1, 7]\n"


@pytest.mark.parametrize("seconds", [DAY, -DAY])
def test_a_step_does_not_prolong_a_wait(stepped: Callable[[str], str], seconds: int) -> None:
    code = f"""
        ended = []
        def wait():
            start = time.monotonic()
            try:
                store.lookup_transform("map", "b", timeout=0.5)
            except shmtf.LookupTimeout as error:
                ended.append(0.5 <= error.waited and time.monotonic() - start >= 0.5)
            try:
                shmtf.Store.attach(sys.argv[1] + "-none", timeout=0.1)
            except shmtf.StoreNotFoundError as error:
                ended.append(error.waited >= 0.1)
        thread = threading.Thread(target=wait, daemon=True)
        thread.start()
        while not store.counters()["waits"]:
            pass
        step({seconds})
        thread.join()
        print(ended)
    """
    assert stepped(code) == "[True, True]\n"


def test_now_goes_back_a_little(stepped: Callable[[str], str]) -> None:
    """Within the cache time: put in order, the newest stays the newest."""
    code = """
        store.set_transform(T("map", "b", None, (1, 0, 0)))
        first = store.lookup_latest_transform("map", "b").stamp
        step(-2)
        store.set_transform(T("map", "b", None, (2, 0, 0)))
        assert store.lookup_latest_transform("map", "b").stamp == first
        stamps = [r["stamp"] for r in store._records("b")]
        assert len(stamps) == 2 and stamps[0] == first and 0 < first - stamps[1] < 3 * 10**9, stamps
        assert store.lookup_transform("map", "b", stamps[1]).translation[0] == 2
        print(store.lookup_transform("map", "b", first).translation[0])
    """
    assert stepped(code) == "1.0\n"


def test_now_goes_back_a_day(stepped: Callable[[str], str]) -> None:
    """Beyond the cache time: refused, until clear() begins anew."""
    code = """
        store.set_transforms([T("map", "b"), T("map", "c")])
        before = store.version
        step(-86400)
        try:
            store.set_transforms([T("map", "d"), T("map", "b")])
        except shmtf.OldDataError as error:
            assert error.item == 1 and error.newest - error.requested > 86000 * 10**9
            assert store.version == before and not store.frame_exists("d")
        store.clear()
        store.set_transforms([T("map", "b"), T("map", "c")])
        print(abs(store.lookup_transform("b", "c").stamp / 1e9 - time.time()) < 60)
    """
    assert stepped(code) == "True\n"


def test_now_jumps_ahead_and_back(stepped: Callable[[str], str]) -> None:
    """One stamp of the wrong future makes its frame refuse the present; other frames and snapshots do not mind."""
    code = """
        store.set_transforms([T("map", "b"), T("map", "c")])
        step(86400)
        store.set_transform(T("map", "b"))
        step(-86400)
        store.set_transform(T("map", "c"))
        try:
            store.set_transform(T("map", "b"))
        except shmtf.OldDataError:
            store.remove_frame("b")
            store.set_transform(T("map", "b"))
        print(store.lookup_latest_transform("b", "c") is not None)
    """
    assert stepped(code) == "True\n"
