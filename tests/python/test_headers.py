# SPDX-License-Identifier: Apache-2.0
"""Every word of the header made bad, and files of every other kind: refused, and the refusal names the reason.

Tier: test.
"""

from __future__ import annotations

import os
import socket
from collections.abc import Callable
from pathlib import Path

import pytest

import shmtf
from shmtf import Store

from .conftest import SMALL, path_of, write

# Every number of the header: what each refusal names.  The places are those of native/LAYOUT.md.
HEADER = [
    "magic",
    "format",
    "fingerprint",
    "size_bytes",
    "uuid",
    "uuid",
    "created_ns",
    "creator_pid",
    "max_frames",
    "history",
]
HEADER += ["cache_time_ns", "stream_bytes", "max_writers", "n_buckets", "n_chunks", "off_writers", "off_authorities"]
HEADER += ["off_buckets", "off_frames", "off_names", "off_inline", "off_chunks", "off_arena"]
TOO_MUCH = {"max_frames": 1 << 24, "history": 3932161, "stream_bytes": (1 << 40) + 1, "max_writers": 1024}
NAMED = {"magic": "magic", "format": "format version", "fingerprint": "layout fingerprint", "size_bytes": "size"}
ABANDONED = "abandoned by its creator half-way"


def bad_headers() -> list[tuple[str, int, str]]:
    """(field, its new value or, below 0, what to add to the old one, what the error names)."""
    cases = []
    for field in HEADER:
        if field in ("uuid", "created_ns", "creator_pid", "cache_time_ns"):  # any value is a good one
            continue
        bad = [0, (1 << 64) - 1, 1 << 63]
        if field not in ("history", "stream_bytes"):  # of which one less rounds up to the same
            bad.append(-1)
        for value in [*bad, TOO_MUCH[field]] if field in TOO_MUCH else bad:
            what = NAMED.get(field, "geometry")
            if field in TOO_MUCH and value >= 0 and (value != 0 or field != "stream_bytes"):
                what = field
            if field == "format" and value <= 0:  # as if it were never published
                what = ABANDONED
            cases.append((field, value, what))
    return cases


@pytest.mark.parametrize("readonly", [False, True])
@pytest.mark.parametrize(("field", "value", "what"), bad_headers())
def test_bad_header(store_name: str, image: bytes, field: str, value: int, what: str, readonly: bool) -> None:
    """Refused with a reason that names the word."""
    at = 8 * HEADER.index(field)
    old = int.from_bytes(image[at : at + 8], "little")
    new = (old + value if value < 0 else value).to_bytes(8, "little")
    write(store_name, image[:at] + new + image[at + 8 :])
    with pytest.raises((shmtf.StoreVersionError, shmtf.StoreCorruptError)) as caught:
        Store.attach(store_name, readonly=readonly)
    assert caught.value.what == what
    assert what in str(caught.value)
    foreign = what in ("magic", "format version", "layout fingerprint")
    assert type(caught.value) is (shmtf.StoreVersionError if foreign else shmtf.StoreCorruptError)


def test_there_are_many_bad_headers() -> None:
    cases = bad_headers()
    assert len(cases) >= 60
    assert {field for field, _, _ in cases} == set(HEADER) - {"uuid", "created_ns", "creator_pid", "cache_time_ns"}


@pytest.mark.parametrize("readonly", [False, True])
def test_fifo(store_name: str, readonly: bool) -> None:
    """Opening it does not wait for a writer."""
    os.mkfifo(path_of(store_name))
    with pytest.raises(shmtf.StoreError):
        Store.attach(store_name, readonly=readonly)
    assert store_name not in shmtf.list_stores()


@pytest.mark.parametrize("readonly", [False, True])
def test_not_in_shared_memory(image: bytes, readonly: bool, tmp_path: Path) -> None:
    """A whole store elsewhere: its locks and mappings cannot be relied on."""
    path = tmp_path / "store"
    path.write_bytes(image)
    if os.statvfs(path).f_fsid == os.statvfs("/dev/shm").f_fsid:
        pytest.skip("temporary files are in shared memory here")
    fd = os.open(path, os.O_RDWR)
    try:
        with pytest.raises(shmtf.StoreVersionError) as caught:
            shmtf._core.Store(fd, readonly)
        assert caught.value.what == "not a regular file in shared memory (tmpfs)"
    finally:
        os.close(fd)


@pytest.mark.parametrize("kind", ["pipe", "socket", "directory", "device", "closed", "memory of another kind"])
def test_descriptor_of_something_else(kind: str) -> None:
    fds = [-1]
    if kind == "pipe":
        fds = list(os.pipe())
    elif kind == "socket":
        fds = [s.detach() for s in socket.socketpair()]
    elif kind != "closed":
        what = {"directory": "/dev/shm", "device": "/dev/zero"}
        fds = [os.open(what[kind], os.O_RDONLY) if kind in what else os.memfd_create("other")]
    try:
        with pytest.raises(shmtf.StoreError) as caught:
            shmtf._core.Store(fds[0], True)
        assert caught.value.what
    finally:
        for fd in fds:
            if fd >= 0:
                os.close(fd)


def test_other_user_may_not_read(store_name: str, run_python: Callable) -> None:
    """A store of mode 0600 and another user: a permission error, and nothing else is learnt."""
    if os.geteuid() != 0:
        pytest.skip("only root can become another user")
    Store.create(store_name, **SMALL).close()
    run_python(
        """
        import os, sys, shmtf
        shmtf.Store, shmtf.Transform, shmtf.StorePermissionError  # loaded while this may still read its files
        os.setuid(65534)
        for readonly in (True, False):
            try:
                shmtf.Store.attach(sys.argv[1], readonly=readonly)
            except shmtf.StorePermissionError:
                continue
            sys.exit("attached")
        assert sys.argv[1] not in shmtf.list_stores()
        """,
        store_name,
    )
