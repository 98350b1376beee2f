# SPDX-License-Identifier: Apache-2.0
"""Values that no caller should pass: wrong types, numbers at every edge, names of every kind, arrays of other shapes,
and objects that raise, lie or act when they are asked for what they are.
"""

from __future__ import annotations

import array
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from shmtf import Store, Transform


class Planted(Exception):
    """Raised by an argument in the middle of a call."""


class Raises:
    """Raises from whatever it is asked."""

    def _raise(self, *_: object, **__: object) -> Any:
        raise Planted

    __index__ = __int__ = __float__ = __len__ = __bool__ = __iter__ = __next__ = _raise
    __getitem__ = __array__ = __eq__ = __matmul__ = __rmatmul__ = __call__ = __fspath__ = __floor__ = _raise
    __hash__ = __repr__ = __str__ = __contains__ = __lt__ = __gt__ = __ge__ = __le__ = _raise


class RaisesOnGetattr:
    """Has whatever attribute is asked for, and none can be read."""

    def __getattr__(self, name: str) -> Any:
        raise Planted(name)


class Acts:
    """Does something when it is asked for a value, and then answers like a good one."""

    def __init__(self, act: Callable[[], object], answer: Any) -> None:
        self.act, self.answer = act, answer

    def _number(self) -> int:
        self.act()
        return self.answer if isinstance(self.answer, int) else 0

    __index__ = __int__ = _number

    def __float__(self) -> float:
        return float(self._number())

    def __bool__(self) -> bool:
        return bool(self._number())

    def __lt__(self, other: Any) -> bool:
        return self._number() < other

    def __gt__(self, other: Any) -> bool:
        return self._number() > other

    def __ge__(self, other: Any) -> bool:
        return self._number() >= other

    def __le__(self, other: Any) -> bool:
        return self._number() <= other

    def __eq__(self, other: object) -> bool:
        return self._number() == other

    __hash__ = object.__hash__

    def __iter__(self) -> Iterator[Any]:
        self.act()
        answer = self.answer
        yield from answer if isinstance(answer, (list, tuple)) else ()

    def __len__(self) -> int:
        self.act()
        return len(self.answer) if isinstance(self.answer, (list, tuple)) else 0

    def __getitem__(self, at: int) -> Any:
        self.act()
        return self.answer[at]

    def __repr__(self) -> str:
        self.act()
        return "Acts()"

    def __call__(self, *_: object) -> Any:
        self.act()
        return self.answer

    @property
    def nanoseconds(self) -> int:
        return self._number()


class Text(str):
    """A name that is not exactly a str."""

    __slots__ = ("__weakref__",)


class Number(int):
    """An int that is not exactly one."""


class Sub(Transform):
    """A Transform with fields of its own, that lies about the others."""

    parent = child = stamp = property(lambda self: (_ for _ in ()).throw(Planted()))


def recursive() -> list[Any]:
    items: list[Any] = []
    items.append(items)
    return items


def _generator(items: Any) -> Iterator[Any]:
    yield from items
    raise Planted


def hostile_values() -> dict[str, Any]:
    """By what they are; made anew, since some can be used once."""
    good = Transform("map", "a", 5)
    numbers = [0, 1, -1, 255, 2**31, 2**32, 2**53 + 1, 2**63 - 1, 2**63, -(2**63), -(2**63) - 1, 2**64, 10**400]
    floats = [0.0, -0.0, 1.5, float("nan"), float("inf"), float("-inf"), 5e-324, 1e308]
    texts = ["", "/a", "a", "map", "nobody", "a\0b", "\0", "\ud800", "x" * 127, "x" * 128, "x" * 5000, "\u00e9" * 63]
    texts += ["e\u0301", "\u202emap", " ", "\U0010ffff", "%s%n", "a" * 126 + "\u00e9", ".hidden", "a/b", "..", "\n"]
    arrays = [
        np.zeros(3, np.float32),
        np.zeros(7)[::2],
        np.zeros((3, 3)),
        np.zeros(()),
        np.array([1, "x", None], object),
    ]
    arrays += [
        np.zeros(0),
        np.full(4, np.nan),
        np.zeros(3)[::-1],
        np.ma.masked_all(3),
        np.datetime64("NaT"),
        np.float64(2),
    ]
    buffers = [
        b"",
        b"map",
        bytearray(b"abc"),
        memoryview(b"12345678" * 3),
        array.array("d", [0, 0, 1]),
        array.array("f", [1]),
    ]
    others = [
        None,
        True,
        [],
        {},
        set(),
        object(),
        int,
        Transform,
        Store,
        len,
        recursive(),
        _generator([good]),
        [good, good, 5],
    ]
    others += [
        iter(()),
        range(3),
        [None],
        ("map",),
        ("a", "b"),
        [good, "x"],
        {"a": 1},
        slice(None),
        Ellipsis,
        1j,
        lambda *a: 0,
    ]
    others += [Raises(), RaisesOnGetattr(), Text("map"), Number(3), Sub("map", "a", 5), good, [good], [[1.0] * 4] * 4]
    values = [*numbers, *floats, *texts, *arrays, *buffers, *others]
    return {f"{i}:{type(v).__name__}": v for i, v in enumerate(values)}
