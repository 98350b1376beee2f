# SPDX-License-Identifier: Apache-2.0
"""Results for people, as aligned tables, and for programs, as JSON."""

from __future__ import annotations

import json
import statistics
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from . import BenchError

SCHEMA = "shmtf-bench/1"


def spread(values: Iterable[float]) -> dict[str, float]:
    """Median, smallest and largest."""
    all_values = list(values)
    return {"median": statistics.median(all_values), "min": min(all_values), "max": max(all_values)}


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


def progress(text: str) -> None:
    """One line that is overwritten, where somebody watches."""
    if sys.stderr.isatty():
        print(f"\r\033[K{text}", end="", file=sys.stderr, flush=True)


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
