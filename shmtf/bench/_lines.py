# SPDX-License-Identifier: Apache-2.0
"""Which lines of a store's memory a call leaves different."""

from __future__ import annotations

import math
import os
from typing import Any

import shmtf

from ._report import spread

LINE = 64  # bytes
LOOKUPS = 1000
COMMITS = 15
FRAMES = 200
_ROOT = "map"


class _Chain:
    """A chain of frames in a store without a name, and its memory as a file."""

    def __init__(self, frames: int) -> None:
        name = f"shmtf-bench-{os.getpid()}-lines"
        self.updates = 0
        self.names = [_ROOT, *(f"frame_{i}" for i in range(1, frames + 1))]
        self.store = shmtf.Store.create(name, frames + 8, 16, stream_bytes=0)
        try:
            for _ in range(32):  # rings that have been gone round once, like those of a robot that runs
                self.update(1, frames)
            self.reader = shmtf.Store.attach(name, readonly=True)
            self.fd = os.open(f"/dev/shm/{name}", os.O_RDONLY)
        finally:
            shmtf.Store.unlink(name)

    def close(self) -> None:
        os.close(self.fd)
        self.reader.close()
        self.store.close()

    def update(self, first: int, n: int) -> None:
        """Every update has other poses: what is written twice the same would not be seen."""
        names = self.names
        self.updates += 1
        turn = 1e-3 * self.updates
        at, rotation = (turn, -turn, 1 + turn), (0.0, 0.0, math.sin(turn), math.cos(turn))
        self.store.set_transforms(
            [shmtf.Transform(names[i - 1], names[i], None, at, rotation) for i in range(first, first + n)]
        )

    def memory(self) -> bytes:
        size, at, parts = os.fstat(self.fd).st_size, 0, []
        while at < size:
            parts.append(os.pread(self.fd, size - at, at))
            at += len(parts[-1])
        return b"".join(parts)


def _different(before: bytes, after: bytes) -> int:
    return sum(before[at : at + LINE] != after[at : at + LINE] for at in range(0, len(before), LINE))


def lines_of_lookups() -> dict[str, Any]:
    """By a process that reads with a read-only mapping."""
    chain = _Chain(FRAMES)
    try:
        before = chain.memory()
        for k in range(LOOKUPS):
            target, source = chain.names[k % 100], chain.names[k % 100 + 1 + k % 64]
            (chain.reader.lookup_latest_transform if k % 2 else chain.reader.lookup_transform)(target, source)
        lines = _different(before, chain.memory())
    finally:
        chain.close()
    return {"what": f"{LOOKUPS} lookups", "frames": None, "lines": spread([lines])}


def lines_of_commits(frames: int) -> dict[str, Any]:
    """By one commit of this many neighbouring frames."""
    chain = _Chain(max(FRAMES, frames + COMMITS))
    found = []
    try:
        for k in range(COMMITS):
            before = chain.memory()
            chain.update(1 + k, frames)
            found.append(_different(before, chain.memory()))
    finally:
        chain.close()
    return {"what": f"a commit of {frames} frame{'s' if frames > 1 else ''}", "frames": frames, "lines": spread(found)}
