# SPDX-License-Identifier: Apache-2.0
"""Writing: what is stored, what is refused, all or nothing."""

from __future__ import annotations

import math
from collections.abc import Iterator

import pytest

import shmtf
from shmtf import Transform

S = 10**9


def contents(store: shmtf.Store) -> dict[str, list]:
    return {name: store._records(name) for name in store.frames()}


def test_what_is_written_is_read(store: shmtf.Store) -> None:
    t = Transform("map", "base", 5, (1, 2, 3), (0.5, 0.5, 0.5, 0.5))
    version = store.set_transform(t)
    assert version == store.version == 1
    assert store.lookup_latest_transform("map", "base") == t
    assert store.lookup_transform("map", "base", 5) == t
    assert store.set_transform(store.lookup_latest_transform("base", "map").inv()) == 1  # an identical repeat
    assert store.counters()["repeats"] == 1


def test_stamp_none_is_now_and_one_for_the_batch(store: shmtf.Store) -> None:
    before = shmtf.now()
    store.set_transforms([Transform("map", f"f{i}") for i in range(50)] + [Transform("map", "dated", 7)])
    after = shmtf.now()
    stamps = {store.lookup_latest_transform("map", f"f{i}").stamp for i in range(50)}
    assert len(stamps) == 1
    assert before <= stamps.pop() <= after
    assert store.lookup_latest_transform("map", "dated").stamp == 7
    t = Transform("map", "again")
    store.set_transform(t)
    assert t.stamp is None


def test_iterables_of_every_kind(store: shmtf.Store) -> None:
    items = [Transform("map", f"f{i}", 1, (i, 0, 0)) for i in range(5)]
    for batch in (items, tuple(items), iter(items), (t for t in items), set(items), dict.fromkeys(items)):
        store.set_transforms(batch)
        assert set(store.frames()) == {"map", *(f"f{i}" for i in range(5))}
        for t in items:
            store.remove_frame(t.child)
    version = store.version
    assert store.set_transforms([]) == version


@pytest.mark.parametrize("n", [1, 16, 256, 257, 1000])
def test_batches_are_one_commit(store_name: str, n: int) -> None:
    with shmtf.Store.create(store_name, max_frames=2000, history=2) as store:
        version = store.set_transforms([Transform("map", f"f{i}", 1, (i, 0, 0)) for i in range(n)])
        assert version == store.version == 1
        assert {store.frame_info(f"f{i}").version for i in range(n)} == {1}
        assert store.lookup_latest_transform("map", f"f{n - 1}").translation[0] == n - 1


class Unrelated:
    parent = "map"
    child = "x"


@pytest.mark.parametrize("bad", [None, 1, "map", Unrelated(), shmtf._core.Transform])
def test_items_that_are_no_transform(store: shmtf.Store, bad: object) -> None:
    with pytest.raises(TypeError, match=r"not a shmtf\.Transform"):
        store.set_transform(bad)
    with pytest.raises(TypeError, match=r"item 1 is not a shmtf\.Transform"):
        store.set_transforms([Transform("map", "a", 1), bad])
    assert store.frames() == []
    for iterable in (None, 5):
        with pytest.raises(TypeError):
            store.set_transforms(iterable)


def test_an_iterable_that_raises_writes_nothing(store: shmtf.Store) -> None:
    def items() -> Iterator[Transform]:
        yield Transform("map", "a", 1)
        raise KeyError("mine")

    with pytest.raises(KeyError, match="mine"):
        store.set_transforms(items())
    assert store.frames() == []
    assert store.version == 0


def test_an_iterable_that_closes_the_store(store: shmtf.Store) -> None:
    def items() -> Iterator[Transform]:
        yield Transform("map", "a", 1)
        store.close()

    with pytest.raises(shmtf.ClosedError):
        store.set_transforms(items())


