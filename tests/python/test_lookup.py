# SPDX-License-Identifier: Apache-2.0
"""Lookups and what else can be read."""

from __future__ import annotations

import gc
import math
import pickle
import sys

import numpy as np
import pytest

import shmtf
from shmtf import Transform

S = 10**9


@pytest.fixture
def tree(store: shmtf.Store) -> shmtf.Store:
    """map -> odom -> base -> arm, base -> camera (static); 1 s and 2 s; the arm 10 ns later."""
    store.set_transform(Transform("base", "camera", None, (0, 0, 1)), static=True)
    for k in (1, 2):
        store.set_transforms(
            [
                Transform("map", "odom", k * S, (10 * k, 0, 0)),
                Transform.from_rpy("odom", "base", k * S, (0, k, 0), (0, 0, k * 0.2)),
                Transform("base", "arm", k * S + 10, (0, 0, k)),
            ]
        )
    return store


def expected(t: float) -> Transform:
    """map <- arm at t seconds."""
    a = Transform("map", "odom", 0, (10 * t, 0, 0))
    b = Transform.from_rpy("odom", "base", 0, (0, t, 0), (0, 0, t * 0.2))
    return a @ b @ Transform("base", "arm", 0, (0, 0, t))


def test_direction_and_names(tree: shmtf.Store) -> None:
    t = tree.lookup_latest_transform("map", "odom")
    assert (t.parent, t.child) == ("map", "odom")
    assert t.translation.tolist() == [20, 0, 0]
    assert tree.lookup_latest_transform("odom", "map").translation.tolist() == [-20, 0, 0]
    assert isinstance(t, Transform)


def test_latest_uses_the_newest_of_each_edge(tree: shmtf.Store) -> None:
    t = tree.lookup_latest_transform("map", "arm")
    assert t.is_close(expected(2))
    assert t.stamp == 2 * S
    assert t.stamp_range == (2 * S, 2 * S + 10)
    assert t.edges == (("base", "arm", 2 * S + 10), ("odom", "base", 2 * S), ("map", "odom", 2 * S))
    assert t.version == tree.version


