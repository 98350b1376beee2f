# SPDX-License-Identifier: Apache-2.0
"""`shmtf list` and `shmtf rm`."""

from __future__ import annotations

import json
import os
import subprocess
import uuid
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

import shmtf

Run = Callable[..., subprocess.CompletedProcess[str]]
SHM = Path("/dev/shm")


def test_list(command: Run, live: shmtf.Store) -> None:
    row = next(line for line in command("shmtf", "list").stdout.splitlines() if line.startswith(live.name))
    assert " 11/64 " in row and " 0600 " in row
    assert f"({os.getpid()})" in row and "odometry (" in row
    found = next(s for s in json.loads(command("shmtf", "list", "--json").stdout) if s["name"] == live.name)
    assert found["frames"] == 11 and found["mode"] == 0o600
    assert {"odometry"} < {holder["name"] for holder in found["holders"]}
    assert os.getpid() in {holder["pid"] for holder in found["holders"]}


def test_rm_refuses_what_is_mapped(command: Run, live: shmtf.Store) -> None:
    done = command("shmtf", "rm", live.name, code=1)
    assert f"({os.getpid()})" in done.stderr and "--force" in done.stderr
    assert live.name in shmtf.list_stores()
    forced = command("shmtf", "rm", live.name, "--force").stdout
    assert f'removed "{live.name}", still mapped by' in forced and f"({os.getpid()})" in forced
    assert live.name not in shmtf.list_stores()
    live.lookup_latest_transform("map", "arm6")  # who has it keeps it


def test_rm_several(command: Run, new_name: Callable[[], str]) -> None:
    names = [new_name(), new_name()]
    for name in names:
        shmtf.Store.create(name, max_frames=4, history=2, stream_bytes=0).close()
    missing = new_name()
    done = command("shmtf", "rm", names[0], missing, names[1], code=1)
    assert [f'removed "{name}"' for name in names] == done.stdout.splitlines()
    assert f'there is no store "{missing}"' in done.stderr
    command("shmtf", "rm", "-f", missing)


def test_rm_leaves_what_is_no_store(command: Run, new_name: Callable[[], str]) -> None:
    path = SHM / new_name()
    path.write_bytes(b"somebody else's")
    command("shmtf", "rm", path.name, code=1)
    assert path.exists()
    command("shmtf", "rm", "--force", path.name)
    assert not path.exists()


@pytest.fixture
def bell() -> Iterator[Callable[[], Path]]:
    made: list[Path] = []

    def make() -> Path:
        made.append(SHM / f".shmtf-bell-{uuid.uuid4().hex}")
        made[-1].write_bytes(b"\0" * 4096)
        return made[-1]

    yield make
    for path in made:
        path.unlink(missing_ok=True)


def test_sweep(command: Run, store: shmtf.Store, bell: Callable[[], Path]) -> None:
    with pytest.raises(shmtf.TimeoutException):
        store.wait_for_change(timeout=0.01)  # makes the store's bell
    own = SHM / f".shmtf-bell-{store._info()['uuid']}"
    orphan, young = bell(), bell()
    for path in (own, orphan):
        os.utime(path, (1e9, 1e9))
    store.close()  # nobody maps it, its store is still there
    assert "removed" in command("shmtf", "rm", "--sweep").stdout
    assert own.exists()
    assert young.exists()
    assert not orphan.exists()


def test_other_peoples_files_are_no_stores(command: Run, new_name: Callable[[], str], store: shmtf.Store) -> None:
    """/dev/shm is full of them."""
    (SHM / new_name()).write_bytes(b"x" * 8192)
    (SHM / new_name()).write_bytes(b"")
    assert store.name in command("shmtf", "list").stdout
    other = new_name()
    shmtf.Store.create(other, max_frames=4, history=2, stream_bytes=0).close()
    asked = command("shmtf-dump", code=2)  # there are at least two stores: which one?
    assert "which store?" in asked.stderr
    assert len(asked.stderr.splitlines()) == 1
