# SPDX-License-Identifier: Apache-2.0
"""The reads that a Store and a Snapshot share, and the Snapshot."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeVar

from . import _core, _dump
from .errors import InvalidArgumentException, SnapshotExpiredError, TransformException

if TYPE_CHECKING:
    from types import TracebackType

    from .store import Store

__all__ = ["FrameInfo", "Snapshot"]

_T = TypeVar("_T")


@dataclass(frozen=True, slots=True)
class FrameInfo:
    """What the store knows of a frame.  Times are int nanoseconds."""

    name: str
    parent: str | None  #: of the newest record; None: a root
    is_static: bool
    n_records: int  #: that can be read now
    capacity: int  #: most that can be kept
    oldest: int | None  #: stamps; None without dynamic records
    newest: int | None
    arrival: int | None  #: CLOCK_REALTIME at which the newest record was written; None without records
    rate: float | None  #: records per second between oldest and newest; None with fewer than two
    age: float | None  #: seconds from `newest` to the time of the call; None without a stamp
    authority: str  #: who wrote the newest record
    version: int  #: commit of the newest record
    n_written: int  #: records written since the frame was made
    generation: int  #: lives of this id, counting removals

    @property
    def is_root(self) -> bool:
        """Whether it has no parent."""
        return self.parent is None


def _frame_info(raw: dict[str, Any], now: int) -> FrameInfo:
    n: int = raw["n_records"]
    dated = n > 0 and not raw["is_static"]
    span = raw["newest"] - raw["oldest"] if dated else 0
    return FrameInfo(
        name=raw["name"],
        parent=raw["parent"],
        is_static=raw["is_static"],
        n_records=n,
        capacity=raw["capacity"],
        oldest=raw["oldest"] if dated else None,
        newest=raw["newest"] if dated else None,
        arrival=raw["arrival"] if n else None,
        rate=(n - 1) * 1e9 / span if n > 1 and span > 0 else None,
        age=(now - raw["newest"]) / 1e9 if dated else None,
        authority=raw["authority"],
        version=raw["version"],
        n_written=raw["n_written"],
        generation=raw["generation"],
    )


class Reads(_core.Reader):
    """Reads made of the core's reads."""

    __slots__ = ()

    def _consistent(self, read: Callable[[Reads], _T]) -> _T:
        """Result of several reads of one commit."""
        raise NotImplementedError

    def explain(self, target: str, source: str, time: Any = None) -> TransformException | None:
        """Why lookup_transform(target, source, time) would fail: the exception, not raised.  None: it would not."""
        try:
            self.lookup_transform(target, source, time)
        except TransformException as why:
            return why.with_traceback(None)
        return None

    def latest_common_time(self, *frames: str) -> int | None:
        """The newest time at which all these frames can be transformed into each other, int nanoseconds.

        None: only static transforms join them, any time will do.  Raises LookupException, ConnectivityException.
        """
        if not frames:
            raise InvalidArgumentException(what="frames", hint="at least one frame name")
        first, *others = frames
        if len(others) < 2:
            return self._latest_common_time(first, others[0] if others else first)

        def read(reads: Reads) -> int | None:
            times = [reads._latest_common_time(first, other) for other in others]
            return min((t for t in times if t is not None), default=None)

        return self._consistent(read)

    def frame_info(self, name: str) -> FrameInfo:
        """Parent, records, rate, authority and age of a frame.  Raises LookupException."""
        return _frame_info(self._frame_info(name), _core.now())

    def children(self, name: str) -> list[str]:
        """Frames whose newest parent is `name`.  Raises LookupException."""

        def read(reads: Reads) -> list[str]:
            reads._frame_info(name)
            return [frame for frame in reads.frames() if reads.parent(frame) == name]

        return self._consistent(read)

    def chain(self, target: str, source: str, time: Any = None) -> list[str]:
        """The frames on the path from `target` to `source`, both included, at `time` (None: newest parents).

        Raises LookupException, ConnectivityException, ExtrapolationException.
        """
        if time is None:
            found = self.lookup_latest_transform(target, source)
        else:
            found = self.lookup_transform(target, source, time)
        parents = {child: parent for parent, child, _ in found.edges}
        down, up = [target], [source]
        for side in (down, up):
            while side[-1] in parents and len(side) <= len(parents):
                side.append(parents[side[-1]])
        return down + up[-2::-1]

    def all_frames_as_yaml(self) -> str:
        """Every frame that has a parent, as valid YAML with tf2's keys."""
        return _dump.as_yaml(self._all_infos())

    def all_frames_as_dot(self) -> str:
        """The tree as a Graphviz graph with tf2's labels."""
        return _dump.as_dot(self._all_infos())

    def _all_infos(self) -> list[FrameInfo]:
        now = _core.now()
        return self._consistent(lambda r: [_frame_info(r._frame_info(name), now) for name in r.frames()])


class Snapshot(_core.Snapshot, Reads):
    """One commit of a store: every read sees the same transforms, whoever writes meanwhile.

    It holds nothing and needs no release.  When the records of its commit have been overwritten, reads raise
    SnapshotExpiredError.  A timeout given to a read has no effect, since nothing can change.
    """

    _name: str

    def __new__(cls, store: Store) -> Snapshot:
        """The store at its last commit."""
        self = super().__new__(cls, store)
        self._name = store.name
        return self

    @property
    def name(self) -> str:
        """The store's name."""
        return self._name

    def _consistent(self, read: Callable[[Reads], _T]) -> _T:
        return read(self)

    def __enter__(self) -> Snapshot:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"<shmtf.Snapshot of {self._name!r}{', closed' if self.closed else f' at {self.version}'}>"


def consistent_read(store: Store, read: Callable[[Reads], _T], attempts: int = 64) -> _T:
    """`read` of a snapshot; of a new one if its records were overwritten meanwhile."""
    while True:
        try:
            return read(Snapshot(store))
        except SnapshotExpiredError:
            attempts -= 1
            if attempts == 0:
                raise
