# SPDX-License-Identifier: Apache-2.0
"""What a store holds, collected beside its running writers: one commit where possible, and an answer in any case."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, TypeVar

from ._holders import process_state

if TYPE_CHECKING:
    from ..snapshot import FrameInfo, Reads
    from ..store import Store

_T = TypeVar("_T")
_ATTEMPTS = 3


@dataclass(frozen=True)
class Writer:
    """A writer slot."""

    slot: int
    name: str
    pid: int
    alive: bool  #: holds its kernel lock
    process: str  #: running, stopped, gone or unknown
    state: str  #: of its last transaction: active, prepared, committed
    transaction: int
    started: int


@dataclass(frozen=True)
class Flag:
    """The writer flag of a frame."""

    owner: Writer | None  #: None: free
    transaction: int = 0

    @property
    def stuck(self) -> str:
        """dead or stopped, if its owner is; else empty."""
        if self.owner is None:
            return ""
        return "dead" if not self.owner.alive else "stopped" if self.owner.process == "stopped" else ""


@dataclass(frozen=True)
class Frame:
    """A frame, and what was read beside it."""

    info: FrameInfo
    flag: Flag
    words: dict[str, Any]
    records: list[dict[str, Any]]

    @property
    def kind(self) -> str:
        if self.info.is_static:
            return "static"
        return "root" if self.info.parent is None else "dynamic"


@dataclass(frozen=True)
class Report:
    """A store at one moment."""

    name: str
    now: int
    store: dict[str, Any]
    one_commit: bool  #: whether all frames were read at one commit
    commit: int
    writers: list[Writer]
    frames: list[Frame]
    unread: list[str] = field(default_factory=list)  #: frames that changed faster than they could be read


def collect(store: Store, only: str | None = None, n_records: int = 1) -> Report:
    """The store now.  only: this frame alone, LookupException if it does not exist."""
    from .. import SnapshotExpiredError, now

    if only is not None:
        store.frame_info(only)

    def names(reads: Reads) -> list[str]:
        return reads.frames() if only is None else [only]

    one_commit = True
    unread: list[str] = []
    for _ in range(_ATTEMPTS):
        snapshot = store.snapshot()
        try:
            infos = [(snapshot.frame_info(name), _records(snapshot, name, n_records)) for name in names(snapshot)]
            commit = snapshot.version
            break
        except SnapshotExpiredError:  # rings turned meanwhile
            continue
    else:
        infos, unread = _frame_by_frame(store, names(store), n_records)
        one_commit, commit = False, store.version
    writers = [_writer(raw) for raw in store._writers()]
    frames = [_with_words(store, writers, *pair) for pair in infos]
    return Report(store.name, now(), store._info(), one_commit, commit, writers, frames, unread)


def _records(reads: Reads, name: str, n_records: int) -> list[dict[str, Any]]:
    return reads._records(name, n_records) if n_records else []


def _persistent(read: Callable[[], _T]) -> _T | None:
    """The result of a read that fails only while the frame changes; None if it was removed or never stands still."""
    from .. import LookupException, SnapshotExpiredError

    for _ in range(_ATTEMPTS):
        try:
            return read()
        except LookupException:
            return None
        except SnapshotExpiredError:
            continue
    return None


def _frame_by_frame(
    store: Store, names: Sequence[str], n_records: int
) -> tuple[list[tuple[FrameInfo, list[dict[str, Any]]]], list[str]]:
    found, unread = [], []
    for name in names:
        info = _persistent(lambda name=name: store.frame_info(name))  # type: ignore[misc]
        records = _persistent(lambda name=name: _records(store, name, n_records))  # type: ignore[misc]
        if info is not None and records is not None:
            found.append((info, records))
        elif store.frame_exists(name):
            unread.append(name)
    return found, unread


def _writer(raw: dict[str, Any]) -> Writer:
    return Writer(
        slot=raw["slot"],
        name=raw["name"],
        pid=raw["pid"],
        alive=raw["alive"],
        process=process_state(raw["pid"], raw["started"]),
        state=raw["state"],
        transaction=raw["transaction"],
        started=raw["started"],
    )


def _with_words(store: Store, writers: list[Writer], info: FrameInfo, records: list[dict[str, Any]]) -> Frame:
    words = _persistent(lambda: store._frame_words(info.name)) or {}
    if not words.get("locked"):
        return Frame(info, Flag(None), words, records)
    slot, alive = words["owner_slot"], words["owner_alive"]
    owner = next((w for w in writers if w.slot == slot and w.alive == alive), None)
    if owner is None:  # it came or went in between, or its slot has a new owner
        owner = Writer(slot, "?", 0, alive, "unknown", "?", words["owner_transaction"], 0)
    return Frame(info, Flag(owner, words["owner_transaction"]), words, records)


# ---- as data ----


def as_data(report: Report, records: bool) -> dict[str, Any]:
    """For JSON.  Times are int nanoseconds, durations float seconds; null: does not apply."""
    cache_time_ns = report.store["cache_time_ns"]
    return {
        "shmtf_dump": 1,
        "name": report.name,
        "now": report.now,
        "commits": report.commit,
        "one_commit": report.one_commit,
        "store": {
            **{
                key: value for key, value in report.store.items() if key not in ("readonly", "version", "cache_time_ns")
            },
            "cache_time": None if cache_time_ns is None else cache_time_ns / 1e9,
        },
        "writers": [{**vars(writer)} for writer in report.writers],
        "frames": [_frame_data(frame, records) for frame in report.frames],
        "unread": report.unread,
    }


def _frame_data(frame: Frame, records: bool) -> dict[str, Any]:
    info = frame.info
    data: dict[str, Any] = {
        "name": info.name,
        "parent": info.parent,
        "kind": frame.kind,
        "n_records": info.n_records,
        "capacity": info.capacity,
        "oldest": info.oldest,
        "newest": info.newest,
        "arrival": info.arrival,
        "rate": info.rate,
        "age": info.age,
        "authority": info.authority,
        "version": info.version,
        "n_written": info.n_written,
        "generation": info.generation,
        "translation": list(frame.records[0]["translation"]) if frame.records else None,
        "rotation": list(frame.records[0]["rotation"]) if frame.records else None,
        "flag": None,
        "words": {key: value for key, value in frame.words.items() if not key.startswith(("owner", "locked"))},
    }
    if frame.flag.owner is not None:
        owner = frame.flag.owner
        data["flag"] = {
            "slot": owner.slot,
            "name": owner.name,
            "pid": owner.pid,
            "alive": owner.alive,
            "process": owner.process,
            "transaction": frame.flag.transaction,
        }
    if records:
        data["records"] = [
            {**r, "translation": list(r["translation"]), "rotation": list(r["rotation"])} for r in frame.records
        ]
    return data
