# SPDX-License-Identifier: Apache-2.0
"""`shmtf-bench micro`: what one call costs, in C and in Python, beside the floor measured in the same run."""

from __future__ import annotations

import argparse
from typing import Any

from ._arguments import counts, positive, words
from ._machine import describe, headline
from ._report import check_writable, progress, table, write_json

_ENGINES = ["native", "python"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("--frames", type=counts(17), default=[17, 512, 10000], metavar="N,N", help="frames of the chain (17,512,10000)")
    add("--history", type=counts(4), default=[16, 128], metavar="N,N", help="records kept per frame (16,128)")
    add("--engine", type=words(lambda: _ENGINES), default=_ENGINES, metavar="E,E", help="native,python")
    add("--rounds", type=positive(int, 99), default=7, metavar="N", help="rounds of all rows, interleaved (7)")
    add("--round-ms", type=positive(float), default=20.0, metavar="MS", help="per row and round (20)")
    add("--cpu", type=int, default=-1, metavar="N", help="the N-th of the usable CPUs; -1, the default: the last")
    add("--json", metavar="FILE", help="write the result there")


def _native_rows(frames: int, history: int, args: argparse.Namespace) -> list[dict[str, Any]] | None:
    from .. import _bench

    found = _bench.micro(frames, history, args.rounds, int(args.round_ms * 1e6), args.cpu)
    if found is None:
        return None
    names = ("name", "what", "floor", "median", "min", "max", "ratio")
    rows = []
    for values in found:
        row = dict(zip(names, values, strict=True))
        ns = {key: row.pop(key) for key in ("median", "min", "max")}
        rows.append({"engine": "native", **row, "ns": ns, "ratio": row["ratio"] or None})
    return rows


def _configuration(frames: int, history: int, args: argparse.Namespace) -> dict[str, Any]:
    """All rows of one size.  The floors are always measured: they are what the rest is compared with."""
    from .. import _bench
    from ._python_rows import python_rows

    config: dict[str, Any] = {"frames": frames, "history": history, "rows": [], "skipped": None}
    native = _native_rows(frames, history, args)
    if native is None:
        return {**config, "skipped": "shared memory is too small"}
    is_floor = {row["name"]: row["name"].startswith("floor") for row in native}
    config["rows"] = [row for row in native if is_floor[row["name"]] or "native" in args.engine]
    if "python" not in args.engine:
        return config
    cpus = _bench.cpus()
    _bench.pin(cpus[args.cpu])
    try:
        floors = {row["name"]: row["ns"]["median"] for row in native if is_floor[row["name"]]}
        python = python_rows(frames, history, args.rounds, args.round_ms * 1e6, floors)
    finally:
        _bench.pin(-1)
    config["rows"] += python or []
    return config


def _print(config: dict[str, Any]) -> None:
    print(f"\n{config['frames']} frames, history {config['history']}")
    if config["skipped"]:
        print(f"  skipped: {config['skipped']}")
        return
    lines = []
    for row in config["rows"]:
        ns = row["ns"]
        engine = "floor" if row["name"].startswith("floor") else "Python" if row["engine"] == "python" else "C"
        times = [f"{ns[key]:.0f}" for key in ("median", "min", "max")]
        ratio = f"{row['ratio']:.2f}" if row["ratio"] else ""
        lines.append([engine, row["name"], row["what"], *times, f"{1e6 / ns['median']:.0f}", ratio, row["floor"] or ""])
    print(table(["", "call", "what", "ns", "min", "max", "k/s", "ratio", "to"], lines, left=3))


def run(args: argparse.Namespace) -> int:
    check_writable(args.json)
    description = describe()
    print(headline(description))
    print(f"16 edges; ns of processor time per call: median of {args.rounds} interleaved rounds, smallest, largest")
    configurations = []
    for history in args.history:
        for frames in args.frames:
            progress(f"{frames} frames, history {history} ...")
            configurations.append(_configuration(frames, history, args))
            progress("")
            _print(configurations[-1])
    parameters = {"rounds": args.rounds, "round_ms": args.round_ms, "cpu": args.cpu, "chain": 16}
    write_json(args.json, {"kind": "micro", **description, "parameters": parameters, "configurations": configurations})
    return 0
