# SPDX-License-Identifier: Apache-2.0
"""What the rounds of one protocol and number of processes come to."""

from __future__ import annotations

import statistics
from collections.abc import Callable
from typing import Any

from ._report import spread

Round = dict[str, Any]
_HISTOGRAMS = ("read_ns", "write_ns", "age_oldest_ns", "age_mean_ns", "span_ns", "deviation_ns")


def case(rounds: list[Round], duration_s: float, readers: int | None, shows_mixtures: bool) -> dict[str, Any]:
    """readers: the first so many workers only read and the others only write; None: all do both."""

    def rate(count: Callable[[Round], float]) -> dict[str, float]:
        return spread(count(r) / duration_s for r in rounds)

    for r in rounds:
        if not shows_mixtures:
            r["mixed"] = None
    return {
        "reads_per_s": rate(lambda r: r["reads"]),
        "writes_per_s": rate(lambda r: r["writes"]),
        **{name: _middle(rounds, name) for name in _HISTOGRAMS},
        "retries_per_read": _share(rounds, "read_retries", "reads"),
        "retries_per_write": _share(rounds, "write_retries", "writes"),
        "mixed_reads": _share(rounds, "mixed", "checked") if shows_mixtures else None,
        "checked_reads": sum(r["checked"] for r in rounds),
        "failures": sum(r["failures"] for r in rounds),
        "cpu_share": rate(lambda r: r["cpu_ns"] / 1e9),
        "cpu_ns_per_operation": spread(r["cpu_ns"] / _operations(r) for r in rounds),
        "least_reads_per_s": _least(rounds, 0, slice(0, readers), duration_s),
        "least_writes_per_s": _least(rounds, 1, slice(readers or 0, None), duration_s),
        "line_transfers_per_operation": _transfers(rounds),
        "rounds": rounds,
    }


def _operations(r: Round) -> int:
    return max(1, int(r["reads"]) + int(r["writes"]))


def _middle(rounds: list[Round], key: str) -> dict[str, float] | None:
    """Median over the rounds of each number of a histogram, but the largest of the largest."""
    found = [r[key] for r in rounds if r[key]]
    if not found:
        return None
    middle = {name: statistics.median(f[name] for f in found) for name in ("count", "mean", "p50", "p99", "p99_9")}
    return {**middle, "max": max(f["max"] for f in found)}


def _share(rounds: list[Round], part: str, whole: str) -> float | None:
    n = sum(r[whole] for r in rounds)
    return sum(r[part] for r in rounds) / n if n else None


def _least(rounds: list[Round], kind: int, who: slice, duration_s: float) -> float | None:
    """Of the slowest of those workers in any round; None: nobody does that."""
    if not sum(worker[kind] for r in rounds for worker in r["workers"]):
        return None
    return min(int(worker[kind]) / duration_s for r in rounds for worker in r["workers"][who])


def _transfers(rounds: list[Round]) -> dict[str, float] | None:
    known = [r["line_transfers"] / _operations(r) for r in rounds if r["line_transfers"] is not None]
    return spread(known) if known else None