def test_at_a_time_interpolates(tree: shmtf.Store) -> None:
    t = tree.lookup_transform("map", "arm", S + S // 2 + 5)
    assert t.is_close(expected(1.5), distance=1e-6, angle=1e-6)
    assert t.stamp == S + S // 2 + 5
    assert t.stamp_range == (t.stamp, t.stamp)
    assert [e[:2] for e in t.edges] == [("base", "arm"), ("odom", "base"), ("map", "odom")]
    assert tree.lookup_transform("map", "odom", S).translation.tolist() == [10, 0, 0]
    for other in (np.int64(S), np.datetime64(S, "ns")):
        assert tree.lookup_transform("map", "odom", other).stamp == S


def test_no_time_is_the_newest_common_time(tree: shmtf.Store) -> None:
    t = tree.lookup_transform("map", "arm")
    assert t.stamp == 2 * S == tree.latest_common_time("map", "arm")
    assert t == tree.lookup_transform("map", "arm", 2 * S)
    assert tree.lookup_transform("base", "arm").stamp == 2 * S + 10


def test_time_zero_is_an_instant(store: shmtf.Store) -> None:
    store.set_transforms([Transform("a", "b", -1, (1, 0, 0)), Transform("a", "b", 1, (3, 0, 0))])
    assert store.lookup_transform("a", "b", 0).translation.tolist() == [2, 0, 0]
    assert store.lookup_transform("a", "b", 0).stamp == 0


def test_static_paths_have_no_stamp(tree: shmtf.Store) -> None:
    for t in (
        tree.lookup_transform("base", "camera"),
        tree.lookup_transform("base", "camera", 5),
        tree.lookup_latest_transform("camera", "base"),
    ):
        assert (t.stamp, t.stamp_range) == (None, None)
        assert t.edges == (("base", "camera", None),)
    assert tree.lookup_transform("odom", "camera", S).stamp == S
    assert tree.latest_common_time("base", "camera") is None


def test_same_frame(tree: shmtf.Store) -> None:
    assert (t := tree.lookup_transform("arm", "arm")).edges == ()
    assert (t.parent, t.child, t.stamp) == ("arm", "arm", None)
    assert t.matrix.tolist() == np.eye(4).tolist()
    with pytest.raises(shmtf.LookupException):
        tree.lookup_transform("nobody", "nobody")
    assert not tree.can_transform("nobody", "nobody")


def test_can_transform(tree: shmtf.Store) -> None:
    assert tree.can_transform("map", "arm") is True
    assert tree.can_transform("map", "arm", S + 20) is True
    assert tree.can_transform("map", "arm", 9 * S) is False
    assert tree.can_transform("map", "arm", time=0) is False
    assert tree.can_transform("map", "nobody") is False
    assert tree.can_transform("map", "nobody", timeout=0.01) is False
    for wrong in (("", "arm"), ("map", "/arm"), ("map", "x" * 10_000)):
        with pytest.raises(shmtf.InvalidArgumentException):
            tree.can_transform(*wrong)
    with pytest.raises(TypeError):
        tree.can_transform("map", "arm", 1.5)


@pytest.mark.parametrize("method", ["lookup_transform", "lookup_latest_transform", "can_transform", "explain", "chain"])
def test_arguments(tree: shmtf.Store, method: str) -> None:
    call = getattr(tree, method)
    call("map", "arm")
    call(target="map", source="arm")
    call("map", source="arm")
    for arguments, keywords in (
        ((), {}),
        (("map",), {}),
        (("map", "arm"), {"nonsense": 1}),
        (("map", "arm"), {"target": "map"}),
        (("map", "arm", None, 0.0, 0.0), {}),
        (("map", 5), {}),
        ((None, "arm"), {}),
    ):
        with pytest.raises(TypeError):
            call(*arguments, **keywords)


@pytest.mark.parametrize("timeout", [-1, -0.001, math.nan, -math.inf])
def test_bad_timeouts(tree: shmtf.Store, timeout: float) -> None:
    for call in (tree.lookup_transform, tree.lookup_latest_transform, tree.can_transform):
        with pytest.raises(shmtf.InvalidArgumentException, match="timeout"):
            call("map", "arm", timeout=timeout)
    with pytest.raises(shmtf.InvalidArgumentException, match="timeout"):
        tree.wait_for_change(timeout=timeout)
    with pytest.raises(TypeError):
        tree.lookup_transform("map", "arm", timeout="1")


@pytest.mark.parametrize("time", [1.5, True, "1", object()])
def test_bad_times(tree: shmtf.Store, time: object) -> None:
    with pytest.raises(TypeError, match="time must be"):
        tree.lookup_transform("map", "arm", time)
    with pytest.raises(TypeError, match="time must be"):
        tree.parent("arm", time)


def test_float_time_points_to_from_seconds(tree: shmtf.Store) -> None:
    with pytest.raises(TypeError, match=r"shmtf\.from_seconds"):
        tree.lookup_transform("map", "arm", 1.5)


def test_long_names(tree: shmtf.Store) -> None:
    for name in ("x" * 128, "x" * 10_000):
        for call in (
            lambda n: tree.lookup_transform("map", n),
            lambda n: tree.lookup_latest_transform(n, "map"),
            tree.frame_exists,
            tree.frame_info,
            tree.parent,
            lambda n: tree.wait_for_change([n], timeout=0),
            tree.remove_frame,
            lambda n: tree.declare_frame(n, history=3),
        ):
            with pytest.raises(shmtf.InvalidArgumentException, match="127 bytes") as caught:
                call(name)
            assert len(str(caught.value)) < 300


def test_long_paths_have_all_their_edges(store_name: str) -> None:
    n = 1500
    with shmtf.Store.create(store_name, max_frames=2000, history=2) as store:
        store.set_transforms([Transform(f"f{i}", f"f{i + 1}", 1, (1, 0, 0)) for i in range(n)])
        t = store.lookup_latest_transform("f0", f"f{n}")
        assert t.translation.tolist() == [n, 0, 0]
        assert len(t.edges) == n
        assert store.chain("f0", f"f{n}") == [f"f{i}" for i in range(n + 1)]
        assert store.chain(f"f{n}", "f0") == [f"f{i}" for i in reversed(range(n + 1))]


def test_tree_queries(tree: shmtf.Store) -> None:
    assert set(tree.frames()) == {"map", "odom", "base", "arm", "camera"}
    assert tree.frame_exists("arm") is True
    assert tree.frame_exists("nobody") is False
    assert tree.parent("arm") == "base"
    assert tree.parent("map") is None
    assert tree.parent("arm", 2 * S) == "base"
    with pytest.raises(shmtf.ExtrapolationException):
        tree.parent("arm", 5 * S)
    assert sorted(tree.children("base")) == ["arm", "camera"]
    assert tree.children("arm") == []
    assert tree.chain("map", "arm") == ["map", "odom", "base", "arm"]
    assert tree.chain("arm", "camera") == ["arm", "base", "camera"]
    assert tree.chain("arm", "camera", 2 * S) == ["arm", "base", "camera"]
    assert tree.chain("arm", "arm") == ["arm"]
    for call in (tree.parent, tree.children, tree.frame_info):
        with pytest.raises(shmtf.LookupException, match="nobody"):
            call("nobody")


def test_latest_common_time_of_several(tree: shmtf.Store) -> None:
    tree.set_transform(Transform("base", "hand", S, (0, 0, 0)))
    assert tree.latest_common_time("map", "arm", "camera") == 2 * S
    assert tree.latest_common_time("map", "arm", "hand") == S
    assert tree.latest_common_time("base", "camera", "camera") is None
    assert tree.latest_common_time("arm") is None
    with pytest.raises(shmtf.InvalidArgumentException):
        tree.latest_common_time()
    with pytest.raises(shmtf.LookupException):
        tree.latest_common_time("map", "arm", "nobody")


def test_frame_info(tree: shmtf.Store) -> None:
    info = tree.frame_info("arm")
    assert (info.name, info.parent, info.is_static, info.is_root) == ("arm", "base", False, False)
    assert (info.n_records, info.oldest, info.newest) == (2, S + 10, 2 * S + 10)
    assert info.rate == 1.0
    assert info.authority == "test"
    assert info.capacity >= 32
    assert info.age > 0
    assert 0 <= shmtf.now() - info.arrival < 3600 * S
    assert info.version <= tree.version
    camera = tree.frame_info("camera")
    assert (camera.is_static, camera.oldest, camera.newest, camera.rate, camera.age) == (True, None, None, None, None)
    root = tree.frame_info("map")
    assert (root.parent, root.is_root, root.n_records) == (None, True, 0)
    with pytest.raises(AttributeError):
        info.name = "x"


def test_reparenting(store: shmtf.Store) -> None:
    store.set_transform(Transform("a", "x", 1, (1, 0, 0)))
    store.set_transform(Transform("b", "x", 3, (2, 0, 0)))
    assert store.parent("x") == "b"
    assert store.parent("x", 1) == store.parent("x", 2) == "a"
    assert store.lookup_transform("a", "x", 2).translation.tolist() == [1, 0, 0]
    assert store.chain("a", "x", 2) == ["a", "x"]
    with pytest.raises(shmtf.ConnectivityException):
        store.lookup_latest_transform("a", "x")


def test_yaml_is_valid_whatever_the_names(tree: shmtf.Store) -> None:
    yaml = pytest.importorskip("yaml")
    odd = ['"', "\\", "a: b", "- x", "{", "yes", "1", "new\nline", "\x7f\x85\ufeff", "☃ 🤖", "'", "#", "null"]
    for name in odd:
        tree.set_transform(Transform("map", name, 5 * S), authority=f"by {name}"[:60])
    read = yaml.safe_load(tree.all_frames_as_yaml())
    assert set(read) == set(tree.frames()) - {"map"}
    assert read["arm"] == {
        "parent": "base",
        "broadcaster": "test",
        "rate": 1.0,
        "most_recent_transform": 2.00000001,
        "oldest_transform": 1.00000001,
        "buffer_length": 1.0,
    }
    assert read["new\nline"]["parent"] == "map"
    assert read["new\nline"]["broadcaster"] == "by new\nline"


def test_yaml_of_an_empty_store(store: shmtf.Store) -> None:
    assert not pytest.importorskip("yaml").safe_load(store.all_frames_as_yaml())
    assert store.all_frames_as_dot().startswith("digraph G {")


def test_dot(tree: shmtf.Store) -> None:
    tree.set_transform(Transform("map", 'a "b" \\', 1))
    dot = tree.all_frames_as_dot()
    assert (
        '"base" -> "arm"[label="Broadcaster: test\\nAverage rate: 1.000 Hz\\nMost recent transform: 2.000000010' in dot
    )
    assert '"map" -> "a \\"b\\" \\\\"' in dot
    assert dot.count("{") == dot.count("}") == 1


def test_edges_after_close_and_pickle(tree: shmtf.Store) -> None:
    t = tree.lookup_latest_transform("map", "arm")
    u = tree.lookup_latest_transform("map", "arm")
    tree.close()
    assert [e[:2] for e in t.edges] == [("base", "arm"), ("odom", "base"), ("map", "odom")]
    assert t.edges is t.edges
    copy = pickle.loads(pickle.dumps(u))
    assert copy == u
    assert (copy.edges, copy.stamp_range, copy.version) == (u.edges, u.stamp_range, u.version)


def test_edges_of_a_removed_frame(tree: shmtf.Store) -> None:
    t = tree.lookup_latest_transform("map", "arm")
    tree.remove_frame("arm")
    tree.set_transform(Transform("map", "other", 1))
    assert t.edges[0] in (("base", None, 2 * S + 10), ("base", "arm", 2 * S + 10))
    assert t.edges[1:] == (("odom", "base", 2 * S), ("map", "odom", 2 * S))


def test_known_names_follow_removed_frames(store: shmtf.Store) -> None:
    """A name that the reader remembers becomes another frame, by another's doing."""
    with shmtf.Store.attach(store.name, readonly=True) as reader:
        for k in range(20):
            store.set_transform(Transform("map", "base", 1, (k, 0, 0)))
            assert reader.lookup_latest_transform("map", "base").translation[0] == k
            assert reader.latest_common_time("map", "base") == 1
            store.remove_frame("base")
            if k % 2:
                with pytest.raises(shmtf.LookupException):
                    reader.lookup_latest_transform("map", "base")
            store.set_transform(Transform("map", f"filler{k}", 1))
            if k % 3:
                store.remove_frame(f"filler{k}")


def test_more_names_than_are_remembered(store_name: str) -> None:
    with shmtf.Store.create(store_name, max_frames=3000, history=2) as store:
        names = [f"frame-{i}" for i in range(2500)]
        store.set_transforms([Transform("root", name, 1, (i, 0, 0)) for i, name in enumerate(names)])
        for _ in range(3):
            for i, name in enumerate(names):
                assert store.lookup_latest_transform("root", name).translation[0] == i


def test_lookups_leak_nothing(tree: shmtf.Store) -> None:
    def work() -> None:
        assert tree.lookup_latest_transform("map", "arm").edges
        tree.lookup_transform("map", "camera", S)
        tree.can_transform("map", "nobody")
        tree.explain("map", "nobody")
        tree.explain("map", "arm", 0)
        tree.set_transform(Transform("map", "odom", 2 * S, (1, 2, 3)))
        tree.frame_info("arm")
        tree.all_frames_as_yaml()

    def held() -> tuple[int, list[int]]:
        for _ in range(200):
            work()
        gc.collect()
        shared = [*tree.frames(), None, True, Transform, shmtf.LookupException]
        return sys.getallocatedblocks(), [sys.getrefcount(each) for each in shared]

    held()
    blocks, references = held()
    more_blocks, more_references = held()
    assert more_blocks - blocks < 100
    assert max(after - before for before, after in zip(references, more_references, strict=True)) < 100
