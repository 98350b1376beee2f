# SPDX-License-Identifier: Apache-2.0
"""`shmtf-bench micro`: what one call costs, in C and in Python, beside the floor and tf2 measured in the same run."""

from __future__ import annotations

import argparse
from typing import Any

from . import BenchError
from ._arguments import counts, positive, words
from ._machine import describe, headline
from ._report import check_writable, progress, table, write_json

_ENGINES = ["native", "python"]
_WRITE_LEN = 16


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("--frames", type=counts(17), default=[17, 512, 10000], metavar="N,N", help="frames of the chain (17,512,10000)")
    add("--history", type=counts(4), default=[16, 128], metavar="N,N", help="records kept per frame (16,128)")
    add("--depth", type=positive(int, 512), default=16, metavar="N", help="edges of a lookup (16)")
    add("--engine", type=words(lambda: _ENGINES), default=_ENGINES, metavar="E,E", help="native,python")
    add("--peers", action=argparse.BooleanOptionalAction, default=True, help="tf2 too, where it is installed")
    add("--rounds", type=positive(int, 99), default=7, metavar="N", help="rounds of all rows, interleaved (7)")
    add("--round-ms", type=positive(float), default=20.0, metavar="MS", help="per row and round (20)")
    add("--cpu", type=int, default=-1, metavar="N", help="the N-th of the usable CPUs; -1, the default: the last")
    add("--json", metavar="FILE", help="write the result there")


def _settle(args: argparse.Namespace) -> None:
    """Check what argparse cannot."""
    from .. import _bench

    least = min(args.frames)
    if least <= args.depth:
        raise BenchError(f"--frames {least}: a lookup over --depth {args.depth} edges needs more frames than that")
    cpus = len(_bench.cpus())
    if not -cpus <= args.cpu < cpus:
        raise BenchError(f"--cpu {args.cpu}: this process may use {cpus}, counted from 0, or from -1 backwards")


def _native_rows(frames: int, history: int, args: argparse.Namespace) -> tuple[list[dict[str, Any]], str] | None:
    """And why a peer that is installed was not measured, or ""."""
    from .. import _bench
    from ._peers import tf2_library

    peer = tf2_library() if args.peers and "native" in args.engine else None
    found = _bench.micro(frames, history, args.depth, args.rounds, int(args.round_ms * 1e6), args.cpu, peer)
    if found is None:
        return None
    names = ("name", "what", "floor", "median", "min", "max", "ratio", "peer", "beside")
    rows = []
    for values in found[0]:
        row = dict(zip(names, values, strict=True))
        ns = {key: row.pop(key) for key in ("median", "min", "max")}
        rows.append({"engine": "native", **row, "ns": ns, "ratio": row["ratio"] or None})
    return rows, found[1]


def _configuration(frames: int, history: int, args: argparse.Namespace) -> dict[str, Any]:
    """All rows of one size.  The floors are always measured: they are what the rest is compared with."""
    from .. import _bench
    from ._python_rows import python_rows

    config: dict[str, Any] = {"frames": frames, "history": history, "rows": [], "skipped": None}
    config |= {"without_tf2": None, "without_tf2_py": None}
    found = _native_rows(frames, history, args)
    if found is None:
        return {**config, "skipped": "shared memory is too small"}
    native, why = found
    config["without_tf2"] = why or None
    floors = {row["name"]: row["ns"]["median"] for row in native if row["name"].startswith("floor")}
    config["rows"] = [row for row in native if row["name"] in floors or "native" in args.engine]
    if "python" in args.engine:
        rounds, round_ns, cpu = args.rounds, args.round_ms * 1e6, _bench.cpus()[args.cpu]
        python = python_rows(frames, history, args.depth, rounds, round_ns, cpu, floors, args.peers)
        config["rows"] += python[0] if python else []
        config["without_tf2_py"] = (python[1] if python else "") or None
    config["comparisons"] = _comparisons(config["rows"])
    return config


def _comparisons(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Each row of a peer over ours for the same question."""
    ours = {(row["engine"], row["name"]): row for row in rows if row["peer"] is None}
    found = []
    for row in rows:
        mine = ours.get((row["engine"], row["beside"]))
        if row["peer"] is None or mine is None:
            continue
        pair = {"engine": row["engine"], "peer": row["peer"], "row": mine["name"], "peer_row": row["name"]}
        found.append({**pair, "times": row["ns"]["median"] / mine["ns"]["median"]})
    return found


def _print_rows(rows: list[dict[str, Any]]) -> None:
    lines = []
    for row in rows:
        ns = row["ns"]
        engine = "floor" if row["name"].startswith("floor") else "Python" if row["engine"] == "python" else "C"
        times = [f"{ns[key]:.0f}" for key in ("median", "min", "max")]
        ratio = f"{row['ratio']:.2f}" if row["ratio"] else ""
        lines.append([engine, row["name"], row["what"], *times, f"{1e6 / ns['median']:.0f}", ratio, row["floor"] or ""])
    print(table(["", "call", "what", "ns", "min", "max", "k/s", "ratio", "to"], lines, left=3))


def _print_comparisons(config: dict[str, Any]) -> None:
    ns = {(row["engine"], row["name"]): row["ns"]["median"] for row in config["rows"]}
    lines = []
    for c in config["comparisons"]:
        engine, peer = ("C", "tf2 in C++") if c["engine"] == "native" else ("Python", "tf2_py")
        mine, theirs = ns[c["engine"], c["row"]], ns[c["engine"], c["peer_row"]]
        lines.append([engine, peer, c["row"], f"{mine:.0f}", f"{theirs:.0f}", f"{c['times']:.1f}"])
    if lines:
        print("\n" + table(["from", "beside", "call", "shmtf ns", "tf2 ns", "tf2 / shmtf"], lines, left=3))


def _print(config: dict[str, Any]) -> None:
    print(f"\n{config['frames']} frames, history {config['history']}")
    if config["skipped"]:
        print(f"  skipped: {config['skipped']}")
        return
    _print_rows(config["rows"])
    _print_comparisons(config)
    for peer in ("tf2", "tf2_py"):
        if config[f"without_{peer}"]:
            print(f"  without {peer}: {config[f'without_{peer}']}")


def run(args: argparse.Namespace) -> int:
    from ._peers import lacks, missing

    _settle(args)
    check_writable(args.json)
    description = describe()
    print(headline(description))
    rounds = f"median of {args.rounds} interleaved rounds, smallest, largest"
    print(f"lookups over {args.depth} edges, updates of {_WRITE_LEN} frames; ns of processor time per call: {rounds}")
    absent = missing(args.engine) if args.peers else []
    notes = absent + (lacks(["tf2"]) if args.peers and len(absent) < len(args.engine) else [])
    for note in notes:
        print(f"note: {note}")
    configurations = []
    for history in args.history:
        for frames in args.frames:
            progress(f"{frames} frames, history {history} ...")
            configurations.append(_configuration(frames, history, args))
            progress("")
            _print(configurations[-1])
    left_out = ("json", "command", "frames", "history")
    parameters = {key: value for key, value in vars(args).items() if key not in left_out}
    result = {"parameters": parameters, "notes": notes, "configurations": configurations}
    write_json(args.json, {"kind": "micro", **description, **result})
    return 0
