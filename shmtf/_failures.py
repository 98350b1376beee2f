# SPDX-License-Identifier: Apache-2.0
"""Failures of the core -> exceptions."""

from __future__ import annotations

import contextlib
import errno
from typing import Any

from . import _core
from ._detail import Detail
from .errors import (
    BackwardExtrapolationException,
    BackwardExtrapolationTimeout,
    BusyError,
    ClosedError,
    ConflictError,
    ConnectivityException,
    ConnectivityTimeout,
    CycleError,
    ForwardExtrapolationException,
    ForwardExtrapolationTimeout,
    InvalidArgumentException,
    LookupException,
    LookupTimeout,
    NoDataForExtrapolationException,
    NoDataTimeout,
    OldDataError,
    ReadOnlyStoreError,
    SnapshotExpiredError,
    StoreCorruptError,
    StoreError,
    StoreExistsError,
    StoreFullError,
    StoreNotFoundError,
    StoreNotReadyError,
    StorePermissionError,
    StoreVersionError,
    TimeoutException,
)

_BY_STATUS: dict[str, type[Detail]] = {
    "LOOKUP": LookupException,
    "CONNECTIVITY": ConnectivityException,
    "BACKWARD": BackwardExtrapolationException,
    "FORWARD": ForwardExtrapolationException,
    "NO_DATA": NoDataForExtrapolationException,
    "INVALID_ARGUMENT": InvalidArgumentException,
    "CYCLE": CycleError,
    "OLD_DATA": OldDataError,
    "EXISTS": StoreExistsError,
    "NOT_FOUND": StoreNotFoundError,
    "NOT_READY": StoreNotReadyError,
    "VERSION": StoreVersionError,
    "CORRUPT": StoreCorruptError,
    "FULL": StoreFullError,
    "READ_ONLY": ReadOnlyStoreError,
    "BUSY": BusyError,
    "CONFLICT": ConflictError,
    "SNAPSHOT_EXPIRED": SnapshotExpiredError,
    "CLOSED": ClosedError,
    "TIMEOUT": TimeoutException,
}

_AFTER_TIMEOUT: dict[type[Detail], type[Detail]] = {
    LookupException: LookupTimeout,
    ConnectivityException: ConnectivityTimeout,
    ForwardExtrapolationException: ForwardExtrapolationTimeout,
    BackwardExtrapolationException: BackwardExtrapolationTimeout,
    NoDataForExtrapolationException: NoDataTimeout,
}


def _make(status: str, fields: dict[str, Any]) -> Detail:
    """The exception for a status of the core and its fields."""
    cls = _BY_STATUS.get(status, StoreError)
    if fields.get("sys_errno") in (errno.EACCES, errno.EPERM) and cls is StoreError:
        cls = StorePermissionError
    if fields.pop("timed_out", False):
        cls = _AFTER_TIMEOUT.get(cls, cls)
    store = fields.pop("store", None)
    error = cls(**fields)
    if store is not None:
        error.store = getattr(store, "name", None)
        with contextlib.suppress(Detail):  # what the store does not tell is left out
            _ask(store, error)
    return error


def _ask(store: _core.Reader, error: Detail) -> None:
    """Adds what helps a reader of the message and only the store knows."""
    if isinstance(error, LookupException):
        error._known = tuple(store.frames())
    elif isinstance(error, ConnectivityException) and error.target and error.source:
        error.edge = None  # the core puts the two frames there
        roots = _root(store, error.target), _root(store, error.source)
        error.roots = roots if roots[0] != roots[1] else None


def _root(store: _core.Reader, frame: str) -> str:
    for _ in range(1000):
        above = store.parent(frame)
        if above is None:
            break
        frame = above
    return frame


_core.set_error_factory(_make)
