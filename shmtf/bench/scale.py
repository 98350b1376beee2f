# SPDX-License-Identifier: Apache-2.0
"""`shmtf-bench scale`: what a lookup and an update cost by frames, depth, history and processes, and which lines of
shared memory they write."""

from __future__ import annotations

import argparse
from typing import Any

from ._arguments import counts, positive, words
from ._report import Bar, check_writable, duration, quantity, spread, table, write_json

_SWEEPS = ["frames", "depth", "history", "processes", "lines"]
_BASE = {"frames": 10000, "history": 16, "depth": 16}
_FRAMES_OF_HISTORY = 1000  # where the history is long
_ROWS = ("first", "latest handle", "latest name", "any time handle", "write 1", "write depth")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("--sweep", type=words(lambda: _SWEEPS), default=_SWEEPS, metavar="S,S", help=f"({','.join(_SWEEPS)})")
    add("--frames", type=counts(17), default=[100, 1000, 10000, 100000, 1000000], metavar="N,N", help="(10^2 to 10^6)")
    add("--depth", type=counts(1), default=[1, 4, 16, 64, 256], metavar="N,N", help="edges (1,4,16,64,256)")
    add("--history", type=counts(4), default=[16, 64, 256, 1024, 4096], metavar="N,N", help="records (16 to 4096)")
    add("--processes", type=counts(1), default=[1, 2, 4, 8, 16], metavar="N,N", help="(1,2,4,8,16)")
    add("--lines", type=counts(1), default=[1, 16, 64], metavar="N,N", help="frames of a commit (1,16,64)")
    add("--rounds", type=positive(int, 99), default=5, metavar="N", help="rounds of all rows, interleaved (5)")
    add("--round-ms", type=positive(float), default=20.0, metavar="MS", help="per row and round (20)")
    add("--cpu", type=int, default=-1, metavar="N", help="the N-th of the usable CPUs; -1, the default: the last")
    add("--json", metavar="FILE", help="write the result there")


def _sizes(sweep: str, args: argparse.Namespace) -> list[dict[str, int]]:
    if sweep == "frames":
        return [{**_BASE, "frames": n} for n in args.frames]
    if sweep == "depth":
        return [{**_BASE, "depth": n, "frames": max(_BASE["frames"], 2 * n)} for n in args.depth]
    return [{**_BASE, "history": n, "frames": _FRAMES_OF_HISTORY} for n in args.history]


def measure_size(size: dict[str, int], rounds: int, round_ns: int, cpu: int = -1) -> dict[str, Any]:
    """ns of processor time per call in a chain of this size; `rows` is empty where shared memory is too small."""
    from .. import _bench

    found = _bench.scale(size["frames"], size["history"], size["depth"], rounds, round_ns, cpu)
    rows = {name: {"what": what, "ns": {"median": m, "min": a, "max": z}} for name, what, m, a, z in found or []}
    return {**size, "rows": rows, "skipped": None if found else "shared memory is too small"}


def _measure_processes(args: argparse.Namespace) -> list[dict[str, Any]]:
    from .ycsb import Workload, measure

    duration_s = max(0.1, args.rounds * args.round_ms / 1e3)
    workload = Workload(read_ratio=0.5, duration=duration_s, warm_up=min(0.3, duration_s), rounds=args.rounds)
    cases = []
    for case in measure(workload, ["shmtf"], args.processes):
        kept = {key: case[key] for key in ("processes", "readers", "coin", "reads_per_s", "writes_per_s")}
        for kind in ("read_ns", "write_ns"):
            found = [r[kind] for r in case["rounds"] if r[kind]]
            kept[kind] = {q: spread(f[q] for f in found) for q in ("p50", "p99")} if found else None
        cases.append({"sweep": "processes", **kept})
    return cases


