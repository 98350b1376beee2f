# SPDX-License-Identifier: Apache-2.0
"""Which stores there are, and who uses them."""

from __future__ import annotations

import os
from dataclasses import dataclass

from . import _core
from ._files import DIRECTORY, check_name, opened, typed_errors
from .errors import StoreError

__all__ = ["Holder", "StoreInfo", "list_stores", "store_info"]


def list_stores() -> list[str]:
    """Names of the stores on this machine that this user may read, sorted."""
    names = []
    try:
        entries = list(os.scandir(DIRECTORY))
    except OSError:
        return []
    for entry in entries:
        if entry.name.startswith(".") or not entry.is_file(follow_symlinks=False):
            continue
        try:
            with opened(entry.name, True) as fd:
                _core.Store(fd, True).close()
        except StoreError:
            continue
        names.append(entry.name)
    return sorted(names)


@dataclass(frozen=True, slots=True)
class Holder:
    """A process that has the store mapped."""

    pid: int
    name: str


@dataclass(frozen=True, slots=True)
class StoreInfo:
    """A store seen from outside."""

    name: str
    size_bytes: int
    mode: int  #: permission bits
    uid: int  #: of the owner
    created: int  #: CLOCK_REALTIME, int nanoseconds
    format: int
    uuid: str
    version: int  #: commits so far
    n_frames: int
    max_frames: int
    history: int
    cache_time: float | None  #: seconds; None: records never expire
    stream_bytes: int
    max_writers: int
    holders: tuple[Holder, ...]  #: those that this user may see


def _holders(name: str) -> tuple[Holder, ...]:
    import psutil

    path = os.path.join(DIRECTORY, name)
    found = []
    for process in psutil.process_iter(["pid", "name"]):
        try:
            if any(region.path == path for region in process.memory_maps()):
                found.append(Holder(process.info["pid"], process.info["name"] or ""))
        except psutil.Error:  # gone, or another user's
            continue
    return tuple(found)


def store_info(name: str) -> StoreInfo:
    """Capacities, use and holders of a store.  Raises StoreNotFoundError and other StoreErrors."""
    holders = _holders(check_name(name))  # before this process maps it too
    with opened(name, True) as fd, typed_errors(name):
        status = os.fstat(fd)
        store = _core.Store(fd, True)
        raw, frames = store._info(), store.frames()
        store.close()
    cache_time = raw["cache_time_ns"]
    return StoreInfo(
        name=name,
        size_bytes=raw["size_bytes"],
        mode=status.st_mode & 0o7777,
        uid=status.st_uid,
        created=raw["created"],
        format=raw["format"],
        uuid=raw["uuid"],
        version=raw["version"],
        n_frames=len(frames),
        max_frames=raw["max_frames"],
        history=raw["history"],
        cache_time=None if cache_time is None else cache_time / 1e9,
        stream_bytes=raw["stream_bytes"],
        max_writers=raw["max_writers"],
        holders=holders,
    )
