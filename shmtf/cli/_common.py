# SPDX-License-Identifier: Apache-2.0
"""What the subcommands share: which store is meant, errors in a line, numbers in words, aligned columns."""

from __future__ import annotations

import os
import re
import sys
import unicodedata
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .. import Store

_ESCAPE = re.compile(r"\x1b\[[0-9;]*m")


class CliError(Exception):
    """Ends the command with this message and exit code."""

    def __init__(self, message: str, code: int = 1) -> None:
        super().__init__(message)
        self.code = code


def shown_error(error: Exception) -> str | None:
    """The line for the user; None if the error is a bug and its traceback should be seen."""
    if isinstance(error, CliError):
        return str(error)
    from .. import StoreError, TransformException

    if isinstance(error, StoreError | TransformException | OSError):
        return printable(str(error))
    return None


# ---- stores ----


def default_store(name: str | None) -> str:
    """The name given, else $SHMTF_STORE, else the only store there is."""
    if name or (name := os.environ.get("SHMTF_STORE")):
        return name
    from .. import list_stores

    names = list_stores()
    if len(names) == 1:
        return names[0]
    if not names:
        raise CliError("there is no store; give a NAME", 2)
    raise CliError(f"which store? {_some(names)}; give a NAME or set SHMTF_STORE", 2)


def _some(names: list[str], limit: int = 6) -> str:
    shown = ", ".join(map(printable, names[:limit]))
    return shown if len(names) <= limit else f"{shown} and {len(names) - limit} more"


def attach(name: str, readonly: bool = True) -> Store:
    """The store, mapped read-only unless asked otherwise."""
    from .. import Store, StoreNotFoundError, StoreNotReadyError, list_stores

    try:
        return Store.attach(name, readonly=readonly, authority="shmtf")
    except StoreNotReadyError:
        raise
    except StoreNotFoundError:
        names = list_stores()
        known = f"there are: {_some(names)}" if names else "there is none on this machine"
        raise CliError(f'there is no store "{printable(name)}"; {known}') from None


# ---- words ----


def printable(text: str) -> str:
    """Text of a segment or a user, without what would move a terminal's cursor."""
    return "".join(c if c.isprintable() else f"\\x{ord(c):02x}" for c in text)


def size(n_bytes: int) -> str:
    """12.3 MiB."""
    value = float(n_bytes)
    for unit in ("B", "KiB", "MiB", "GiB"):
        if value < 1024 or unit == "GiB":
            break
        value /= 1024
    return f"{value:.0f} {unit}" if unit == "B" or value >= 100 else f"{value:.1f} {unit}"


def span(seconds: float | None) -> str:
    """A duration or age of any magnitude in few characters: 12.3 ms, 3.42 s, 2 min 5 s, 3 h 20 min."""
    if seconds is None:
        return ""
    sign, s = "-" if seconds < 0 else "", abs(seconds)
    if s < 0.9995e-3:
        return f"{sign}{s * 1e6:.0f} us"
    if s < 0.9995:
        return f"{sign}{s * 1e3:.1f} ms"
    if s < 120:
        return f"{sign}{s:.2f} s" if s < 10 else f"{sign}{s:.1f} s"
    minutes = int(s // 60)
    if minutes < 120:
        return f"{sign}{minutes} min {int(s % 60)} s"
    if minutes < 48 * 60:
        return f"{sign}{minutes // 60} h {minutes % 60} min"
    return f"{sign}{minutes // 1440} d"


def stamp(ns: int | None) -> str:
    """Nanoseconds as seconds with nine decimals, exactly."""
    if ns is None:
        return ""
    return f"{'-' if ns < 0 else ''}{abs(ns) // 10**9}.{abs(ns) % 10**9:09d}"


def rate(hz: float | None) -> str:
    """Records per second."""
    if hz is None:
        return ""
    return f"{hz:.1f} Hz" if hz < 1000 else f"{hz:.0f} Hz"


# ---- columns ----


class Style:
    """ANSI styles, or nothing where they would be noise."""

    def __init__(self, on: bool | None = None) -> None:
        if on is None:
            on = sys.stdout.isatty() and "NO_COLOR" not in os.environ and os.environ.get("TERM") != "dumb"
        self.on = on

    def _wrap(self, code: str, text: str) -> str:
        return f"\x1b[{code}m{text}\x1b[0m" if self.on and text else text

    def bold(self, text: str) -> str:
        return self._wrap("1", text)

    def dim(self, text: str) -> str:
        return self._wrap("2", text)

    def bad(self, text: str) -> str:
        return self._wrap("1;31", text)

    def good(self, text: str) -> str:
        return self._wrap("32", text)


def width(text: str) -> int:
    """Columns it takes on a terminal."""
    text = _ESCAPE.sub("", text)
    if text.isascii():
        return len(text)
    return sum(0 if unicodedata.combining(c) else 2 if unicodedata.east_asian_width(c) in "WF" else 1 for c in text)


def crop(text: str, columns: int) -> str:
    """The text, cut to so many columns; styles stay whole."""
    if width(text) <= columns:
        return text
    out, used, styled = [], 0, False
    for part in re.split(r"(\x1b\[[0-9;]*m)", text):
        if part.startswith("\x1b["):
            out.append(part)
            styled = part != "\x1b[0m"
            continue
        for c in part:
            used += width(c)
            if used >= columns:
                return "".join(out) + "…" + ("\x1b[0m" if styled else "")
            out.append(c)
    return "".join(out)


def table(rows: Iterable[Sequence[str]], align: str, gap: str = "  ") -> list[str]:
    """Rows as lines; align has '<' or '>' per column.  Styled text is fine."""
    rows = [list(row) for row in rows]
    widths = [max((width(row[i]) for row in rows), default=0) for i in range(len(align))]
    lines = []
    for row in rows:
        cells = []
        for text, columns, side in zip(row, widths, align, strict=True):
            pad = " " * (columns - width(text))
            cells.append(text + pad if side == "<" else pad + text)
        lines.append(gap.join(cells).rstrip())
    return lines
