# SPDX-License-Identifier: Apache-2.0
"""Segments as files: their names, making one, opening one, removing one."""

from __future__ import annotations

import contextlib
import errno
import math
import operator
import os
import stat
import uuid
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import posix_ipc

from . import _core, _failures  # noqa: F401  _failures: what the core raises
from ._detail import Detail
from .errors import (
    InvalidArgumentException,
    StoreError,
    StoreExistsError,
    StoreNotFoundError,
    StorePermissionError,
    StoreVersionError,
)

DIRECTORY = "/dev/shm"  # where POSIX shared memory lives on Linux
NAME_LIMIT = 200  # bytes; leaves room for the names derived from it

# open(O_TMPFILE) or linkat() cannot do it here: an old kernel, no /proc, a file system without either
_NOT_SUPPORTED = {errno.EOPNOTSUPP, errno.EISDIR, errno.ENOENT, errno.EINVAL, errno.EXDEV, errno.EPERM, errno.ENOSYS}


def check_name(name: str) -> str:
    """The store name, or an exception."""
    if not isinstance(name, str):
        raise TypeError(f"a store name must be a str, not {name!r}")
    hint = None
    if not name:
        hint = "a store name has at least one character"
    elif "/" in name or "\0" in name:
        hint = "a store name has no '/' and no NUL character"
    elif name.startswith("."):
        hint = "a store name has no leading '.'"
    elif len(name.encode("utf-8", "surrogatepass")) > NAME_LIMIT:
        hint = f"a store name has at most {NAME_LIMIT} bytes of UTF-8"
    elif any("\ud800" <= c <= "\udfff" for c in name):
        hint = "it has a lone surrogate, which is not valid UTF-8"
    if hint:
        raise InvalidArgumentException(what="store name", value=name, hint=hint)
    return name


@contextlib.contextmanager
def typed_errors(name: str) -> Iterator[None]:
    """What posix_ipc and the system raise, as StoreError."""
    try:
        yield
    except Detail as error:
        error.store = name
        raise
    except (posix_ipc.ExistentialError, FileNotFoundError, FileExistsError) as error:
        exists = isinstance(error, FileExistsError) or "already" in str(error)
        if exists:
            raise StoreExistsError(store=name, what="the name is taken") from None
        raise StoreNotFoundError(store=name, what="there is no such store") from None
    except (posix_ipc.PermissionsError, PermissionError):
        raise StorePermissionError(store=name, what="permission denied") from None
    except ValueError:  # posix_ipc's word for what shm_open() and shm_unlink() find unfit, such as a directory
        raise StoreVersionError(store=name, what="it is no shared memory object") from None
    except (posix_ipc.Error, OSError) as error:
        raise StoreError(store=name, what=str(error), sys_errno=getattr(error, "errno", None)) from error


def _open(name: str, readonly: bool, flags: int = 0, mode: int = 0o600) -> int:
    return int(posix_ipc.SharedMemory("/" + name, flags=flags, mode=mode, read_only=readonly).fd)


@contextlib.contextmanager
def opened(name: str, readonly: bool) -> Iterator[int]:
    """A descriptor of an existing segment; posix_ipc opens it and never removes it."""
    with typed_errors(name):
        mode = os.lstat(os.path.join(DIRECTORY, name)).st_mode
        if not stat.S_ISREG(mode):  # opening a FIFO would wait for its writer
            raise StoreVersionError(what="it is no shared memory object")
        fd = _open(name, readonly)
    try:
        yield fd
    finally:
        os.close(fd)


