# SPDX-License-Identifier: Apache-2.0
"""Histories as Python sees them: read from a recorder's log, or written by hand for a checker's own tests.

The format is that of history.h, whose static assertions name this file.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

MAGIC = 0x3179726F74736968
HEADER_BYTES = 4096
MOST_BUFFERS = 32
CONTROL = struct.Struct(f"<QQQqQQQQQQ{MOST_BUFFERS}Q")
ENTRY = struct.Struct("<QQQQQqddHHHHHHI")
ITEM = struct.Struct("<HHIQQQqdddd")

SET, TRANSFER, REMOVE, CLEAR, LATEST, AT, COMMON, EXISTS, PARENT, RECORDS, FRAMES, SNAPSHOT = range(12)
COMMITTED, IN_SNAPSHOT, KEEP_STATIC, STATIC, VERSION = 1, 2, 4, 8, 16
WORLD, FIRST_GROUP, GROUP, FIRST_BANK, BANK, FIRST_FREE, FREE = 0, 1, 16, 17, 8, 25, 12
N_NAMES = FIRST_FREE + FREE
OK, LOOKUP, CONNECTIVITY, BACKWARD, FORWARD, NO_DATA, INVALID, CYCLE, OLD_DATA = range(9)
CORRUPT, BUSY, CONFLICT, EXPIRED, PENDING = 13, 16, 17, 18, 255


@dataclass
class Item:
    child: int = 0
    parent: int = 0
    flags: int = 0
    child_handle: int = 0
    parent_handle: int = 0
    version: int = 0
    stamp: int = 0
    x: float = 0.0
    y: float = 0.0
    seen_x: float = 0.0
    seen_y: float = 0.0


@dataclass
class Entry:
    kind: int
    begin: int
    end: int  # 0: it never returned
    version: int = 0
    low: int = 0
    high: int = 0
    time: int = 0
    x: float = 0.0
    y: float = 0.0
    status: int = OK
    flags: int = 0
    target: int = 0
    source: int = 0
    process: int = 0
    items: list[Item] = field(default_factory=list)


def unpack_entry(data: bytes, at: int) -> tuple[Entry, int]:
    begin, end, version, low, high, time, x, y, kind, status, flags, n, target, source, process = ENTRY.unpack_from(
        data, at
    )
    at += ENTRY.size
    items = [Item(*ITEM.unpack_from(data, at + i * ITEM.size)) for i in range(n)]
    entry = Entry(kind, begin, end, version, low, high, time, x, y, status, flags, target, source, process, items)
    return entry, at + n * ITEM.size


def read(path: Path) -> Iterator[Entry]:
    """All entries, one process after the other, each in its order."""
    data = path.read_bytes()
    control = CONTROL.unpack_from(data)
    n_buffers, buffer_bytes, used = control[4], control[5], control[10:]
    for buffer in range(n_buffers):
        at = HEADER_BYTES + buffer * buffer_bytes
        stop = at + used[buffer]
        while at < stop:
            entry, at = unpack_entry(data, at)
            yield entry


def pack_entry(e: Entry) -> bytes:
    head = (e.begin, e.end, e.version, e.low, e.high, e.time, e.x, e.y)
    tail = (e.kind, e.status, e.flags, len(e.items), e.target, e.source, e.process)
    return ENTRY.pack(*head, *tail) + b"".join(ITEM.pack(*vars(i).values()) for i in e.items)


def write(path: Path, entries: list[Entry], live: int = 14, cache_time_ns: int = -1) -> None:
    """A log with one buffer, as history_replay takes it."""
    body = b"".join(map(pack_entry, entries))
    order = 1 + max(max(e.begin, e.end) for e in entries)
    used = [len(body)] + [0] * (MOST_BUFFERS - 1)
    control = CONTROL.pack(MAGIC, 0, live, cache_time_ns, 1, len(body), order, 0, 0, 0, *used)
    path.write_bytes(control.ljust(HEADER_BYTES, b"\0") + body)
