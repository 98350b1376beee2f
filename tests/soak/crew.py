# SPDX-License-Identifier: Apache-2.0
"""Members of the long run that use the Python API: crew.py ROLE STORE SECOND_STORE BOARD CELL SEED.

They check what worker/readers.c checks, and keep the store that is unlinked and made anew beside.  Exit code 3: a
promise was broken, and the board says which.
"""

from __future__ import annotations

import contextlib
import ctypes
import math
import os
import random
import signal
import sys
import traceback
from collections.abc import Callable

import board as boards
from board import SINGLES, Board

import shmtf

GROUP, CHAIN, BIG, BESIDE = 8, 16, 1000, 4
IDENTITY = (0.0, 0.0, 0.0, 1.0)
PR_SET_PDEATHSIG = 1


class Violation(Exception):
    """A promise was broken."""


def need(condition: bool, *what: object) -> None:
    if not condition:
        raise Violation(" ".join(map(str, what)))


def single_values(i: int, t: int) -> tuple[tuple[float, float, float], tuple[float, float, float, float]]:
    half = 0.5e-6 * (i % 3) * t
    return (float(i + 1) * float(t), float(t), 0.0), (0.0, 0.0, math.sin(half), math.cos(half))


def groups(t: int) -> list[shmtf.Transform]:
    """The C remainder of what may be negative is the same here: stamps are positive."""
    values = [float(t % 100003)] * GROUP + [float(t * (i + 3) % 2003 - 1001) for i in range(GROUP - 1)]
    values.append(-sum(values[GROUP:]))
    names = [f"e{i}" for i in range(GROUP)] + [f"s{i}" for i in range(GROUP)]
    return [shmtf.Transform("root", n, t, (x, 0.0, 0.0), IDENTITY) for n, x in zip(names, values, strict=True)]


