# SPDX-License-Identifier: Apache-2.0
"""A store's later life: unlink, list, close, pickle, fork, threads."""

from __future__ import annotations

import gc
import multiprocessing
import operator
import os
import pickle
import threading
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor

import pytest

import shmtf
from shmtf import Store, Transform

from .conftest import SMALL, map_lines, path_of

# ---- unlink and list ----


def test_unlink_keeps_the_mapping(store_name: str) -> None:
    with Store.create(store_name, **SMALL) as old:
        Store.unlink(store_name)
        old.set_transform(Transform("map", "x", 1))
        with pytest.raises(shmtf.StoreNotFoundError):
            Store.attach(store_name)
        with pytest.raises(shmtf.StoreNotFoundError):
            Store.unlink(store_name)
        with Store.create(store_name, **SMALL) as new:
            assert new.frames() == []
            assert old.lookup_latest_transform("map", "x").stamp == 1


def bell_of(store: Store) -> str:
    return path_of(f".shmtf-bell-{store._info()['uuid']}")


def test_unlink_removes_the_bell(store: Store) -> None:
    with pytest.raises(shmtf.TimeoutException):
        store.wait_for_change(timeout=0.01)
    assert os.path.exists(bell_of(store))
    Store.unlink(store.name)
    assert not os.path.exists(bell_of(store))


def test_no_bell_is_made_after_unlink(store: Store) -> None:
    Store.unlink(store.name)
    store.set_transform(Transform("map", "x", 1))
    with pytest.raises(shmtf.TimeoutException):
        store.wait_for_change(timeout=0.01)
    assert not os.path.exists(bell_of(store))


def test_list_stores(new_name: Callable[[], str]) -> None:
    names = [new_name() for _ in range(3)]
    garbage, folder = new_name(), new_name()
    for name in names:
        Store.create(name, **SMALL).close()
    with open(path_of(garbage), "wb") as file:
        file.write(b"no store" * 1000)
    os.mkdir(path_of(folder))
    listed = shmtf.list_stores()
    assert listed == sorted(listed)
    assert set(names) <= set(listed)
    assert not {garbage, folder} & set(listed)
    assert not [name for name in listed if name.startswith(".")]
    Store.unlink(names[0])
    assert names[0] not in shmtf.list_stores()


def test_list_stores_is_all_a_process_does(new_name: Callable[[], str], run_python: Callable) -> None:
    name, garbage = new_name(), new_name()
    Store.create(name, **SMALL).close()
    with open(path_of(garbage), "wb") as file:
        file.write(b"no store" * 1000)
    run_python("import sys, shmtf; assert sys.argv[1] in (listed := shmtf.list_stores()), listed", name)


def test_store_info(store_name: str) -> None:
    with Store.create(store_name, cache_time=2.5, **SMALL) as store:
        store.set_transform(Transform("map", "x", 1))
        info = shmtf.store_info(store_name)
    assert (info.name, info.version, info.n_frames, info.max_frames, info.cache_time) == (store_name, 1, 2, 16, 2.5)
    assert info.size_bytes == os.stat(path_of(store_name)).st_size
    assert (info.mode, info.uid) == (0o600, os.getuid())
    assert os.getpid() in [holder.pid for holder in info.holders]
    assert shmtf.store_info(store_name).holders == ()
    Store.unlink(store_name)
    with pytest.raises(shmtf.StoreNotFoundError):
        shmtf.store_info(store_name)


# ---- close ----


def test_everything_raises_after_close(store: Store) -> None:
    store.set_transform(Transform("map", "x", 1))
    snap = store.snapshot()
    store.close()
    store.close()
    assert store.closed
    assert "closed" in repr(store)
    assert store.name
    assert not store.readonly
    for call in (
        lambda: store.version,
        lambda: store.lookup_transform("map", "x"),
        lambda: store.lookup_latest_transform("map", "x"),
        lambda: store.can_transform("map", "x"),
        lambda: store.explain("map", "x"),
        lambda: store.latest_common_time("map", "x"),
        store.frames,
        lambda: store.frame_exists("x"),
        lambda: store.frame_info("x"),
        lambda: store.parent("x"),
        lambda: store.children("map"),
        lambda: store.chain("map", "x"),
        store.all_frames_as_yaml,
        store.all_frames_as_dot,
        lambda: store.set_transform(Transform("map", "x", 2)),
        lambda: store.set_transforms([]),
        lambda: store.declare_frame("y", history=3),
        lambda: store.declare_frame("y", rate=3),
        lambda: store.remove_frame("x"),
        store.clear,
        store.counters,
        store.snapshot,
        lambda: store.wait_for_change(timeout=0),
        store._info,
        store._writers,
        store._check,
        lambda: store._records("x"),
        lambda: store._frame_words("x"),
        lambda: snap.lookup_transform("map", "x"),
        lambda: snap.version,
    ):
        with pytest.raises(shmtf.ClosedError):
            call()