def test_refused_batches_change_nothing(store: shmtf.Store) -> None:
    store.set_transforms([Transform("map", "a", 20 * S), Transform("a", "b", 20 * S)])
    before, version = contents(store), store.version
    good = [Transform("map", f"new{i}", 20 * S) for i in range(3)]
    with pytest.raises(shmtf.OldDataError) as old:
        store.set_transforms([*good, Transform("map", "a", 1)])
    assert old.value.item == 3
    assert old.value.edge == ("map", "a")
    assert (old.value.requested, old.value.newest) == (1, 20 * S)
    assert "cache_time" in str(old.value)
    with pytest.raises(shmtf.CycleError) as cycle:
        store.set_transforms([*good, Transform("b", "map", 20 * S)])
    assert cycle.value.edge == ("b", "map")
    with pytest.raises(shmtf.CycleError):
        store.set_transforms([Transform("x", "y", 1), Transform("y", "z", 1), Transform("z", "x", 1)])
    for error in (old.value, cycle.value):
        assert isinstance(error, shmtf.InvalidArgumentException)
    assert contents(store) == before
    assert store.version == version


def test_full_store(store_name: str) -> None:
    with shmtf.Store.create(store_name, max_frames=4, history=2) as store:
        store.set_transforms([Transform("map", f"f{i}", 1) for i in range(3)])
        with pytest.raises(shmtf.StoreFullError) as caught:
            store.set_transform(Transform("map", "one more", 1))
        assert caught.value.what == "max_frames"
        assert caught.value.limit == 4
        assert "max_frames" in str(caught.value)
        assert len(store.frames()) == 4
        store.remove_frame("f0")
        store.set_transform(Transform("map", "one more", 1))


def test_readonly_writes(store: shmtf.Store) -> None:
    store.set_transform(Transform("map", "a", 1))
    with shmtf.Store.attach(store.name, readonly=True) as reader:
        assert reader.readonly
        for write in (
            lambda: reader.set_transform(Transform("map", "b", 1)),
            lambda: reader.set_transforms([Transform("map", "b", 1)] * 300),
            lambda: reader.remove_frame("a"),
            reader.clear,
            lambda: reader.declare_frame("c", history=4),
        ):
            with pytest.raises(shmtf.ReadOnlyStoreError, match="readonly"):
                write()
        assert reader.lookup_latest_transform("map", "a").stamp == 1
    assert store.version == 1


def test_static(store: shmtf.Store) -> None:
    store.set_transform(Transform("map", "a", 5, (1, 0, 0)), static=True)
    store.set_transform(Transform("map", "a", 5, (2, 0, 0)), static=True)
    assert store.lookup_transform("map", "a", -1).translation.tolist() == [2, 0, 0]
    store.set_transform(Transform("map", "a", 7, (3, 0, 0)))
    assert store.lookup_latest_transform("map", "a").stamp == 7
    assert store.frame_info("a").n_records == 1


def test_authority(store: shmtf.Store) -> None:
    store.set_transform(Transform("map", "a", 1))
    store.set_transforms([Transform("map", "b", 1)], authority="läser")
    assert store.frame_info("a").authority == "test"
    assert store.frame_info("b").authority == "läser"
    with pytest.raises(TypeError, match="authority"):
        store.set_transform(Transform("map", "a", 2), authority=5)
    with pytest.raises(shmtf.InvalidArgumentException, match="NUL"):
        store.set_transform(Transform("map", "a", 2), authority="a\0b")


def test_keywords_only(store: shmtf.Store) -> None:
    t = Transform("map", "a", 1)
    for call in (store.set_transform, store.set_transforms):
        with pytest.raises(TypeError):
            call(t, True)
        with pytest.raises(TypeError):
            call(t, nonsense=True)
        with pytest.raises(shmtf.InvalidArgumentException, match="timeout"):
            call([t] if call == store.set_transforms else t, timeout=math.nan)
    assert store.frames() == []
    store.set_transform(t, static=False, authority=None, timeout=None, priority=True)


