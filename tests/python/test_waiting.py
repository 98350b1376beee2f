# SPDX-License-Identifier: Apache-2.0
"""Waiting: for data, for changes; without the GIL, interruptible, ended by close()."""

from __future__ import annotations

import subprocess
import threading
from collections.abc import Callable

import pytest

import shmtf
from shmtf import Store, Transform


class Waiter(threading.Thread):
    """Calls in a thread; `result` waits for the answer, or raises what the call raised."""

    def __init__(self, call: Callable, *args: object, **kwargs: object) -> None:
        super().__init__(daemon=True)
        self._call = lambda: call(*args, **kwargs)
        self._answer: object = None
        self._error: BaseException | None = None
        self.start()

    def run(self) -> None:
        try:
            self._answer = self._call()
        except BaseException as error:
            self._error = error

    def result(self) -> object:
        self.join()
        if self._error is not None:
            raise self._error
        return self._answer


def until_it_waits(store: Store, waits: int = 1) -> None:
    """Returns once the store's threads have gone to sleep `waits` times.  The GIL must be free for this to go on."""
    while store.counters()["waits"] < waits:
        pass


# ---- lookups ----


@pytest.mark.parametrize("readonly", [False, True])
def test_lookup_waits_for_what_is_missing(store: Store, readonly: bool) -> None:
    with Store.attach(store.name, readonly=readonly) as reader:
        waiter = Waiter(reader.lookup_transform, "map", "arm", 5, timeout=None)
        until_it_waits(reader, 1)
        store.set_transform(Transform("map", "base", 1))  # a frame, and then a path, and then the time
        store.set_transform(Transform("base", "arm", 1))
        store.set_transforms([Transform("map", "base", 4), Transform("base", "arm", 5)])
        assert waiter.is_alive()
        store.set_transform(Transform("map", "base", 6))
        assert waiter.result().stamp == 5


def test_latest_and_can_wait(store: Store) -> None:
    waiters = [
        Waiter(store.lookup_latest_transform, "map", "base", timeout=None),
        Waiter(store.can_transform, "map", "base", timeout=None),
        Waiter(store.lookup_transform, "map", "base", timeout=60),
    ]
    until_it_waits(store, 3)
    store.set_transform(Transform("map", "base", 1))
    assert waiters[0].result().stamp == 1
    assert waiters[1].result() is True
    assert waiters[2].result().stamp == 1


def test_waiting_for_a_frame_that_is_removed_and_made_anew(store: Store) -> None:
    store.set_transforms([Transform("map", "base", 1), Transform("map", "base", 2)])
    store.lookup_transform("map", "base")
    waiter = Waiter(store.lookup_transform, "map", "base", 5, timeout=None)
    until_it_waits(store)
    store.remove_frame("base")
    store.set_transform(Transform("map", "base", 4))
    store.set_transform(Transform("map", "base", 6))
    assert waiter.result().stamp == 5


def test_the_gil_is_free_while_waiting(store: Store) -> None:
    waiter = Waiter(store.lookup_transform, "map", "base", timeout=None)
    until_it_waits(store)  # Python runs here
    store.set_transform(Transform("map", "base", 1))
    waiter.result()
    waiter = Waiter(store.wait_for_change, "base", timeout=None)
    until_it_waits(store, store.counters()["waits"] + 1)
    store.set_transform(Transform("map", "base", 2))
    waiter.result()


def test_a_timeout_of_zero_does_not_wait(store: Store) -> None:
    for timeout in (0, 0.0, -0.0):
        with pytest.raises(shmtf.LookupException) as caught:
            store.lookup_transform("map", "base", timeout=timeout)
        assert not isinstance(caught.value, shmtf.TimeoutException)
    assert store.counters()["waits"] == 0


def test_snapshots_do_not_wait(store: Store) -> None:
    with store.snapshot() as snap, pytest.raises(shmtf.LookupException) as caught:
        snap.lookup_transform("map", "base", timeout=None)
    assert not isinstance(caught.value, shmtf.TimeoutException)


# ---- changes ----


def test_wait_for_change(store: Store) -> None:
    assert store.set_transform(Transform("map", "a", 1)) == 1
    assert store.wait_for_change(since=0) == 1
    assert store.wait_for_change("a", since=0) == 1
    store.set_transform(Transform("map", "b", 1))
    assert store.wait_for_change(["a", "b"], since=1) == 2
    with pytest.raises(shmtf.TimeoutException) as caught:
        store.wait_for_change("a", since=1, timeout=0)
    assert isinstance(caught.value, TimeoutError)
    assert caught.value.version == 2
    with pytest.raises(shmtf.TimeoutException) as caught:
        store.wait_for_change(timeout=0.01)
    assert caught.value.version == 2
    assert caught.value.waited >= 0.01


