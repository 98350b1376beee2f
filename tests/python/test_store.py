# SPDX-License-Identifier: Apache-2.0
"""A store's beginning: create and attach."""

from __future__ import annotations

import math
import os
import stat
import threading
from collections.abc import Callable

import pytest

import shmtf
from shmtf import Store, Transform

from .conftest import SMALL, map_lines, path_of

# ---- create ----


def test_create_and_attach(store_name: str) -> None:
    with Store.create(store_name, **SMALL) as a, Store.attach(store_name) as b:
        assert (a.name, a.readonly, a.closed, a.version) == (store_name, False, False, 0)
        a.set_transform(Transform("map", "x", 1))
        assert b.lookup_latest_transform("map", "x").stamp == 1
        b.set_transform(Transform("map", "x", 2))
        assert a.lookup_latest_transform("map", "x").stamp == 2
        assert store_name in repr(a)


def test_default_size_fits_a_small_shm(store_name: str) -> None:
    with Store.create(store_name):
        assert os.stat(path_of(store_name)).st_size < 64 << 20


def test_memory_is_reserved(store_name: str) -> None:
    with Store.create(store_name, **SMALL):
        status = os.stat(path_of(store_name))
        assert status.st_blocks * 512 >= status.st_size


@pytest.mark.parametrize("mode", [0o600, 0o640, 0o666, 0o400])
def test_mode_whatever_the_umask(store_name: str, mode: int) -> None:
    umask = os.umask(0o077)
    try:
        if mode == 0o400 and os.getuid():
            pytest.skip("its owner could not attach")
        Store.create(store_name, mode=mode, **SMALL).close()
    finally:
        os.umask(umask)
    assert stat.S_IMODE(os.stat(path_of(store_name)).st_mode) == mode


def test_exists(store_name: str) -> None:
    with Store.create(store_name, **SMALL) as first:
        first.set_transform(Transform("map", "x", 1))
        with pytest.raises(shmtf.StoreExistsError) as caught:
            Store.create(store_name, **SMALL)
        assert caught.value.store == store_name
        with Store.create(store_name, max_frames=99, exist_ok=True) as second:
            assert second.lookup_latest_transform("map", "x").stamp == 1
            assert second._info()["max_frames"] == 16


def test_exist_ok_makes_it(store_name: str) -> None:
    with Store.create(store_name, exist_ok=True, **SMALL) as made:
        assert made.version == 0


def test_many_create_one_name_at_once(store_name: str) -> None:
    """All get the same store, and one of them made it."""
    barrier = threading.Barrier(8)
    results: list[object] = []

    def run() -> None:
        barrier.wait()
        try:
            results.append(Store.create(store_name, **SMALL))
        except shmtf.StoreExistsError as error:
            results.append(error)

    threads = [threading.Thread(target=run) for _ in range(8)]
    for t in threads:
        t.start()
    for t in threads:
        t.join()
    assert sum(isinstance(r, Store) for r in results) == 1
    assert sum(isinstance(r, shmtf.StoreExistsError) for r in results) == 7


@pytest.mark.parametrize("fails", ["O_TMPFILE", "link"])
def test_without_unnamed_files(store_name: str, monkeypatch: pytest.MonkeyPatch, fails: str) -> None:
    def hidden() -> set[str]:
        return {f for f in os.listdir("/dev/shm") if f.startswith(".shmtf-new-")}

    real_open, real_link = os.open, os.link
    before = hidden()

    def no_tmpfile(path: str, flags: int, *args: object, **kwargs: object) -> int:
        if flags & os.O_TMPFILE == os.O_TMPFILE:
            raise OSError(95, "not supported")
        return real_open(path, flags, *args, **kwargs)

    def no_proc(source: str, *args: object, **kwargs: object) -> None:
        if source.startswith("/proc"):
            raise FileNotFoundError(2, "no /proc")
        real_link(source, *args, **kwargs)

    monkeypatch.setattr(os, "open", no_tmpfile if fails == "O_TMPFILE" else real_open)
    monkeypatch.setattr(os, "link", no_proc if fails == "link" else real_link)
    with Store.create(store_name, **SMALL, mode=0o640) as made:
        made.set_transform(Transform("map", "x", 1))
        with pytest.raises(shmtf.StoreExistsError):
            Store.create(store_name, **SMALL)
    assert stat.S_IMODE(os.stat(path_of(store_name)).st_mode) == 0o640
    assert not hidden() - before


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("", "character"),
        ("a/b", "'/'"),
        ("/a", "'/'"),
        (".a", "'.'"),
        ("x" * 201, "200"),
        ("ä" * 101, "200"),
        ("a\0", "NUL"),
    ],
)
def test_bad_store_names(name: str, says: str) -> None:
    for call in (Store.create, Store.attach, Store.unlink, shmtf.store_info):
        with pytest.raises(shmtf.InvalidArgumentException, match=says):
            call(name)


