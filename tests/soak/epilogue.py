# SPDX-License-Identifier: Apache-2.0
"""The stores of the long run, from outside: made before it, looked at while it goes on, taken stock of after it."""

from __future__ import annotations

import contextlib
import os

import shmtf

SHM = "/dev/shm"
MAX_FRAMES = 1160  # worker/world.h
SECOND_FRAMES = 24
WHOLE = {MAX_FRAMES: 61440, SECOND_FRAMES: 960}  # records: the largest rings that fit into the arenas
IDENTITY = (0.0, 0.0, 0.0, 1.0)


class Stores:
    """Two stores for the crew, and the name of a third, which the crew makes and unlinks by itself."""

    def __init__(self, name: str) -> None:
        self.names = (name, name + "-second")
        self.beside = name + "-beside"
        self._open: list[shmtf.Store] = []
        self._uuids: set[str] = set()

    def create(self) -> None:
        capacities = {"history": 60, "cache_time": None, "stream_bytes": 0, "max_writers": 64}
        for name, frames in zip(self.names, (MAX_FRAMES, SECOND_FRAMES), strict=True):
            store = shmtf.Store.create(name, max_frames=frames, **capacities)
            if not self._open:  # what can be in it at once, before anything was
                problem = fill(store, 1)
                assert problem is None, problem
            self._open.append(store)
            self._uuids.add(store._info()["uuid"])
        for store in self._open:  # without a writer's slot
            store.close()
        self._open = [shmtf.Store.attach(name, readonly=True) for name in self.names]

    def close(self) -> None:
        for store in self._open:
            store.close()

    def files_problems(self) -> list[str]:
        """A store is one file, and at most one bell."""
        files = os.listdir(SHM)
        known = {*self.names, self.beside}
        ours = [f for f in files if f.startswith(self.names[0])]
        bells = [f for f in files if any(uuid in f for uuid in self._uuids)]
        problems = [f"unknown file {f}" for f in ours if f not in known]
        if len(bells) > len(self._uuids):
            problems.append(f"too many bells: {bells}")
        return problems

    def take_stock(self) -> tuple[list[str], list[str]]:
        """After the last death: what was found in order, and what not."""
        found, problems = [], []
        for name in self.names:
            with shmtf.Store.attach(name) as store:
                writers = store._writers()
                alive = [w for w in writers if w["alive"]]
                if alive:
                    problems.append(f"{name}: writer slots still held: {alive}")
                found.append(f"{name}: {len(alive)} writer slots held, {len(writers)} were in use at some time")
                names = store.frames()
                held = sum(store._frame_words(f)["locked"] for f in names)
                for child in names:  # every frame the dead may hold can be written at once
                    if store.parent(child) is not None:
                        store.set_transform(shmtf.Transform("root", child, 1 << 50), timeout=60.0)
                left = store._check()["locks_held"]
                store._check(True)
                report = store._check()
                if report["locks_held"] or report["bad_words"]:
                    problems.append(f"{name}: {report}")
                found.append(
                    f"{name}: {held} frames held by the dead, {left} after all were written, "
                    f"{report['locks_held']} after a repair; {report['bad_words']} bad words"
                )
                for frame in store.frames():
                    store.remove_frame(frame, timeout=60.0)
                problem = fill(store, 1 << 51)
                if problem:
                    problems.append(f"{name}: {problem}")
                else:
                    found.append(
                        f"{name}: all names removed, all memory taken as one ring, as many frames made as before"
                    )
        return found, problems + self.files_problems()

    def unlink(self, uuids_beside: set[str]) -> list[str]:
        """Remove the names, and say what is still there."""
        for name in (*self.names, self.beside):
            with contextlib.suppress(shmtf.StoreNotFoundError):
                shmtf.Store.unlink(name)
        uuids = self._uuids | uuids_beside
        return sorted(
            f
            for f in os.listdir(SHM)
            if f.startswith(self.names[0]) or (f.startswith(".shmtf-bell-") and f.removeprefix(".shmtf-bell-") in uuids)
        )


def fill(store: shmtf.Store, stamp: int) -> str | None:
    """An empty store: all its memory as one ring, then as many frames as there can be, each with a ring; then nothing.

    None: that went well.  A chunk that is lost anywhere would be in the way of the one ring.
    """
    frames = MAX_FRAMES if store._info()["max_frames"] == MAX_FRAMES else SECOND_FRAMES
    names = [f"filler{i}" for i in range(frames - 1)]
    try:
        store.declare_frame("whole", history=WHOLE[frames], timeout=60.0)
        store.remove_frame("whole", timeout=60.0)
        for at in range(0, len(names), 50):
            store.set_transforms([shmtf.Transform("root", n, stamp) for n in names[at : at + 50]], timeout=60.0)
    except shmtf.StoreFullError as error:
        return f"with {len(store.frames())} of {frames} frames: {error}"
    if len(store.frames()) != frames:
        return f"{len(store.frames())} frames instead of {frames}"
    try:
        store.set_transform(shmtf.Transform("root", "one more", stamp))
        return "one frame more than there is room for"
    except shmtf.StoreFullError:
        pass
    for name in [*names, "root"]:
        store.remove_frame(name, timeout=60.0)
    return None
