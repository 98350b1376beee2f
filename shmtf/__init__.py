# SPDX-License-Identifier: Apache-2.0
"""shmtf: a robot's transform tree in one POSIX shared-memory segment.

    import shmtf

    store = shmtf.Store.create("robot", exist_ok=True)
    store.set_transform(shmtf.Transform("map", "base", translation=(1.0, 2.0, 0.0)))
    T = store.lookup_latest_transform("map", "base")  # in any process: T_map_base, p_map = T.apply(p_base)

Target first, then source; metres, radians; quaternions x y z w; stamps are int nanoseconds.

The names below are loaded when they are first used, so that tools which need none of them start without numpy.
"""

from __future__ import annotations

from importlib import import_module as _import_module
from typing import TYPE_CHECKING as _TYPE_CHECKING
from typing import Any as _Any

__version__ = "0.1.0"

try:
    from . import _core
except ImportError as _error:
    raise ImportError(
        f"shmtf was imported from {__path__[0]}, which has no compiled core that this Python can load ({_error}). "
        "If that is the source tree, its folder hides the installed package: start Python from another directory, or "
        "install for development with `pip install -e .`"
    ) from _error
if _core.__version__ != __version__:
    raise ImportError(
        f"shmtf {__version__} found the compiled core of version {_core.__version__} at {_core.__file__}: "
        "install the package anew"
    )

if _TYPE_CHECKING:
    from ._directory import Holder, StoreInfo, list_stores, store_info
    from ._time import from_seconds, now, to_seconds
    from .errors import (
        BackwardExtrapolationException,
        BackwardExtrapolationTimeout,
        BusyError,
        ClosedError,
        ConflictError,
        ConnectivityException,
        ConnectivityTimeout,
        CycleError,
        ExtrapolationException,
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
        TransformException,
    )
    from .snapshot import FrameInfo, Snapshot
    from .store import Store
    from .transform import Transform

_HOMES = {
    "Holder": "_directory",
    "StoreInfo": "_directory",
    "list_stores": "_directory",
    "store_info": "_directory",
    "from_seconds": "_time",
    "now": "_time",
    "to_seconds": "_time",
    "FrameInfo": "snapshot",
    "Snapshot": "snapshot",
    "Store": "store",
    "Transform": "transform",
}

__all__ = [
    "BackwardExtrapolationException",
    "BackwardExtrapolationTimeout",
    "BusyError",
    "ClosedError",
    "ConflictError",
    "ConnectivityException",
    "ConnectivityTimeout",
    "CycleError",
    "ExtrapolationException",
    "ForwardExtrapolationException",
    "ForwardExtrapolationTimeout",
    "FrameInfo",
    "Holder",
    "InvalidArgumentException",
    "LookupException",
    "LookupTimeout",
    "NoDataForExtrapolationException",
    "NoDataTimeout",
    "OldDataError",
    "ReadOnlyStoreError",
    "Snapshot",
    "SnapshotExpiredError",
    "Store",
    "StoreCorruptError",
    "StoreError",
    "StoreExistsError",
    "StoreFullError",
    "StoreInfo",
    "StoreNotFoundError",
    "StoreNotReadyError",
    "StorePermissionError",
    "StoreVersionError",
    "TimeoutException",
    "Transform",
    "TransformException",
    "__version__",
    "from_seconds",
    "list_stores",
    "now",
    "store_info",
    "to_seconds",
]


def __getattr__(name: str) -> _Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(_import_module(f"{__name__}.{_HOMES.get(name, 'errors')}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