def test_declare_frame(store: shmtf.Store) -> None:
    store.declare_frame("fast", history=500)
    assert store.frame_exists("fast")
    assert store.frame_info("fast").capacity >= 500
    store.declare_frame("rated", rate=50.0)
    assert store.frame_info("rated").capacity >= 500
    for i in range(600):
        store.set_transform(Transform("map", "fast", i * 1_000_000))
    assert store.frame_info("fast").n_records >= 500
    with pytest.raises(shmtf.InvalidArgumentException, match="history"):
        store.declare_frame("fast", history=20)
    for wrong in (
        {},
        {"history": 5, "rate": 5},
        {"history": 0},
        {"history": -1},
        {"rate": 0},
        {"rate": math.nan},
        {"history": 2**40},
    ):
        with pytest.raises(shmtf.InvalidArgumentException):
            store.declare_frame("other", **wrong)
    with pytest.raises(shmtf.StoreFullError):
        store.declare_frame("huge", history=1_000_000)
    assert not store.frame_exists("other")
    assert not store.frame_exists("huge")


def test_declare_by_rate_needs_a_cache_time(store_name: str) -> None:
    with shmtf.Store.create(store_name, max_frames=8, history=8, cache_time=None) as store:
        with pytest.raises(shmtf.InvalidArgumentException, match="history="):
            store.declare_frame("x", rate=10)
        store.set_transform(Transform("map", "a", 10**18))
        store.set_transform(Transform("map", "a", 1))
        assert store.frame_info("a").n_records == 2


def test_remove_frame(store: shmtf.Store) -> None:
    store.set_transforms([Transform("map", "a", 1), Transform("a", "b", 1)])
    store.remove_frame("a")
    assert not store.frame_exists("a")
    assert store.parent("b") is None
    with pytest.raises(shmtf.LookupException, match='"a"'):
        store.remove_frame("a")
    store.set_transform(Transform("map", "a", 2))
    with pytest.raises(shmtf.ConnectivityException):  # the new "a" is not the old one
        store.lookup_latest_transform("map", "b")


def test_a_batch_about_a_frame_that_was_removed(store: shmtf.Store) -> None:
    """The names in it are known as the frame that is no more."""
    filler = [Transform("map", "many", i) for i in range(2)] * 130  # enough to release the GIL
    for k in range(4):
        batch = [Transform("map", "a", 1), Transform("map", "a", 3), Transform("a", "b", 1)]
        store.set_transforms(batch + filler if k == 3 else batch)
        assert store.lookup_transform("map", "a", 2).stamp == 2
        store.remove_frame("a")
        store.set_transform(Transform("map", f"filler{k}", 1))


def test_clear(store: shmtf.Store) -> None:
    store.set_transform(Transform("map", "a", 1))
    store.set_transform(Transform("map", "s"), static=True)
    store.clear()
    assert set(store.frames()) == {"map", "a", "s"}
    assert store.can_transform("map", "s")
    assert not store.can_transform("map", "a")
    store.set_transform(Transform("map", "a", -5))
    assert store.lookup_latest_transform("map", "a").stamp == -5
    store.clear(keep_static=False)
    assert not store.can_transform("map", "s")


def test_expiry(store: shmtf.Store) -> None:
    store.set_transform(Transform("map", "a", 0))
    store.set_transform(Transform("map", "a", 10 * S))
    assert store.lookup_transform("map", "a", 0).stamp == 0
    store.set_transform(Transform("map", "a", 10 * S + 1))
    with pytest.raises(shmtf.BackwardExtrapolationException):
        store.lookup_transform("map", "a", 0)
    store.set_transform(Transform("map", "a", 1))
    with pytest.raises(shmtf.OldDataError):
        store.set_transform(Transform("map", "a", 0))


def test_counters(store: shmtf.Store) -> None:
    assert set(store.counters()) == {
        "commits", "aborts", "helps", "recoveries", "rereads", "restarts", "waits", "late_dropped", "repeats",
    }  # fmt: skip
    store.set_transform(Transform("map", "a", 1))
    store.set_transform(Transform("map", "a", 2))
    assert store.counters()["commits"] == 2
