# SPDX-License-Identifier: Apache-2.0
"""Results for people, as aligned tables, and for programs, as JSON."""

from __future__ import annotations

import json
import shutil
import statistics
import sys
import time
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from . import BenchError

SCHEMA = "shmtf-bench/1"
_QUANTILES = {"p50": 0.5, "p99": 0.99, "p99_9": 0.999}
_BAR_WIDTH = 20
_SOON = 0.02  # share of the work below which nothing is said about the time left


def spread(values: Iterable[float]) -> dict[str, float]:
    """Median, smallest and largest."""
    all_values = list(values)
    return {"median": statistics.median(all_values), "min": min(all_values), "max": max(all_values)}


def distribution(values: Sequence[float]) -> dict[str, float] | None:
    """The numbers that a histogram in C gives; None: no values."""
    if not values:
        return None
    ordered = sorted(values)
    at = {name: ordered[min(len(ordered) - 1, int(q * len(ordered)))] for name, q in _QUANTILES.items()}
    return {"count": len(ordered), "mean": statistics.fmean(ordered), **at, "max": ordered[-1]}


def quantity(value: float | None, digits: int = 3) -> str:
    """A number with a unit prefix: 1234567 -> 1.23 M."""
    if value is None:
        return "-"
    for limit, prefix in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if abs(value) >= limit:
            return f"{value / limit:.{max(0, digits - len(str(int(value / limit))))}f} {prefix}"
    return f"{value:.{max(0, digits - len(str(int(value))))}f}"


def duration(ns: float | None) -> str:
    """A time with its unit, three digits."""
    if ns is None:
        return "-"
    if not ns:
        return "0"
    for limit, unit in ((1e9, "s"), (1e6, "ms"), (1e3, "us")):
        if ns >= limit:
            return f"{quantity(ns / limit)} {unit}"
    return f"{quantity(ns)} ns"


def share(part: float, whole: float) -> str:
    """A ratio as per cent; exact zeros stay visible as such."""
    if not whole:
        return "-"
    if not part:
        return "0"
    percent = 100 * part / whole
    return f"{percent:.2g} %" if percent < 9.5 else f"{percent:.0f} %"


def table(head: Sequence[str], rows: Sequence[Sequence[str]], left: int = 1, indent: str = "  ") -> str:
    """Columns; the first `left` are flushed left, the rest right."""
    widths = [max(len(row[i]) for row in [head, *rows]) for i in range(len(head))]
    lines = []
    for row in [head, *rows]:
        cells = [
            text.ljust(width) if i < left else text.rjust(width)
            for i, (text, width) in enumerate(zip(row, widths, strict=True))
        ]
        lines.append((indent + "  ".join(cells)).rstrip())
    return "\n".join(lines)


_bars: list[Bar] = []  # from the outermost to the innermost


class Bar:
    """How much of a piece of work is done, in steps; within a step another bar may count finer ones."""

    def __init__(self, total: float) -> None:
        self.total = total
        self._done = self._step = 0.0
        self._start = time.monotonic()

    def __enter__(self) -> Bar:
        _bars.append(self)
        return self

    def __exit__(self, *_: object) -> None:
        _bars.remove(self)
        progress("")

    def begin(self, text: str, weight: float = 1.0) -> None:
        """The step before is done, one of this weight begins."""
        self._done += self._step
        self._step = weight
        progress(text)

    def share(self, inner: float) -> float:
        return min(1.0, (self._done + self._step * inner) / self.total)

    def elapsed_s(self) -> float:
        return time.monotonic() - self._start


def _bar_text() -> str:
    if not _bars:
        return ""
    part = 0.0
    for bar in reversed(_bars):
        part = bar.share(part)
    filled = round(part * _BAR_WIDTH)
    text = f"[{'=' * filled}{' ' * (_BAR_WIDTH - filled)}] {100 * part:3.0f} % "
    if part > _SOON:
        left_s = round(_bars[0].elapsed_s() * (1 - part) / part)
        text += f"{left_s // 60}:{left_s % 60:02} left "
    return text


def progress(text: str) -> None:
    """One line that is overwritten, where somebody watches: the bar, if there is one, and what is being done."""
    if sys.stderr.isatty():
        line = (_bar_text() + text)[: shutil.get_terminal_size().columns - 1] if text else ""
        print(f"\r\033[K{line}", end="", file=sys.stderr, flush=True)


def check_writable(path: str | None) -> None:
    """Before the work is done in vain."""
    if path is None:
        return
    try:
        Path(path).touch()
    except OSError as error:
        raise BenchError(f"{path}: {error.strerror}") from None


def write_json(path: str | None, result: dict[str, Any]) -> None:
    if path is not None:
        Path(path).write_text(json.dumps({"schema": SCHEMA, **result}, indent=1) + "\n")