class Member:
    """What all roles have."""

    def __init__(self, store: str, second: str, board: Board, number: int, seed: int) -> None:
        self.name, self.board, self.cell = store, board, board.cells[number]
        self.random = random.Random(seed)
        self.seen = [0] * SINGLES
        self.seen_version = 0
        self.counted: dict[str, int] = {}
        self.cell.begin()

    def publish(self, store: shmtf.Store) -> None:
        now = store.counters()
        self.cell.add_counters(now, self.counted)
        self.counted = now

    def timed(self, read: bool, call: Callable, *args: object, **kwargs: object) -> object:
        start = self.cell.start()
        try:
            return call(*args, **kwargs)
        finally:
            self.cell.took(start, read)

    def loop(self, store: shmtf.Store, *turns: Callable[[shmtf.Store], None]) -> None:
        while not self.board.over:
            self.random.choice(turns)(store)
            self.publish(store)

    # ---- writer ----

    def write(self) -> None:
        self.loop(shmtf.Store.attach(self.name, authority="crew"), self.write_singles, self.write_groups)

    def write_singles(self, store: shmtf.Store) -> None:
        stamp = self.board.stamp
        chosen = self.random.sample(range(SINGLES), self.random.choice((1, 1, 4)))
        batch = [shmtf.Transform("root", f"g{i}", stamp, *single_values(i, stamp)) for i in chosen]
        repeats = store.counters()["repeats"]
        version = self.timed(False, store.set_transforms, batch, timeout=None, priority=self.random.random() < 0.1)
        new = repeats == store.counters()["repeats"]
        for i in chosen:
            self.board.acknowledge(i, stamp, version if new else 0)
        self.cell.count(boards.SINGLE)

    def write_groups(self, store: shmtf.Store) -> None:
        self.timed(False, store.set_transforms, groups(self.board.stamp), timeout=None)
        self.cell.count(boards.GROUPS)

    # ---- reader ----

    def read(self) -> None:
        store = shmtf.Store.attach(self.name, readonly=True)
        self.loop(store, *(self.read_single,) * 8, *(self.read_chain,) * 8, *(self.read_groups,) * 4, self.dump)

    def see_version(self, version: int, known: int) -> None:
        need(version >= self.seen_version, "the version went back:", self.seen_version, version)
        need(version >= known, "a commit that was acknowledged is not seen:", known, version)
        self.seen_version = version

    def read_single(self, store: shmtf.Store) -> None:
        i = self.random.randrange(SINGLES)
        known, version = self.board.known_stamp(i), self.board.version()
        found = self.timed(True, store.lookup_latest_transform, "root", f"g{i}")
        self.see_version(found.version, version)
        need(found.stamp >= max(known, self.seen[i]), "stamp", found.stamp, "after", known, self.seen[i])
        self.seen[i] = found.stamp
        self.check_value(found, i, found.stamp)
        self.cell.count(boards.LATEST)
        t = found.stamp - self.random.randrange(1000)
        try:
            found = self.timed(True, store.lookup_transform, "root", f"g{i}", t)
        except shmtf.ExtrapolationException:
            self.cell.count(boards.NO_ANSWER)
        else:
            self.check_value(found, i, t)
            self.cell.count(boards.AT_TIME)

    def check_value(self, found: shmtf.Transform, i: int, t: int) -> None:
        place, turn = single_values(i, t)
        near = all(
            math.isclose(a, b, rel_tol=1e-9, abs_tol=1e-6) for a, b in zip(found.translation, place, strict=True)
        )
        dot = sum(float(a) * b for a, b in zip(found.rotation, turn, strict=True))
        need(near and abs(abs(dot) - 1) < 1e-9, f"g{i} at {t} is", tuple(found.translation), tuple(found.rotation))

    def read_chain(self, store: shmtf.Store) -> None:
        found = self.timed(True, store.lookup_latest_transform, "c0", f"c{CHAIN}")
        stamps = {stamp for _, _, stamp in found.edges}
        need(len(found.edges) == CHAIN and stamps == {found.stamp}, "a mixture of stamps:", stamps)
        need(float(found.translation[0]) == CHAIN * found.stamp, "the chain at", found.stamp, found.translation[0])
        self.cell.count(boards.READ_CHAIN)

    def read_groups(self, store: shmtf.Store) -> None:
        known = self.board.version()
        try:
            with store.snapshot() as snap:
                self.see_version(snap.version, known)
                for letter in "es":
                    found = [
                        self.timed(True, snap.lookup_latest_transform, "root", f"{letter}{i}") for i in range(GROUP)
                    ]
                    values = [float(t.translation[0]) for t in found]
                    need(len({t.stamp for t in found}) == 1, "half of an update")
                    need(len(set(values)) == 1 if letter == "e" else sum(values) == 0, "half of an update:", values)
        except shmtf.SnapshotExpiredError:
            self.cell.count(boards.EXPIRED)
        else:
            self.cell.count(boards.SNAPSHOT)

    def dump(self, store: shmtf.Store) -> None:
        try:
            with store.snapshot() as snap:
                text = snap.all_frames_as_yaml()
        except shmtf.SnapshotExpiredError:
            self.cell.count(boards.EXPIRED)
            return
        need(sum(line.startswith(("b", '"b', "'b")) for line in text.splitlines()) == BIG, "frames are missing")
        self.cell.count(boards.DUMP)

    # ---- waiter ----

    def wait(self) -> None:
        store = shmtf.Store.attach(self.name, readonly=True)
        since = 0
        while not self.board.over:
            chosen = self.random.sample(range(SINGLES), 2)
            known = max(self.board.known_version(i) for i in chosen)
            try:
                version = store.wait_for_change([f"g{i}" for i in chosen], since=since, timeout=0.2)
                need(version > since, "woken without a change:", since, version)
                self.cell.count(boards.WOKEN)
            except shmtf.TimeoutException as error:
                need(known <= since, "a change that was there was not seen:", since, known)
                version = error.version
                self.cell.count(boards.TIMED_OUT)
            since = version
            self.publish(store)

    # ---- a store beside, which comes and goes ----

    def note_life(self, store: shmtf.Store) -> None:
        """Before a bell can be made for it."""
        with open(self.board.path + ".lives", "ab", buffering=0) as file:
            file.write(f"{store._info()['uuid']}\n".encode())

    def keep_beside(self) -> None:
        name = self.name + "-beside"
        while not self.board.over:
            with shmtf.Store.create(name, max_frames=8, history=8, stream_bytes=4096, exist_ok=True) as store:
                self.note_life(store)
                for _ in range(self.random.randrange(50)):
                    t = self.board.stamp
                    batch = [shmtf.Transform("root", f"x{i}", t, (t, 0, 0), IDENTITY) for i in range(BESIDE)]
                    store.set_transforms(batch, timeout=None)
                    self.cell.count(boards.BIRTH)
                with contextlib.suppress(shmtf.StoreNotFoundError):
                    shmtf.Store.unlink(name)
                    self.cell.count(boards.REMOVE)

    def look_beside(self) -> None:
        name = self.name + "-beside"
        while not self.board.over:
            try:
                store = shmtf.Store.attach(name, readonly=self.random.random() < 0.5)
            except shmtf.StoreNotFoundError:
                self.cell.count(boards.NO_ANSWER)
                continue
            with store:
                self.note_life(store)
                with contextlib.suppress(shmtf.TimeoutException):
                    store.wait_for_change("x0", timeout=0.02)
                with store.snapshot() as snap, contextlib.suppress(shmtf.LookupException, shmtf.SnapshotExpiredError):
                    found = {float(snap.lookup_latest_transform("root", f"x{i}").translation[0]) for i in range(BESIDE)}
                    need(len(found) == 1, "half of an update beside:", found)
                    self.cell.count(boards.SNAPSHOT)


ROLES = {
    "py-writer": Member.write,
    "py-reader": Member.read,
    "py-waiter": Member.wait,
    "beside": Member.keep_beside,
    "beside-reader": Member.look_beside,
}


def main(role: str, store: str, second: str, board: str, number: str, seed: str) -> int:
    os.nice(5)  # who kills and stops comes first
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    member = Member(store, second, Board(board), int(number), int(seed))
    try:
        ROLES[role](member)
    except Exception as error:
        traceback.print_exc()
        member.cell.violate(f"{type(error).__name__}: {error}")
        return 3
    return 0


if __name__ == "__main__":
    status = main(*sys.argv[1:])
    sys.stdout.flush()
    os._exit(status)