@pytest.mark.parametrize("name", [None, 5, b"x"])
def test_store_names_that_are_no_str(name: object) -> None:
    for call in (Store.create, Store.attach, Store.unlink):
        with pytest.raises(TypeError):
            call(name)


def test_longest_store_name(new_name: Callable[[], str]) -> None:
    name = (new_name() + "x" * 200)[:200]
    try:
        with Store.create(name, **SMALL), Store.attach(name) as store:
            assert store.name == name
    finally:
        Store.unlink(name)


@pytest.mark.parametrize(
    "bad",
    [
        {"max_frames": 0},
        {"max_frames": -1},
        {"max_frames": 2**32},
        {"max_frames": 2**24},
        {"history": 0},
        {"history": 2**31},
        {"stream_bytes": -1},
        {"stream_bytes": 2**64},
        {"stream_bytes": 2**63},
        {"max_writers": 0},
        {"max_writers": 1024},
        {"cache_time": 0},
        {"cache_time": -1},
        {"cache_time": math.nan},
        {"cache_time": 1e18},
    ],
)
def test_bad_capacities(store_name: str, bad: dict) -> None:
    with pytest.raises(shmtf.InvalidArgumentException) as caught:
        Store.create(store_name, **bad)
    assert next(iter(bad)) in str(caught.value)
    assert not os.path.exists(path_of(store_name))


@pytest.mark.parametrize("bad", [{"max_frames": 1.5}, {"max_frames": "8"}, {"history": None}, {"cache_time": "1"}])
def test_capacities_that_are_no_number(store_name: str, bad: dict) -> None:
    with pytest.raises(TypeError):
        Store.create(store_name, **bad)


def test_not_made_directly() -> None:
    with pytest.raises(TypeError, match=r"Store\.create"):
        Store("robot")


# ---- attach ----


def test_attach_waits_for_it(store_name: str) -> None:
    with pytest.raises(shmtf.StoreNotFoundError) as caught:
        Store.attach(store_name, timeout=0.02)
    assert caught.value.waited >= 0.02
    found: list[Store] = []
    waiter = threading.Thread(target=lambda: found.append(Store.attach(store_name, timeout=None)))
    waiter.start()
    with Store.create(store_name, **SMALL):
        waiter.join()
    assert found[0].version == 0


@pytest.mark.parametrize("timeout", [-1, math.nan])
def test_attach_with_a_bad_timeout(store_name: str, timeout: float) -> None:
    with pytest.raises(shmtf.InvalidArgumentException, match="timeout"):
        Store.attach(store_name, timeout=timeout)


def test_readonly_is_mapped_readonly(store_name: str) -> None:
    Store.create(store_name, **SMALL).close()
    with Store.attach(store_name, readonly=True):
        assert map_lines(store_name) == ["r--s"]
        with Store.attach(store_name):
            assert sorted(map_lines(store_name)) == ["r--s", "rw-s"]
    assert map_lines(store_name) == []


def test_readonly_reads_everything(store_name: str) -> None:
    with Store.create(store_name, **SMALL) as writer, Store.attach(store_name, readonly=True) as reader:
        writer.set_transform(Transform("map", "x", 1))
        writer.set_transform(Transform("map", "x", 3))
        assert reader.lookup_transform("map", "x", 2).stamp == 2
        assert reader.frame_info("x").n_records == 2
        assert reader.wait_for_change(since=0, timeout=0) == 2
        with reader.snapshot() as snap:
            assert snap.readonly
            assert snap.lookup_latest_transform("map", "x").stamp == 3


def test_no_permission(store_name: str, run_python: Callable) -> None:
    Store.create(store_name, **SMALL).close()
    # everything is imported first: another user may not be able to read this Python
    become = "import os; os.setgid(65534); os.setuid(65534)" if os.getuid() == 0 else "pass"
    become = f"[getattr(shmtf, name) for name in shmtf.__all__]; {become}"
    mode = 0o600 if os.getuid() == 0 else 0o000
    os.chmod(path_of(store_name), mode)
    code = f"""
        import sys, shmtf
        {become}
        for readonly in (False, True):
            try:
                shmtf.Store.attach(sys.argv[1], readonly=readonly)
            except shmtf.StorePermissionError as error:
                assert isinstance(error, PermissionError) and sys.argv[1] in str(error)
            else:
                sys.exit("attached")
        assert sys.argv[1] not in shmtf.list_stores()
    """
    run_python(code, store_name)
    if os.getuid() == 0:
        os.chmod(path_of(store_name), 0o644)
        run_python(
            f"""
            import sys, shmtf
            {become}
            assert shmtf.Store.attach(sys.argv[1], readonly=True).frames() == []
            assert sys.argv[1] in shmtf.list_stores()
            try:
                shmtf.Store.attach(sys.argv[1])
            except shmtf.StorePermissionError as error:
                assert "readonly=True" in str(error)
            try:
                shmtf.Store.unlink(sys.argv[1])
            except shmtf.StorePermissionError:
                sys.exit(0)
            sys.exit("removed")
            """,
            store_name,
        )