def test_no_change_is_missed(store: Store) -> None:
    n = 300
    seen: list[int] = []

    def follow() -> None:
        since = 0
        while since < n:
            since = store.wait_for_change("a", since=since)
            seen.append(since)

    follower = Waiter(follow)
    for i in range(n):
        store.set_transform(Transform("map", "a", i))
    follower.result()
    assert seen == sorted(set(seen))
    assert seen[-1] == n


def test_only_the_named_frames_count(store: Store) -> None:
    store.set_transforms([Transform("map", "a", 0), Transform("map", "b", 0)])
    version = store.version
    waiter = Waiter(store.wait_for_change, ("b", "not yet"), since=version)
    until_it_waits(store)
    for i in range(1, 50):
        store.set_transform(Transform("map", "a", i))
    assert waiter.is_alive()
    appeared = store.set_transform(Transform("map", "not yet", 1))
    assert waiter.result() == appeared


def test_wait_for_change_arguments(store: Store) -> None:
    for wrong in ([], (), iter(())):
        with pytest.raises(shmtf.InvalidArgumentException):
            store.wait_for_change(wrong)
    for wrong in ([5], 5, [None]):
        with pytest.raises(TypeError):
            store.wait_for_change(wrong, timeout=0)
    with pytest.raises(TypeError):
        store.wait_for_change(since=1.5, timeout=0)
    with pytest.raises(TypeError):
        store.wait_for_change("a", 0)


# ---- close ----


@pytest.mark.parametrize(
    "call",
    [
        lambda s: s.lookup_transform("map", "none", timeout=None),
        lambda s: s.lookup_latest_transform("map", "none", timeout=None),
        lambda s: s.can_transform("map", "none", timeout=1000),
        lambda s: s.wait_for_change(timeout=None),
        lambda s: s.wait_for_change("none"),
    ],
)
def test_close_ends_waits(store: Store, call: Callable) -> None:
    waiters = [Waiter(call, store) for _ in range(3)]
    until_it_waits(store, 3)
    store.close()
    for waiter in waiters:
        with pytest.raises(shmtf.ClosedError):
            waiter.result()
    with open("/proc/self/maps") as maps:
        assert store.name not in maps.read()


def test_closed_while_a_long_path_is_waited_for(store_name: str) -> None:
    """Its answer comes, but does not fit, and cannot be asked for again."""
    chain = [Transform(f"f{i}", f"f{i + 1}", 1) for i in range(100)]
    with Store.create(store_name, max_frames=101, history=8) as other:
        other.set_transforms(chain[:-1])
        store = Store.attach(store_name)
        waiter = Waiter(store.lookup_transform, "f0", "f100", timeout=None)
        until_it_waits(store)
        store.close()
        other.set_transform(chain[-1])
        with pytest.raises(shmtf.ClosedError):
            waiter.result()


def test_a_store_dropped_while_its_thread_waits(store_name: str) -> None:
    store = Store.create(store_name, max_frames=8, history=8)
    waiter = Waiter(store.lookup_transform, "map", "base", timeout=None)
    until_it_waits(store)
    del store
    with Store.attach(store_name) as other:
        other.set_transform(Transform("map", "base", 1))
        assert waiter.result().edges == (("map", "base", 1),)


# ---- writers that are held up ----


def test_busy_names_the_holder(store: Store, held: subprocess.Popen) -> None:
    with pytest.raises(shmtf.BusyError) as caught:
        store.set_transform(Transform("map", "held", 2**40), timeout=0)
    error = caught.value
    assert error.holder == "the stopped one"
    assert error.holder_pid == held.pid
    assert error.holder_slot >= 0
    for part in ("the stopped one", str(held.pid), '"held"'):
        assert part in str(error)
    with pytest.raises(shmtf.BusyError) as caught:
        store.set_transforms([Transform("map", "held", 2**40)], timeout=0.05)
    assert caught.value.waited >= 0.05
    store.set_transform(Transform("map", "another", 1))
    store.lookup_latest_transform("map", "held")


def test_waiting_for_a_busy_frame(store: Store, held: subprocess.Popen) -> None:
    waiter = Waiter(store.set_transform, Transform("map", "held", 2**40), timeout=None)
    for _ in range(1000):  # Python runs meanwhile, and so do readers
        store.lookup_latest_transform("map", "held")
    assert waiter.is_alive()
    held.kill()
    waiter.result()
    assert store.lookup_latest_transform("map", "held").stamp == 2**40
    assert store.counters()["recoveries"] >= 1
