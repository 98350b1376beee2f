# SPDX-License-Identifier: Apache-2.0
"""What `shmtf-bench ycsb --engine python` compares: what a Python node calls, and what it would call otherwise.

Imports what a protocol needs only where it is used: tf2-python runs in an interpreter that has neither numpy nor shmtf.
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Mapping
from typing import Any

PERIOD_NS = 10_000_000
POSES = 64


class PythonProtocol:
    """A worker's view, made by attaching.  told: frames, history, read_len, write_len, opposite."""

    what = ""
    threads = False  # its memory belongs to one process: create runs there, and the workers are its threads
    common_time = False  # lookups are at the newest common time: every stamp is that time, and shows no mixture

    @staticmethod
    def create(name: str, told: Mapping[str, Any]) -> str:
        """Make the memory, full of records older than now; returns what workers attach to."""
        raise NotImplementedError

    @staticmethod
    def remove(place: str) -> None:
        """Remove the name, if there is one; who attached stays attached."""

    def __init__(self, place: str, told: Mapping[str, Any]) -> None:
        self.read_len: int = told["read_len"]
        self.write_len: int = told["write_len"]
        self.opposite: bool = told["opposite"]

    def read(self, first: int) -> Any:
        """T_first_(first + read_len)."""
        raise NotImplementedError

    def stamps(self, answer: Any) -> list[int]:
        """Of an answer of read, [k] that of frame first + 1 + k."""
        raise NotImplementedError

    def write(self, first: int, stamp_ns: int) -> None:
        """The write_len frames after `first`, all with one stamp."""
        raise NotImplementedError

    def retries(self) -> tuple[int, int]:
        """Reads and writes of this client that were begun again because of others."""
        return 0, 0

    def close(self) -> None:
        pass

    def children(self, first: int) -> range:
        """Of an update, in the order in which it gives them."""
        if self.opposite:
            return range(first + 1, first + self.write_len + 1)
        return range(first + self.write_len, first, -1)


def _names(told: Mapping[str, Any]) -> list[str]:
    return [f"link_{i:05}" for i in range(told["frames"])]


class Shmtf(PythonProtocol):
    what = "this library: an update is one call of set_transforms, its Transforms built for it"

    @staticmethod
    def create(name: str, told: Mapping[str, Any]) -> str:
        from .. import _bench

        return _bench.create("shmtf", name, told["frames"], told["history"], told["read_len"], told["write_len"])

    @staticmethod
    def remove(place: str) -> None:
        from .. import _bench

        _bench.remove("shmtf", place)

    def __init__(self, place: str, told: Mapping[str, Any]) -> None:
        import shmtf

        super().__init__(place, told)
        self._transform = shmtf.Transform
        self._names = _names(told)
        self._store = shmtf.Store.attach(place)

    def read(self, first: int) -> Any:
        return self._store.lookup_latest_transform(self._names[first], self._names[first + self.read_len])

    def stamps(self, answer: Any) -> list[int]:
        return [stamp for _, _, stamp in answer.edges][::-1]

    def write(self, first: int, stamp_ns: int) -> None:
        names, make = self._names, self._transform
        self._store.set_transforms(
            [
                make(names[i - 1], names[i], stamp_ns, (0.1, 0.2, 0.3), (0.5, -0.5, 0.5, -0.5))
                for i in self.children(first)
            ]
        )

    def retries(self) -> tuple[int, int]:
        counters = self._store.counters()
        return counters["rereads"] + counters["restarts"], counters["aborts"]

    def close(self) -> None:
        self._store.close()