def _measure_sweep(sweep: str, args: argparse.Namespace, bar: Bar) -> list[dict[str, Any]]:
    if sweep == "processes":
        bar.begin("processes", weight=len(args.processes))
        return _measure_processes(args)
    if sweep == "lines":
        from ._lines import lines_of_commits, lines_of_lookups

        bar.begin("lines")
        return [{"sweep": "lines", **case} for case in (lines_of_lookups(), *map(lines_of_commits, args.lines))]
    cases = []
    for size in _sizes(sweep, args):
        bar.begin(", ".join(f"{key} {value}" for key, value in size.items()), weight=1 + size["frames"] / 50000)
        found = measure_size(size, args.rounds, int(args.round_ms * 1e6), args.cpu)
        cases.append({"sweep": sweep, **found})
    return cases


def _weight(sweep: str, args: argparse.Namespace) -> float:
    if sweep == "processes":
        return float(len(args.processes))
    return 1.0 if sweep == "lines" else sum(1 + size["frames"] / 50000 for size in _sizes(sweep, args))


# ---- tables ----


def _print_sizes(sweep: str, cases: list[dict[str, Any]]) -> None:
    rest = {key: value for key, value in cases[0].items() if key in _BASE and key != sweep}
    print(f"\nby {sweep}; " + ", ".join(f"{key} {value}" for key, value in rest.items()))
    rows = []
    for case in cases:
        cells = [duration(case["rows"][name]["ns"]["median"]) if case["rows"] else "-" for name in _ROWS]
        rows.append([str(case[sweep]), *cells, case["skipped"] or ""])
    print(table([sweep, *_ROWS, ""], rows, left=0))


def _print_rows(cases: list[dict[str, Any]]) -> None:
    print()
    rows: dict[str, Any] = next((case["rows"] for case in cases if case.get("rows")), {})
    for name, row in rows.items():
        print(f"  {name}: {row['what']}")


def _print_processes(cases: list[dict[str, Any]]) -> None:
    print(
        f"\nby processes; {_BASE['frames']} frames, half of them write, lookups and updates over {_BASE['depth']} edges"
    )
    rows = []
    for c in cases:
        cells = [quantity(c["reads_per_s"]["median"]), quantity(c["writes_per_s"]["median"])]
        for kind in ("read_ns", "write_ns"):
            cells += [duration(c[kind][q]["median"] if c[kind] else None) for q in ("p50", "p99")]
        rows.append([str(c["processes"]), *cells])
    print(table(["processes", "reads/s", "updates/s", "read p50", "p99", "update p50", "p99"], rows, left=0))


def _print_lines(cases: list[dict[str, Any]]) -> None:
    print("\nlines of 64 bytes of the store that differ after")
    rows = []
    for c in cases:
        lines = c["lines"]
        per_frame = f"{lines['median'] / c['frames']:.2f}" if c["frames"] else ""
        rows.append([c["what"], f"{lines['median']:g}", f"{lines['min']:g}", f"{lines['max']:g}", per_frame])
    print(table(["", "median", "min", "max", "per frame"], rows))
    print("  by comparing the file: a line that is written and then holds what it held before is not seen, nor how")
    print("  often one is written; a lookup runs with a read-only mapping, which could not write if it wanted to")


def _print(sweep: str, cases: list[dict[str, Any]]) -> None:
    if sweep == "processes":
        _print_processes(cases)
    elif sweep == "lines":
        _print_lines(cases)
    else:
        _print_sizes(sweep, cases)


def run(args: argparse.Namespace) -> int:
    from ._machine import describe, headline

    check_writable(args.json)
    description = describe()
    print(headline(description))
    print(f"ns of processor time per call in C: median of {args.rounds} rounds of {args.round_ms:g} ms")
    cases = []
    with Bar(sum(_weight(sweep, args) for sweep in args.sweep)) as bar:
        for sweep in args.sweep:
            found = _measure_sweep(sweep, args, bar)
            _print(sweep, found)
            cases += found
        _print_rows(cases)
    parameters = {key: value for key, value in vars(args).items() if key not in ("json", "command")}
    write_json(args.json, {"kind": "scale", **description, "parameters": parameters, "cases": cases})
    return 0
