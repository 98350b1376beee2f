# SPDX-License-Identifier: Apache-2.0
"""The cases of `shmtf-bench ycsb` as tables."""

from __future__ import annotations

from typing import Any

from ._report import duration, quantity, share, table

_LATENCY = ("mean", "p50", "p99", "p99_9", "max")
Case = dict[str, Any]


def _mix(case: Case) -> str:
    if case["coin"]:
        return "coin"
    return f"{case['readers']} r + {case['processes'] - case['readers']} w"


def _rate(rate: dict[str, float]) -> str:
    if not rate["max"]:
        return "-"
    return f"{quantity(rate['median'])} ({quantity(rate['min'])} .. {quantity(rate['max'])})"


def _part(value: float | None) -> str:
    return "-" if value is None else share(value, 1)


def _throughput(cases: list[Case], write_len: int) -> str:
    head = ["processes", "mix", "protocol", "reads/s", "updates/s", "least reads/s", "least updates/s", "CPU"]
    rows = [
        [
            str(c["processes"]),
            _mix(c),
            c["protocol"],
            _rate(c["reads_per_s"]),
            _rate(c["writes_per_s"]),
            quantity(c["least_reads_per_s"]),
            quantity(c["least_writes_per_s"]),
            share(c["cpu_share"]["median"], c["processes"]),
        ]
        for c in cases
    ]
    frames = "1 frame" if write_len == 1 else f"{write_len} frames"
    asked = cases[0].get("asked_writes_per_s")
    if asked:
        frames += f"; asked for: {quantity(asked)}/s"
    return f"{table(head, rows, left=3)}\n  update: {frames}; least: the slowest process in any round"


def _latencies(cases: list[Case]) -> str:
    head = ["processes", "protocol", "", *(name.replace("_", ".") for name in _LATENCY)]
    rows = [
        [str(c["processes"]), c["protocol"], kind, *(duration(c[f"{kind}_ns"][name]) for name in _LATENCY)]
        for c in cases
        for kind in ("read", "write")
        if c[f"{kind}_ns"]
    ]
    return table(head, rows, left=3)


def _answers(cases: list[Case]) -> str:
    ages = ("age_oldest_ns", "age_mean_ns", "span_ns", "deviation_ns")
    transfers = any(c["line_transfers_per_operation"] for c in cases)
    head = ["processes", "protocol", "retries/read", "/update", "mixed", "age", "mean age", "span", "deviation"]
    head += ["lines"] * transfers
    rows = []
    for c in cases:
        row = [str(c["processes"]), c["protocol"]]
        row += [_part(c[key]) for key in ("retries_per_read", "retries_per_write", "mixed_reads")]
        row += [duration(c[key]["p50"] if c[key] else None) for key in ages]
        if transfers:
            lines = c["line_transfers_per_operation"]
            row.append(quantity(lines["median"] if lines else None))
        rows.append(row)
    return (
        f"{table(head, rows, left=2)}\n"
        "  mixed: lookups that saw half an update; age: now - oldest and now - mean stamp of a lookup; span: newest -\n"
        "  oldest; deviation: standard deviation of its stamps; medians"
        + ("; lines: from another core's cache, per operation" if transfers else "")
    )


def tables(cases: list[Case], write_len: int) -> str:
    return "\n\n".join([_throughput(cases, write_len), _latencies(cases), _answers(cases)])
