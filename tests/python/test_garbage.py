# SPDX-License-Identifier: Apache-2.0
"""Names that lead to something else than a store: a typed error, never a crash, a hang or a changed file."""

from __future__ import annotations

import os
import random
import socket
from collections.abc import Callable

import pytest

import shmtf
from shmtf import Store

from .conftest import SMALL, path_of, read, write

PAGE = 4096


@pytest.mark.parametrize("readonly", [False, True])
@pytest.mark.parametrize("size", [0, 1, 7, 8, 100, PAGE - 1, PAGE, PAGE + 1, 3 * PAGE, -PAGE, -1])
def test_truncated(store_name: str, image: bytes, size: int, readonly: bool) -> None:
    write(store_name, image[:size])
    with pytest.raises((shmtf.StoreVersionError, shmtf.StoreCorruptError)) as caught:
        Store.attach(store_name, readonly=readonly)
    assert store_name in str(caught.value)
    assert caught.value.store == store_name
    assert read(store_name) == image[:size]


def test_longer_than_it_says(store_name: str, image: bytes) -> None:
    write(store_name, image + bytes(PAGE))
    with pytest.raises((shmtf.StoreVersionError, shmtf.StoreCorruptError)):
        Store.attach(store_name)


@pytest.mark.parametrize("readonly", [False, True])
@pytest.mark.parametrize("size", [1, PAGE, 100_000])
def test_zeroed_and_random(store_name: str, size: int, readonly: bool) -> None:
    for data in (bytes(size), random.Random(size).randbytes(size), b"\xff" * size):
        write(store_name, data)
        with pytest.raises(shmtf.StoreError) as caught:
            Store.attach(store_name, readonly=readonly)
        assert type(caught.value) in (shmtf.StoreVersionError, shmtf.StoreCorruptError)
        assert read(store_name) == data
        assert store_name not in shmtf.list_stores()


