# SPDX-License-Identifier: Apache-2.0
"""Every function and method of the package as something to call, with good arguments.

The calls are found by introspection and their arguments by signature, so what is added to the package is called too.
"""

from __future__ import annotations

import gc
import inspect
import os
import uuid
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

import shmtf
from shmtf import Store, Transform, _core, _failures, _time

# ---- what good arguments are ----

GOOD: dict[str, Any] = {
    "name": "a",
    "child": "a",
    "frame": "a",
    "target": "map",
    "source": "b",
    "parent": "map",
    "time": 5,
    "stamp": 5,
    "timeout": 0,
    "static": False,
    "priority": False,
    "keep_static": True,
    "readonly": True,
    "repair": False,
    "exist_ok": False,
    "authority": "me",
    "history": 20,
    "rate": None,
    "limit": 9,
    "since": 0,
    "frames": ("a",),
    "read": lambda reads: reads.version,
    "points": (1.0, 2.0, 3.0),
    "vectors": [(1.0, 2.0, 3.0)],
    "position": (0, 0, 0),
    "orientation": (0, 0, 0, 1),
    "covariance": np.eye(6),
    "matrix": np.eye(4),
    "translation": (1, 2, 3),
    "rotation": (0, 0, 0, 1),
    "rpy": (0.1, 0, 0),
    "distance": 1.0,
    "angle": 1.0,
    "count": 3,
    "offset": 0,
    "values": (0.0,) * 6 + (1.0,),
    "stamp_range": (1, 2),
    "version": 3,
    "edges": (),
    "max_frames": 8,
    "cache_time": 1.0,
    "cache_time_ns": 5,
    "stream_bytes": 4096,
    "mode": 0o600,
    "max_writers": 4,
    "seconds": 1.0,
    "writer": "me",
    "type": Transform,
    "factory": _failures._make,
    "converter": _time._convert,
    "memo": {},
    "flags": 0,
    "kind": None,
    "value": None,
    "traceback": None,
}


def good_argument(parameter: str, world: World) -> Any:
    if parameter in ("transform", "other"):
        return Transform("map", "a", 7)
    if parameter == "transforms":
        return [Transform("map", "a", 8), Transform("a", "b", 8)]
    if parameter == "store":
        return world.victim
    if parameter == "fd":
        return world.new_file()
    if parameter == "new_name":
        return world.new_name()
    return GOOD[parameter]


def fits(parameter: str, value: Any) -> bool:
    """Whether it may be passed: not a wait without end, not a gigabyte, not somebody else's descriptor."""
    if parameter == "timeout":  # whatever is more than a moment
        try:
            return value is not None and not float(value) >= 1e-3
        except Exception:  # then it fails there too
            return True
    if parameter in ("stream_bytes", "max_frames", "history", "max_writers"):
        return not (isinstance(value, int) and 2**20 < value < 2**40)
    if parameter == "fd":
        return not isinstance(value, int) or not 0 <= value < 2**31
    return True


# ---- the calls ----


class World:
    """A store with a few frames, a witness that is never closed, and a victim for each call."""

    def __init__(self) -> None:
        self.name = f"shmtf-test-{uuid.uuid4().hex}"
        self.made: list[str] = [self.name]
        self.files: list[int] = []
        self.witness = Store.create(self.name, max_frames=64, history=8, stream_bytes=1 << 14, max_writers=16)
        self.victim: Store = self.witness
        self.fill()

    def fill(self) -> None:
        """The frames that the good arguments name."""
        for name in self.witness.frames():
            self.witness.remove_frame(name)
        for stamp in (1, 5, 9):
            self.witness.set_transforms([Transform("map", "a", stamp), Transform("a", "b", stamp, (stamp, 0, 0))])
        self.witness.set_transform(Transform("b", "c"), static=True)

    def content(self) -> tuple[Any, ...]:
        w = self.witness
        return w.version, [(f, repr(w._records(f)), repr(w._frame_info(f))) for f in w.frames()]

    def new_name(self) -> str:
        self.made.append(f"shmtf-test-{uuid.uuid4().hex}")
        return self.made[-1]

    def new_file(self) -> int:
        self.files.append(os.memfd_create("hostile"))
        return self.files[-1]

    def begin(self) -> None:
        self.victim = Store.attach(self.name)

    def end(self) -> None:
        """After a call, whatever it did: the settings of the core, and what it made."""
        _core.set_error_factory(_failures._make)
        _core.set_stamp_converter(_time._convert)
        _core.set_transform_type(Transform)
        self.victim.close()
        while self.files:
            os.close(self.files.pop())
        while len(self.made) > 1:
            made = os.path.join("/dev/shm", self.made.pop())
            if os.path.exists(made):
                Store.unlink(os.path.basename(made))

    def close(self) -> None:
        self.witness.close()
        Store.unlink(self.name)
        gc.collect()


Call = tuple[Callable[[World], Callable[..., Any]], list[inspect.Parameter]]


def _parameters(function: Any, skip: int) -> list[inspect.Parameter]:
    return list(inspect.signature(function).parameters.values())[skip:]


def _methods(cls: type, get: Callable[[World], Any]) -> Iterator[tuple[str, Call]]:
    special = (
        "__matmul__",
        "__eq__",
        "__hash__",
        "__repr__",
        "__reduce__",
        "__copy__",
        "__deepcopy__",
        "__enter__",
        "__exit__",
    )
    for name in dir(cls):
        kind = inspect.getattr_static(cls, name)
        if (
            (name.startswith("__") and name not in special)
            or isinstance(kind, property)
            or inspect.isgetsetdescriptor(kind)
        ):
            continue
        bound = isinstance(kind, (classmethod, staticmethod)) or type(kind).__name__ == "classmethod_descriptor"
        parameters = _parameters(getattr(cls, name), 0 if bound else 1)
        if (cls, name) == (Store, "create"):
            parameters[0] = parameters[0].replace(name="new_name")
        yield f"{cls.__name__}.{name}", (lambda world, n=name: getattr(get(world), n), parameters)


def _all_calls() -> Iterator[tuple[str, Call]]:
    yield from _methods(Store, lambda world: world.victim)
    yield from _methods(shmtf.Snapshot, lambda world: world.victim.snapshot())
    yield from _methods(Transform, lambda world: world.victim.lookup_transform("map", "b"))
    for cls in (Transform, _core.Transform, _core.Store, _core.Snapshot, shmtf.Snapshot):
        yield f"{cls.__module__}.{cls.__name__}", (lambda world, c=cls: c, _constructor(cls))
    for module in (shmtf, _core):
        for name in dir(module):
            function = getattr(module, name)
            if inspect.isbuiltin(function) or (inspect.isfunction(function) and name in shmtf.__all__):
                yield f"{module.__name__}.{name}", (lambda world, f=function: f, _parameters(function, 0))


def _constructor(cls: type) -> list[inspect.Parameter]:
    if issubclass(cls, _core.Transform):
        names = ["parent", "child", "stamp", "translation", "rotation"]
    else:
        names = ["fd", "readonly", "writer"] if issubclass(cls, _core.Store) else ["store"]
    return [inspect.Parameter(name, inspect.Parameter.POSITIONAL_OR_KEYWORD) for name in names]


CALLS: dict[str, Call] = dict(_all_calls())
