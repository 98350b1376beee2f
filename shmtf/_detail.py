# SPDX-License-Identifier: Apache-2.0
"""What every exception of the package has in common: fields, a message made late, pickling."""

from __future__ import annotations

import errno
from typing import Any


def quote(name: object) -> str:
    return '"' + str(name) + '"'


def seconds(ns: int) -> str:
    sign = "-" if ns < 0 else ""
    return f"{sign}{abs(ns) // 10**9}.{abs(ns) % 10**9:09d} s"


def short(value: object, limit: int = 80) -> str:
    text = repr(value)
    return text if len(text) <= limit else f"{text[: limit - 20]}... ({len(text)} characters)"


class Detail(RuntimeError):
    """Fields, message and pickling.  A field that does not apply is None."""

    edge: tuple[str, str] | None = None  #: (parent, child) that fails
    frame: str | None = None  #: the frame that fails
    target: str | None = None  #: what was asked for
    source: str | None = None
    roots: tuple[str, str] | None = None  #: of the target's tree and the source's, where they are not joined
    requested: int | None = None  #: the time asked for, nanoseconds
    oldest: int | None = None  #: oldest and newest stamp available there, nanoseconds
    newest: int | None = None
    waited: float | None = None  #: how long the call waited, seconds; for BusyError: how long it saw the holder
    what: str | None = None  #: the argument, capacity or word concerned
    value: Any = None  #: the offending value
    item: int | None = None  #: index in a batch
    hint: str | None = None  #: what would help
    store: str | None = None  #: name of the store
    version: int | None = None  #: the commit seen
    limit: int | None = None  #: a capacity, and what was asked of it
    needed: int | None = None
    holder: str | None = None  #: who holds the frame: name, writer slot, and process id in its own namespace
    holder_slot: int | None = None
    holder_pid: int | None = None
    sys_errno: int | None = None  #: errno of a failed system call

    _help: str | None = None  # what would help where the fields do not say
    _code: int | None = None  # errno, for those that are an OSError too

    def __init__(self, message: str | None = None, /, **fields: Any) -> None:
        super().__init__(*(() if message is None else (message,)))
        self.__dict__.update(fields)
        if isinstance(self, OSError):
            object.__setattr__(self, "errno", self.sys_errno or self._code)

    def _sentence(self) -> str:
        return self.what or type(self).__name__

    def _asked(self) -> str:
        if self.target is None:
            return ""
        return f" (target {quote(self.target)}, source {quote(self.source)})"

    def _advice(self) -> str | None:
        return self.hint or self._help

    def __str__(self) -> str:
        if self.args:
            return str(self.args[0])
        text = self._sentence() + self._asked()
        if self.waited and self.holder is None:
            text += f", after {self.waited:.3f} s"
        if self.item is not None:
            text = f"item {self.item}: {text}"
        if self.sys_errno:
            text += f" ({errno.errorcode.get(self.sys_errno, self.sys_errno)})"
        advice = self._advice()
        return f"{text}; {advice}" if advice else text

    def __repr__(self) -> str:
        return f"{type(self).__name__}({str(self)!r})"

    def __reduce__(self) -> tuple[Any, ...]:
        fields = {key: value for key, value in self.__dict__.items() if not key.startswith("_")}
        if not isinstance(self.value, (int, float, str, bytes, type(None))):
            fields["value"] = repr(self.value)
        advice = self._advice()
        if advice and not self.args:
            fields["hint"] = advice
        return _rebuild, (type(self), self.args, fields)


def _rebuild(cls: type[Detail], args: tuple[Any, ...], fields: dict[str, Any]) -> Detail:
    return cls(*args, **fields)
