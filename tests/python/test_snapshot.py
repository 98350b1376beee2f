# SPDX-License-Identifier: Apache-2.0
"""Snapshots: several reads of one commit."""

from __future__ import annotations

import contextlib
import subprocess
import sys
import textwrap

import pytest

import shmtf
from shmtf import Store, Transform
from shmtf.snapshot import Reads


def test_reads_stay_at_their_commit(store: Store) -> None:
    store.set_transforms([Transform("map", "a", 1, (1, 0, 0)), Transform("a", "b", 1)])
    with store.snapshot() as snap:
        store.set_transform(Transform("map", "a", 2, (2, 0, 0)))
        store.set_transform(Transform("map", "b", 2))
        assert (snap.version, store.version) == (1, 3)
        assert snap.name == store.name
        assert snap.lookup_latest_transform("map", "a").translation[0] == 1
        assert snap.lookup_latest_transform("map", "a").version == 1
        assert snap.lookup_transform("map", "b").stamp == 1
        assert set(snap.frames()) == {"map", "a", "b"}
        assert snap.parent("b") == "a"
        assert snap.children("a") == ["b"]
        assert snap.chain("map", "b") == ["map", "a", "b"]
        assert snap.frame_info("a").newest == 1
        assert snap.latest_common_time("map", "a", "b") == 1
        assert not snap.can_transform("map", "a", 2)
        assert '"map" -> "b"' not in snap.all_frames_as_yaml() + snap.all_frames_as_dot()
        assert '"map" -> "b"' in store.all_frames_as_dot()
        assert store.lookup_latest_transform("map", "b").translation[0] == 0


def test_births_and_removals_are_not_seen(store: Store) -> None:
    """The frame's memory may have been reused: then the snapshot says so, and never answers for another commit."""
    store.set_transforms([Transform("map", "a", 1), Transform("a", "b", 1), Transform("map", "c", 1)])
    with store.snapshot() as snap:
        store.remove_frame("a")
        store.set_transform(Transform("map", "new", 2))
        store.set_transform(Transform("map", "a", 2, (5, 0, 0)))
        for call, answer in {
            lambda: snap.frame_exists("a"): True,
            lambda: snap.frame_exists("new"): False,
            lambda: set(snap.frames()): {"map", "a", "b", "c"},
            lambda: snap.lookup_latest_transform("map", "b").translation[0]: 0,
            lambda: snap.can_transform("map", "new"): False,
            lambda: snap.children("map"): ["a", "c"],
        }.items():
            with contextlib.suppress(shmtf.SnapshotExpiredError):
                assert call() == answer
        assert snap.lookup_latest_transform("map", "c").stamp == 1
    assert set(store.frames()) == {"map", "a", "b", "c", "new"}


def test_births_do_not_end_a_snapshot(store: Store) -> None:
    store.set_transform(Transform("map", "a", 1))
    with store.snapshot() as snap:
        store.set_transforms([Transform("map", f"new{i}", 2) for i in range(40)])
        assert set(snap.frames()) == {"map", "a"}
        assert not any(snap.frame_exists(f"new{i}") for i in range(40))
        assert not snap.can_transform("map", "new7")
        assert snap.lookup_latest_transform("map", "a").stamp == 1


def test_expiry(store: Store) -> None:
    store.set_transform(Transform("map", "a", 0))
    snap = store.snapshot()
    for i in range(1, 1000):
        store.set_transform(Transform("map", "a", i))
    with pytest.raises(shmtf.SnapshotExpiredError, match=r"snapshot"):
        snap.lookup_latest_transform("map", "a")
    assert store.snapshot().lookup_latest_transform("map", "a").stamp == 999


def test_close(store: Store) -> None:
    store.set_transform(Transform("map", "a", 0))
    with store.snapshot() as snap:
        assert "at 1" in repr(snap)
    assert snap.closed
    assert "closed" in repr(snap)
    for call in (lambda: snap.lookup_latest_transform("map", "a"), snap.frames, lambda: snap.version):
        with pytest.raises(shmtf.ClosedError):
            call()
    assert not store.closed


def test_not_made_of_anything_else(store: Store) -> None:
    with pytest.raises((TypeError, AttributeError)):
        shmtf.Snapshot("robot")
    with pytest.raises(TypeError):
        shmtf._core.Reader()
    with pytest.raises(AttributeError):
        store.snapshot().set_transform(Transform("map", "a", 1))


def test_several_reads_are_of_one_commit(store: Store) -> None:
    store.set_transforms([Transform("map", "a", 1), Transform("map", "b", 1)])

    def read(reads: Reads) -> tuple[str | None, str | None]:
        before = reads.parent("b")
        store.set_transform(Transform("a", "b", 2))
        return before, reads.parent("b")

    assert store._consistent(read) == ("map", "map")
    assert store.parent("b") == "a"


def test_several_reads_begin_again_when_they_expire(store: Store) -> None:
    store.set_transform(Transform("map", "a", 1))
    tries: list[int] = []

    def read(reads: Reads) -> int | None:
        tries.append(len(tries))
        for i in range(1000 if len(tries) < 3 else 0):
            store.set_transform(Transform("map", "a", 1000 * len(tries) + i))
        return reads.frame_info("a").newest

    assert store._consistent(read) == 2999
    assert len(tries) == 3


def test_dumps_are_of_one_commit(store: Store) -> None:
    """A chain turns into a star and back, as a whole; no dump shows it half turned."""
    store.set_transforms([Transform(f"f{i}", f"f{i + 1}", 0) for i in range(12)])
    code = f"""
        import shmtf
        store = shmtf.Store.attach({store.name!r})
        stamp = 0
        while True:
            stamp += 1
            parents = [f"f{{i}}" if stamp % 2 else "f0" for i in range(12)]
            store.set_transforms([shmtf.Transform(p, f"f{{i + 1}}", stamp) for i, p in enumerate(parents)])
    """
    with subprocess.Popen([sys.executable, "-c", textwrap.dedent(code)], cwd="/") as turner:
        try:
            store.wait_for_change("f12", since=store.version)
            for _ in range(300):
                dot = store.all_frames_as_dot()
                assert len({f'"f{i}" -> "f{i + 1}"' in dot for i in range(1, 12)}) == 1
                assert store.children("f0") in (["f1"], [f"f{i + 1}" for i in range(12)])
                assert store.latest_common_time(*(f"f{i}" for i in range(13))) is not None
        finally:
            turner.kill()
