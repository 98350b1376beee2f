# SPDX-License-Identifier: Apache-2.0
"""A store: one POSIX shared-memory segment, by name."""

from __future__ import annotations

import math
import time as _clock
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any, TypeVar

from . import _core, _files
from . import transform as _transform  # noqa: F401  the class that lookups return
from .errors import InvalidArgumentException, StoreExistsError, StoreNotFoundError
from .snapshot import Reads, Snapshot, consistent_read

if TYPE_CHECKING:
    from types import TracebackType
    from typing import Self

__all__ = ["Store"]

_T = TypeVar("_T")
_OTHERS_CREATION_S = 10.0  # how long exist_ok waits for a store that somebody else is making


class Store(_core.Store, Reads):
    """One robot's transform tree, shared by every process that attaches to the same name.

    Made by `Store.create` and `Store.attach`.  Usable by any number of threads at once, as a context manager (which
    closes it), across fork, and through pickle, which attaches to the same name.  Reading never waits for a writer.
    """

    _name: str
    _authority: str | None

    def __new__(cls, *args: Any, **kwargs: Any) -> Self:
        """Not this way."""
        raise TypeError("use shmtf.Store.create(name) or shmtf.Store.attach(name)")

    # ---- life ----

    @classmethod
    def create(
        cls,
        name: str,
        max_frames: int = 1024,
        history: int = 128,
        cache_time: float | None = 10.0,
        stream_bytes: int = 8 << 20,
        mode: int = 0o600,
        exist_ok: bool = False,
        authority: str | None = None,
        max_writers: int = 128,
    ) -> Self:
        """Make a store and attach to it.

        name: no '/', no leading '.', at most 200 bytes.  max_frames: frames that can exist at once.  history: records
        kept per frame at least, unless declared otherwise.  cache_time: seconds behind a frame's newest stamp that stay
        readable; None: all that the history holds.  stream_bytes: memory for streams and larger histories.  mode:
        permission bits.  exist_ok: attach if the name is taken, whatever that store's capacities.  authority: name of
        this writer, for people.  max_writers: threads of all processes that can write at once.

        All memory is reserved now.  Raises StoreExistsError, StoreFullError (not enough shared memory),
        InvalidArgumentException, StorePermissionError.
        """
        _files.check_name(name)
        capacities = _files.Capacities.check(
            cache_time=cache_time,
            max_frames=max_frames,
            history=history,
            stream_bytes=stream_bytes,
            max_writers=max_writers,
        )
        while True:
            try:
                _files.make(name, capacities, mode)
            except StoreExistsError:
                if not exist_ok:
                    raise
            try:
                return cls.attach(name, timeout=_OTHERS_CREATION_S if exist_ok else 0.0, authority=authority)
            except StoreNotFoundError:
                if not exist_ok:  # somebody unlinked it at once
                    raise

    @classmethod
    def attach(
        cls, name: str, readonly: bool = False, timeout: float | None = 0.0, authority: str | None = None
    ) -> Self:
        """Attach to an existing store.

        readonly: map it PROT_READ, which read permission suffices for; writes raise ReadOnlyStoreError.  timeout:
        seconds to wait for it to exist, None for ever.  authority: name of this writer, for people.

        The first call installs a handler of SIGBUS, for a file that somebody truncates while it is mapped: calls then
        raise StoreCorruptError.  What is not about a store goes to the handler that was there before.

        Raises StoreNotFoundError, StorePermissionError, StoreVersionError (no store, or another version of the format),
        StoreCorruptError.
        """
        _files.check_name(name)
        if timeout is not None and not timeout >= 0:
            raise InvalidArgumentException(
                what="timeout", value=timeout, hint="seconds, 0 or more; None waits for ever"
            )
        start = _clock.monotonic()
        pause = 0.001
        while True:
            try:
                return cls._open(name, bool(readonly), authority)
            except StoreNotFoundError as error:
                waited = _clock.monotonic() - start
                if timeout is not None and waited >= timeout:
                    error.waited = waited if timeout else None
                    raise
            _clock.sleep(pause if timeout is None else min(pause, max(0.0, timeout - waited)))
            pause = min(2 * pause, 0.02)

    @classmethod
    def _open(cls, name: str, readonly: bool, authority: str | None) -> Self:
        with _files.opened(name, readonly) as fd, _files.typed_errors(name):
            self = _core.Store.__new__(cls, fd, readonly, authority)
        self._name = name
        self._authority = authority
        return self

    @staticmethod
    def unlink(name: str) -> None:
        """Remove the name.  Attached processes keep their mapping.  Raises StoreNotFoundError, StorePermissionError."""
        _files.remove(name)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()

    def __reduce__(self) -> tuple[Any, ...]:
        return _attach_pickled, (type(self), self._name, self.readonly, self._authority)

    def __repr__(self) -> str:
        state = ", closed" if self.closed else ", readonly" if self.readonly else ""
        return f"<shmtf.Store {self._name!r}{state}>"

    @property
    def name(self) -> str:
        """The name it was attached by."""
        return self._name

    # ---- reads and waits ----

    def snapshot(self) -> Snapshot:
        """The store at its last commit, to read several things of one world.  Costs nothing, needs no release."""
        return Snapshot(self)

    def _consistent(self, read: Callable[[Reads], _T]) -> _T:
        return consistent_read(self, read)

    def wait_for_change(
        self, frames: str | Iterable[str] | None = None, *, since: int | None = None, timeout: float | None = None
    ) -> int:
        """Sleep until a commit newer than `since` touches one of the frames (None: any commit).

        since: a version, normally what the last call returned, so that nothing in between is missed; None: now.
        timeout: seconds, None for ever.  A frame that does not exist yet counts as touched when it appears.  Returns
        the commit's version.  Raises TimeoutException, whose `version` is the next `since`.
        """
        names = () if frames is None else (frames,) if isinstance(frames, str) else tuple(frames)
        if frames is not None and not names:
            raise InvalidArgumentException(what="frames", hint="at least one name; None waits for any commit")
        return self._wait_for_change(names, since, timeout)

    # ---- frames ----

    def declare_frame(
        self, child: str, *, history: int | None = None, rate: float | None = None, timeout: float | None = 1.0
    ) -> None:
        """Give a frame a ring of its own size, before its first record.

        history: records to keep at least; or rate: records per second, to keep for cache_time.  Raises
        InvalidArgumentException if the frame has another size already, StoreFullError, BusyError.
        """
        if (history is None) == (rate is None):
            raise InvalidArgumentException(what="history", value=history, hint="give one of history= and rate=")
        if rate is not None:
            cache_time_ns = self._info()["cache_time_ns"]
            if cache_time_ns is None:
                raise InvalidArgumentException(
                    what="rate", value=rate, hint="records never expire here (cache_time=None): give history="
                )
            if not 0 < rate < math.inf:
                raise InvalidArgumentException(what="rate", value=rate, hint="records per second, more than 0")
            history = math.ceil(rate * cache_time_ns / 1e9) + 1
        if history is None or not 0 < history < 1 << 32:
            raise InvalidArgumentException(what="history", value=history, hint="a number of records, more than 0")
        self._declare_frame(child, history, timeout=timeout)


def _attach_pickled(cls: type[Store], name: str, readonly: bool, authority: str | None) -> Store:
    return cls.attach(name, readonly=readonly, authority=authority)