def test_header_words(store_name: str, image: bytes) -> None:
    """Every bit of the first words, and every word replaced."""
    words = PAGE // 8 // 8  # more than the header has
    differ = []
    for index in range(words):
        old = image[8 * index : 8 * index + 8]
        changed = [
            bytes(8),
            b"\xff" * 8,
            *(bytes(b ^ (1 << k % 8) * (j == k // 8) for j, b in enumerate(old)) for k in range(64)),
        ]
        for new in changed:
            if new == old:
                continue
            write(store_name, image[: 8 * index] + new + image[8 * index + 8 :])
            try:
                with Store.attach(store_name) as store:
                    store.explain("map", "c")
                    differ.append(index)
            except shmtf.StoreError as error:
                assert type(error) in (shmtf.StoreVersionError, shmtf.StoreCorruptError)
                assert str(error)
    # the name of the store's bell, its age and its maker say nothing about where things are
    assert len(set(differ)) < words
    assert 0 not in differ
    assert 1 not in differ


def test_other_version(store_name: str, image: bytes) -> None:
    for version in (2, 99, 2**63):
        write(store_name, image[:8] + version.to_bytes(8, "little") + image[16:])
        with pytest.raises(shmtf.StoreVersionError) as caught:
            Store.attach(store_name)
        assert str(caught.value)


@pytest.mark.parametrize("readonly", [False, True])
def test_directory(store_name: str, readonly: bool) -> None:
    os.mkdir(path_of(store_name))
    with pytest.raises(shmtf.StoreVersionError):
        Store.attach(store_name, readonly=readonly)
    with pytest.raises(shmtf.StoreExistsError):
        Store.create(store_name, **SMALL)
    with pytest.raises(shmtf.StoreError):
        Store.unlink(store_name)
    assert os.path.isdir(path_of(store_name))


@pytest.mark.parametrize("readonly", [False, True])
def test_symbolic_link(new_name: Callable[[], str], readonly: bool) -> None:
    target, link = new_name(), new_name()
    Store.create(target, **SMALL).close()
    os.symlink(path_of(target), path_of(link))
    with pytest.raises(shmtf.StoreError):
        Store.attach(link, readonly=readonly)
    assert link not in shmtf.list_stores()
    os.unlink(path_of(link))


def test_socket(store_name: str) -> None:
    with socket.socket(socket.AF_UNIX) as s:
        s.bind(path_of(store_name))
        for readonly in (False, True):
            with pytest.raises(shmtf.StoreError):
                Store.attach(store_name, readonly=readonly)
        assert store_name not in shmtf.list_stores()


def test_garbage_is_in_nobodys_way(store_name: str) -> None:
    write(store_name, b"garbage")
    with pytest.raises(shmtf.StoreExistsError):
        Store.create(store_name, **SMALL)
    with pytest.raises(shmtf.StoreVersionError):
        Store.create(store_name, **SMALL, exist_ok=True)
    Store.unlink(store_name)
    Store.create(store_name, **SMALL).close()


def test_beyond_all_memory(store_name: str) -> None:
    """Refused when it is made, not by a SIGBUS at the first use."""
    status = os.statvfs("/dev/shm")
    total, before = status.f_blocks * status.f_frsize, status.f_bavail
    with pytest.raises(shmtf.StoreFullError) as caught:
        Store.create(store_name, max_frames=10**6, history=total // 10**7)  # of which each record takes 100 bytes
    assert caught.value.needed > total
    assert "max_frames" in str(caught.value)
    assert isinstance(caught.value, shmtf.StoreError)
    assert not os.path.exists(path_of(store_name))
    assert os.statvfs("/dev/shm").f_bavail >= before - 1024


def test_a_million_frames_in_a_small_shm(store_name: str, run_python: Callable) -> None:
    """The limit is the process' largest file, which the system answers like a full file system."""
    run_python(
        """
        import resource, signal, sys, shmtf
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (64 << 20, 64 << 20))
        for keywords in ({"max_frames": 10**6}, {"max_frames": 1024, "history": 100_000}, {"stream_bytes": 1 << 30}):
            try:
                shmtf.Store.create(sys.argv[1], **keywords)
            except shmtf.StoreFullError as error:
                assert error.needed > 64 << 20, error
            else:
                sys.exit(f"made {keywords}")
        with shmtf.Store.create(sys.argv[1]) as store:  # the default fits
            store.set_transforms([shmtf.Transform("map", f"f{i}", 1) for i in range(1000)])
            assert len(store.frames()) == 1001
        """,
        store_name,
    )


@pytest.mark.parametrize("seed", range(8))
def test_corrupted_contents(store_name: str, image: bytes, seed: int, run_python: Callable) -> None:
    """Behind a good header anything may be wrong.  In a process of its own, so that a crash is told from an error."""
    write(store_name, image)
    run_python(
        """
        import random, sys, shmtf
        name, seed = sys.argv[1], int(sys.argv[2])
        rng = random.Random(seed)
        path = "/dev/shm/" + name
        with open(path, "rb") as file:
            image = file.read()
        T = shmtf.Transform
        for readonly in (True, False):
            for _ in range(60):
                data = bytearray(image)
                for _ in range(rng.choice((1, 3, 100, 5000))):
                    at = rng.randrange(4096, len(data) - 8) & ~7
                    small = rng.randrange(256).to_bytes(8, "little")
                    data[at : at + 8] = rng.choice((rng.randbytes(8), bytes(8), b"\\xff" * 8, small))
                with open(path, "r+b") as file:
                    file.write(data)
                with shmtf.Store.attach(name, readonly=readonly) as store:
                    for call in (
                        lambda: store.lookup_transform("map", "c"),
                        lambda: store.lookup_transform("map", "b", 7),
                        lambda: store.lookup_latest_transform("c", "map").edges,
                        lambda: store.explain("map", "nobody"),
                        store.frames,
                        store.all_frames_as_yaml,
                        store.all_frames_as_dot,
                        lambda: store._records("a"),
                        lambda: store.children("map"),
                        lambda: store.wait_for_change(since=0, timeout=0),
                        lambda: store.wait_for_change("a", since=0, timeout=0),
                        store._writers,
                        store._check,
                        store.snapshot().frames,
                        lambda: store.set_transform(T("map", "a", 100), timeout=0.001),
                        lambda: store.set_transforms([T("map", "a", 101), T("x", "y", 5)], timeout=0.001),
                        lambda: store.remove_frame("b", timeout=0.001),
                        lambda: store.clear(timeout=0.001),
                    ):
                        try:
                            call()
                        except (shmtf.StoreError, shmtf.TransformException) as error:
                            str(error)
        """,
        store_name,
        str(seed),
    )