@dataclass(frozen=True, slots=True)
class Capacities:
    """The arguments of _core.format_fd."""

    max_frames: int
    history: int
    cache_time_ns: int
    stream_bytes: int
    max_writers: int

    @classmethod
    def check(cls, *, cache_time: float | None, **counts: Any) -> Capacities:
        """Sorts out what does not fit the core's integers; the core checks the ranges."""
        for what, value in counts.items():
            bits = 64 if what == "stream_bytes" else 32
            if not 0 <= operator.index(value) < 1 << bits:
                raise InvalidArgumentException(what=what, value=value, hint=f"0 or more, below 2**{bits}")
        if cache_time is None:
            ns = -1
        elif not 0 < cache_time < 9e9:
            raise InvalidArgumentException(
                what="cache_time", value=cache_time, hint="seconds, more than 0; None keeps all that fits the history"
            )
        else:
            ns = math.ceil(cache_time * 1e9)
        return cls(cache_time_ns=ns, **{what: operator.index(value) for what, value in counts.items()})

    def format(self, fd: int) -> None:
        """Lay an empty store into the file."""
        counts = (self.max_frames, self.history, self.cache_time_ns, self.stream_bytes, self.max_writers)
        try:
            _core.format_fd(fd, *counts)
        except InvalidArgumentException as error:
            error.value = getattr(self, error.what or "", None)
            raise


def make(name: str, capacities: Capacities, mode: int) -> None:
    """A whole store, and then its name: whoever finds the name finds a store.  Raises StoreExistsError."""
    with typed_errors(name):
        if os.path.lexists(os.path.join(DIRECTORY, name)):  # before the work is done in vain
            raise FileExistsError
        directory = os.open(DIRECTORY, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            if not _make_unnamed(directory, name, capacities, mode):
                _make_hidden(directory, name, capacities, mode)
        finally:
            os.close(directory)


def _make_unnamed(directory: int, name: str, capacities: Capacities, mode: int) -> bool:
    """A maker that dies half-way leaves nothing.  False: this system cannot do it, and nothing was made."""
    try:
        fd = os.open(DIRECTORY, os.O_TMPFILE | os.O_RDWR | os.O_CLOEXEC, 0o600)
    except OSError as error:
        if error.errno in _NOT_SUPPORTED:
            return False
        raise
    try:
        capacities.format(fd)
        os.fchmod(fd, mode)  # the umask does not count
        # a directory descriptor makes Python call linkat(AT_SYMLINK_FOLLOW) instead of link()
        os.link(f"/proc/self/fd/{fd}", name, src_dir_fd=directory, dst_dir_fd=directory, follow_symlinks=True)
    except OSError as error:
        if error.errno in _NOT_SUPPORTED:
            return False
        raise
    finally:
        os.close(fd)
    return True


def _make_hidden(directory: int, name: str, capacities: Capacities, mode: int) -> None:
    """Under a hidden name first; a maker that dies half-way leaves that one."""
    hidden = f".shmtf-new-{uuid.uuid4().hex}"
    fd = _open(hidden, False, posix_ipc.O_CREX)
    try:
        capacities.format(fd)
        os.fchmod(fd, mode)
        os.link(hidden, name, src_dir_fd=directory, dst_dir_fd=directory, follow_symlinks=False)
    finally:
        os.close(fd)
        posix_ipc.unlink_shared_memory("/" + hidden)


def remove(name: str) -> None:
    """The name and the store's bell.  What is no store is removed too, if it is a shared memory object."""
    check_name(name)
    # garbage has no bell, and who may not look may still be allowed to remove
    with contextlib.ExitStack() as stack:
        fd = None
        with contextlib.suppress(StorePermissionError, StoreVersionError):
            fd = stack.enter_context(opened(name, True))
        if fd is not None:
            _remove_bell(fd)  # first: only the store tells its name, and who dies here leaves a store to remove
        with typed_errors(name):
            posix_ipc.unlink_shared_memory("/" + name)
        if fd is not None:
            with contextlib.suppress(StoreError):
                _remove_bell(fd)  # a writer may have made one meanwhile, but makes none for a store without a name


def _remove_bell(fd: int) -> None:
    try:
        _core.unlink_bell_fd(fd)
    except StoreError as error:
        if error.sys_errno != errno.ENODEV:  # of a store
            raise