def test_close_unmaps_and_gives_the_descriptor_back(store_name: str) -> None:
    Store.create(store_name, **SMALL).close()
    gc.collect()  # what earlier tests dropped
    descriptors = len(os.listdir("/proc/self/fd"))
    for _ in range(50):
        with Store.attach(store_name) as store:
            store.set_transform(Transform("map", "x", 1))
            store.wait_for_change(since=0)
        Store.attach(store_name).lookup_latest_transform("map", "x")  # dropped without close
    gc.collect()
    assert map_lines(store_name) == []
    assert len(os.listdir("/proc/self/fd")) == descriptors


def test_failed_attach_leaks_nothing(new_name: Callable[[], str]) -> None:
    garbage = new_name()
    with open(path_of(garbage), "wb") as file:
        file.write(os.urandom(8192))
    gc.collect()  # what earlier tests dropped
    descriptors = len(os.listdir("/proc/self/fd"))
    for _ in range(20):
        for name in (garbage, garbage + "x"):
            with pytest.raises(shmtf.StoreError):
                Store.attach(name)
    gc.collect()
    assert len(os.listdir("/proc/self/fd")) == descriptors


# ---- other processes ----


def test_pickle_is_name_and_mode(store: Store) -> None:
    store.set_transform(Transform("map", "x", 1))
    with pickle.loads(pickle.dumps(store)) as copy:
        assert (copy.name, copy.readonly) == (store.name, False)
        copy.set_transform(Transform("map", "x", 2))
        assert copy.frame_info("x").authority == "test"
    with Store.attach(store.name, readonly=True) as reader, pickle.loads(pickle.dumps(reader)) as copy:
        assert copy.readonly
    data = pickle.dumps(store)
    Store.unlink(store.name)
    with pytest.raises(shmtf.StoreNotFoundError):
        pickle.loads(data)


def test_spawn(store: Store) -> None:
    store.set_transform(Transform("map", "x", 7))
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=context) as pool, Store.attach(store.name, readonly=True) as reader:
        look = operator.methodcaller("lookup_latest_transform", "map", "x")
        assert pool.submit(look, reader).result() == store.lookup_latest_transform("map", "x")
        with pytest.raises(shmtf.ReadOnlyStoreError):
            pool.submit(operator.methodcaller("clear"), reader).result()
        with pytest.raises(shmtf.LookupException, match='"nobody"') as caught:
            pool.submit(operator.methodcaller("lookup_transform", "map", "nobody"), store).result()
        assert caught.value.frame == "nobody"


def test_fork_attaches_anew(store: Store) -> None:
    store.set_transform(Transform("map", "parent", 1))
    version = store.version
    pid = os.fork()
    if pid == 0:
        code = 1
        try:
            assert store.lookup_latest_transform("map", "parent").stamp == 1
            store.set_transform(Transform("map", "child", 2))
            assert store.wait_for_change(since=0) >= 2
            slots = [w["pid"] for w in store._writers() if w["alive"]]
            assert os.getpid() in slots and os.getppid() in slots
            store.close()
            code = 0
        finally:
            os._exit(code)
    assert os.waitpid(pid, 0)[1] == 0
    assert store.lookup_latest_transform("map", "child").stamp == 2
    assert store.wait_for_change("child", since=version, timeout=0) > version
    store.set_transform(Transform("map", "parent", 3))


def test_threads(store: Store) -> None:
    """Writers of own frames and readers of all of them; every lookup sees whole batches."""
    n, rounds = 4, 300
    stop = threading.Event()
    failures: list[str] = []

    def write(k: int) -> None:
        for i in range(1, rounds + 1):
            store.set_transforms([Transform("map", f"{k}{side}", i, (i, 0, 0)) for side in "ab"])

    def read() -> None:
        while not stop.is_set():
            for k in range(n):
                difference = store.lookup_latest_transform(f"{k}a", f"{k}b").translation[0]
                if difference:
                    failures.append(f"half a batch: {difference}")

    store.set_transforms([Transform("map", f"{k}{side}", 0) for k in range(n) for side in "ab"])
    readers = [threading.Thread(target=read) for _ in range(2)]
    writers = [threading.Thread(target=write, args=(k,)) for k in range(n)]
    for t in readers + writers:
        t.start()
    for t in writers:
        t.join()
    stop.set()
    for t in readers:
        t.join()
    assert not failures
    assert {store.lookup_latest_transform("map", f"{k}a").stamp for k in range(n)} == {rounds}