class NumpyLock(PythonProtocol):
    """Two arrays in memory that all processes map: a 4 x 4 matrix and a stamp per frame, behind one semaphore.

    Only numbers are copied under it; an update's matrices are there already; a chain is multiplied in halves."""

    what = "numpy arrays in shared memory and a lock: frames by number, no names, no history, no times, no recovery"

    @staticmethod
    def create(name: str, told: Mapping[str, Any]) -> str:
        import numpy as np
        import posix_ipc

        frames = told["frames"]
        descriptor = os.memfd_create(name)  # has no name to remove: it ends with this process and those that attach
        os.ftruncate(descriptor, frames * 17 * 8)
        place = f"/proc/{os.getpid()}/fd/{descriptor}"
        poses, stamps = _map_arrays(np, place, frames)
        poses[:] = np.eye(4)
        stamps[:] = 1
        posix_ipc.Semaphore(f"/{name}", posix_ipc.O_CREX, initial_value=1).close()
        return f"{place} /{name}"

    @staticmethod
    def remove(place: str) -> None:
        import contextlib

        import posix_ipc

        path, semaphore = place.split()
        with contextlib.suppress(posix_ipc.ExistentialError):
            posix_ipc.unlink_semaphore(semaphore)
            os.close(int(path.rsplit("/", 1)[1]))

    def __init__(self, place: str, told: Mapping[str, Any]) -> None:
        import numpy as np
        import posix_ipc

        super().__init__(place, told)
        path, semaphore = place.split()
        self._np = np
        self._poses, self._stamps = _map_arrays(np, path, told["frames"])
        self._lock = posix_ipc.Semaphore(semaphore)
        angles = np.arange(POSES + self.write_len) / POSES
        self._written = np.tile(np.eye(4), (len(angles), 1, 1))
        self._written[:, 0, 0] = self._written[:, 1, 1] = np.cos(angles)
        self._written[:, 1, 0] = np.sin(angles)
        self._written[:, 0, 1] = -np.sin(angles)
        self._written[:, :3, 3] = 0.1, 0.2, 0.3

    def read(self, first: int) -> Any:
        end = first + 1 + self.read_len
        with self._lock:
            poses = self._poses[first + 1 : end].copy()
            stamps = self._stamps[first + 1 : end].copy()
        while len(poses) > 1:
            if len(poses) % 2:
                poses = self._np.concatenate((poses[:-2], poses[-2:-1] @ poses[-1:]))
            poses = poses[0::2] @ poses[1::2]
        return poses[0], stamps

    def stamps(self, answer: Any) -> list[int]:
        stamps: list[int] = answer[1].tolist()
        return stamps

    def write(self, first: int, stamp_ns: int) -> None:
        begin, end, at = first + 1, first + 1 + self.write_len, first % POSES
        written = self._written[at : at + self.write_len]
        with self._lock:
            self._poses[begin:end] = written
            self._stamps[begin:end] = stamp_ns

    def close(self) -> None:
        self._lock.close()


def _map_arrays(np: Any, path: str, frames: int) -> tuple[Any, Any]:
    poses = np.memmap(path, np.float64, "r+", 0, (frames, 4, 4))
    stamps = np.memmap(path, np.int64, "r+", frames * 16 * 8, (frames,))
    return poses.view(np.ndarray), stamps.view(np.ndarray)  # a memmap's slices cost more


class Tf2Python(PythonProtocol):
    """One tf2_py.BufferCore.  The interpreter's lock and tf2's mutex keep the threads apart."""

    what = "tf2_py, threads of one process: an update builds a message per frame, a lookup is at the newest common time"
    threads = True
    common_time = True
    _core: Any = None

    @staticmethod
    def create(name: str, told: Mapping[str, Any]) -> str:
        import time

        import genpy
        import tf2_py
        from geometry_msgs.msg import TransformStamped

        core = tf2_py.BufferCore(genpy.Duration(3600))  # longer than a run, as in bench/peers/tf2.cpp
        names, message = _names(told), TransformStamped()
        message.transform.rotation.w = 1.0
        start = time.monotonic_ns() - told["history"] * PERIOD_NS
        for k in range(told["history"]):
            message.header.stamp = genpy.Time(*divmod(start + k * PERIOD_NS, 10**9))
            for parent, child in itertools.pairwise(names):
                message.header.frame_id, message.child_frame_id = parent, child
                core.set_transform(message, "shmtf-bench")
        Tf2Python._core = core
        return name

    def __init__(self, place: str, told: Mapping[str, Any]) -> None:
        import genpy
        from geometry_msgs.msg import TransformStamped

        super().__init__(place, told)
        self._message, self._time, self._newest = TransformStamped, genpy.Time, genpy.Time()
        self._names = _names(told)

    def read(self, first: int) -> Any:
        return self._core.lookup_transform_core(self._names[first], self._names[first + self.read_len], self._newest)

    def stamps(self, answer: Any) -> list[int]:
        return [answer.header.stamp.to_nsec()] * self.read_len

    def write(self, first: int, stamp_ns: int) -> None:
        names, stamp = self._names, self._time(*divmod(stamp_ns, 10**9))
        set_transform = self._core.set_transform
        for i in self.children(first):
            message = self._message()
            message.header.frame_id, message.child_frame_id, message.header.stamp = names[i - 1], names[i], stamp
            translation, rotation = message.transform.translation, message.transform.rotation
            translation.x, translation.y, translation.z = 0.1, 0.2, 0.3
            rotation.x, rotation.y, rotation.z, rotation.w = 0.5, -0.5, 0.5, -0.5
            set_transform(message, "shmtf-bench")


PYTHON_PROTOCOLS: dict[str, type[PythonProtocol]] = {
    "shmtf": Shmtf,
    "numpy-lock": NumpyLock,
    "tf2-python": Tf2Python,
}
