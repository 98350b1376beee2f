# SPDX-License-Identifier: Apache-2.0
"""`shmtf-bench ycsb`: the workloads of the thesis (chapter 5), with processes instead of threads."""

from __future__ import annotations

import argparse
import statistics
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from . import BenchError
from ._arguments import counts, not_negative, positive, ratio, words
from ._report import check_writable, duration, progress, quantity, share, spread, table, write_json

if TYPE_CHECKING:
    from ._team import Team


@dataclass(frozen=True)
class Workload:
    """What is run: everything but the protocols and the numbers of processes."""

    engine: str = "native"  # or "python"
    frames: int = 10000
    history: int = 16
    read_len: int = 16
    write_len: int = 16
    by: str = "name"  # or "handle"
    frequency: float = 0.0  # operations per second of one process; 0: no pause
    opposite: bool = False
    check_every: int = 8
    read_ratio: float = 0.5
    kind: str = "uniform"  # or "mixed-rate"
    duration: float = 5.0
    warm_up: float = 0.3
    rounds: int = 3


_WORKLOADS = {"A": 0.5, "B": 0.95, "C": 1.0}
_LATENCY = ("mean", "p50", "p99", "p99_9", "max")


def _protocols() -> list[str]:
    from .. import _bench

    return list(_bench.protocols())


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--workload", choices=list(_WORKLOADS), help="A 50 %%, B 95 %%, C 100 %% reads (A)")
    which.add_argument("--read-ratio", type=ratio, metavar="R", help="another share of reads")
    add("--processes", type=counts(1), default=[1, 2, 4, 8], metavar="N,N", help="(1,2,4,8)")
    add("--frames", type=positive(int, 1e7), default=10000, metavar="N", help="frames of the chain (10000)")
    add("--history", type=positive(int, 1e6), default=16, metavar="N", help="records kept per frame (16)")
    add("--read-len", type=positive(int), default=16, metavar="N", help="edges per lookup (16)")
    add("--write-len", type=positive(int), default=16, metavar="N", help="frames per update (16)")
    add("--frequency", type=not_negative(float), default=0.0, metavar="HZ", help="per process; 0: no pause (0)")
    add(
        "--opposite-write",
        dest="opposite",
        action="store_true",
        help="give updates from root to leaf; lookups climb from leaf to root",
    )
    add("--duration", type=positive(float), default=5.0, metavar="S", help="seconds counted per round (5)")
    add("--warm-up", type=not_negative(float), default=0.3, metavar="S", help="seconds before that (0.3)")
    add("--rounds", type=positive(int), default=3, metavar="N", help="rounds, interleaved over the protocols (3)")
    add("--protocol", type=words(_protocols), default=["shmtf", "giant"], metavar="P,P", help="(shmtf,giant)")
    add("--engine", choices=["native", "python"], default="native", help="loops in C, or what a Python node gets")
    add("--by", choices=["name", "handle"], default="name", help="how operations give their frames (name)")
    add(
        "--check-every",
        type=not_negative(int),
        default=8,
        metavar="N",
        help="lookups per one whose stamps are looked at (8)",
    )
    add("--json", metavar="FILE", help="write the result there")


def _settle(args: argparse.Namespace) -> list[str]:
    """Check what argparse cannot, and return what the reader must be told."""
    notes = []
    if max(args.read_len, args.write_len) >= args.frames:
        raise BenchError("--frames must be more than --read-len and --write-len")
    if args.engine == "python":
        if args.protocol == ["shmtf", "giant"]:
            args.protocol = ["shmtf"]
            notes.append("the Python engine drives shmtf only: the other protocols exist in C")
        if args.protocol != ["shmtf"]:
            raise BenchError("--engine python drives --protocol shmtf only: the other protocols exist in C")
        args.by = "name"
    if args.read_ratio is None:
        args.workload = args.workload or "A"
        args.read_ratio = _WORKLOADS[args.workload]
    if args.opposite and "shmtf" in args.protocol:
        notes.append("--opposite-write: shmtf locks in the order of frame ids whatever the order given")
    return notes


def _roles(processes: int, read_ratio: float) -> tuple[int, bool]:
    """How many only read; and whether, the rarer kind being less than one process, a coin decides each operation."""
    rarer = min(read_ratio, 1 - read_ratio) * processes
    if 0 < rarer < 1 - 1e-9:
        return 0, True
    return round(read_ratio * processes), False


def _case(rounds: list[dict[str, Any]], duration_s: float) -> dict[str, Any]:
    """All rounds of one protocol and number of processes."""
    return {
        "reads_per_s": spread(r["reads"] / duration_s for r in rounds),
        "writes_per_s": spread(r["writes"] / duration_s for r in rounds),
        "read_ns": _middle(rounds, "read_ns"),
        "write_ns": _middle(rounds, "write_ns"),
        "retries_per_read": _share(rounds, "read_retries", "reads"),
        "retries_per_write": _share(rounds, "write_retries", "writes"),
        "mixed_reads": _share(rounds, "mixed", "checked"),
        "checked_reads": sum(r["checked"] for r in rounds),
        "failures": sum(r["failures"] for r in rounds),
        "age_oldest_ns": _middle(rounds, "age_oldest_ns"),
        "age_mean_ns": _middle(rounds, "age_mean_ns"),
        "span_ns": _middle(rounds, "span_ns"),
        "deviation_ns": _middle(rounds, "deviation_ns"),
        "cpu_share": spread(r["cpu_ns"] / 1e9 / duration_s for r in rounds),
        "cpu_ns_per_operation": spread(r["cpu_ns"] / max(1, r["reads"] + r["writes"]) for r in rounds),
        "least_operations": min(reads + writes for r in rounds for reads, writes in r["workers"]),
        "rounds": rounds,
    }


def _middle(rounds: list[dict[str, Any]], key: str) -> dict[str, float] | None:
    """Median over the rounds of each number of a histogram, but the largest of the largest."""
    found = [r[key] for r in rounds if r[key]]
    if not found:
        return None
    middle = {name: statistics.median(f[name] for f in found) for name in ("count", "mean", "p50", "p99", "p99_9")}
    return {**middle, "max": max(f["max"] for f in found)}


def _share(rounds: list[dict[str, Any]], part: str, whole: str) -> float | None:
    n = sum(r[whole] for r in rounds)
    return sum(r[part] for r in rounds) / n if n else None


def measure(workload: Workload, protocols: list[str], processes: list[int]) -> list[dict[str, Any]]:
    """One case for each number of processes and each protocol, in this order."""
    from ._team import Job, Team

    job = Job(
        engine=workload.engine,
        frames=workload.frames,
        history=workload.history,
        read_len=workload.read_len,
        write_len=workload.write_len,
        by_name=workload.by == "name",
        frequency=workload.frequency,
        opposite=workload.opposite,
        check_every=workload.check_every,
    )
    cases = []
    for n in processes:
        with Team(job, protocols, n) as team:  # fresh memory: what the last ones left in it does not count
            cases += _measure_one(team, workload, protocols, n)
        for case in cases[-len(protocols) :]:
            _print_failures(case)
    return cases


def _measure_one(team: Team, workload: Workload, protocols: list[str], processes: int) -> list[dict[str, Any]]:
    """All protocols with this number of processes, round by round."""
    from .. import _bench
    from ._team import Phase

    readers, coin = _roles(processes, workload.read_ratio)
    pinned = processes <= len(_bench.cpus())
    found: list[list[dict[str, Any]]] = [[] for _ in protocols]
    for k in range(workload.rounds):
        for protocol, name in enumerate(protocols):
            progress(f"{processes} processes, round {k + 1} of {workload.rounds}, {name} ...")
            phase = Phase(protocol, processes, readers, coin, workload.read_ratio, pinned)
            found[protocol].append(team.run(phase, workload.warm_up, workload.duration, 1 + k))
    roles = {"readers": None if coin else readers, "coin": coin, "pinned": pinned}
    return [
        {"protocol": name, "processes": processes, **roles, **_case(rounds, workload.duration)}
        for name, rounds in zip(protocols, found, strict=True)
    ]


def _print_failures(case: dict[str, Any]) -> None:
    if case["failures"]:
        why = next(r["first_failure"] for r in case["rounds"] if r["failures"])
        print(f"  {case['protocol']}, {case['processes']} processes: {case['failures']} operations failed: {why}")


def _mix(case: dict[str, Any]) -> str:
    if case["coin"]:
        return "coin"
    return f"{case['readers']} r + {case['processes'] - case['readers']} w"


def _rate(rate: dict[str, float]) -> str:
    if not rate["max"]:
        return "-"
    return f"{quantity(rate['median'])} ({quantity(rate['min'])} .. {quantity(rate['max'])})"


def _print(cases: list[dict[str, Any]], args: argparse.Namespace) -> None:
    head = ["processes", "mix", "protocol", "reads/s", "updates/s", "retries", "mixed", "age", "span", "CPU", "least"]
    rows = []
    for c in cases:
        age, span = c["age_oldest_ns"], c["span_ns"]
        rows.append(
            [
                str(c["processes"]),
                _mix(c),
                c["protocol"],
                _rate(c["reads_per_s"]),
                _rate(c["writes_per_s"]),
                "-" if c["retries_per_write"] is None else share(c["retries_per_write"], 1),
                "-" if c["mixed_reads"] is None else share(c["mixed_reads"], 1),
                duration(age["p50"] if age else None),
                duration(span["p50"] if span else None),
                share(c["cpu_share"]["median"], c["processes"]),
                quantity(c["least_operations"] / args.duration) + "/s",
            ]
        )
    print(table(head, rows, left=3))
    print(f"  update: {args.write_len} frames; retries: per update; mixed: lookups that saw half an update; age, span:")
    print("  of the stamps of a lookup, now - oldest and newest - oldest, median; least: the slowest process\n")
    head = ["processes", "protocol", "", *(name.replace("_", ".") for name in _LATENCY)]
    rows = []
    for c in cases:
        for kind in ("read", "write"):
            h = c[f"{kind}_ns"]
            if h:
                rows.append([str(c["processes"]), c["protocol"], kind, *(duration(h[name]) for name in _LATENCY)])
    print(table(head, rows, left=3))


def _title(args: argparse.Namespace) -> str:
    name = f"workload {args.workload}" if args.workload else "workload"
    pace = f", {args.frequency:g} Hz per process" if args.frequency else ""
    engine = "C" if args.engine == "native" else "Python"
    rounds = f"{args.rounds} rounds of {args.duration:g} s"
    return (
        f"{name}: {100 * args.read_ratio:g} % reads; {args.frames} frames, lookups over {args.read_len} edges, updates "
        f"of {args.write_len} frames, by {args.by}{pace}; loops in {engine}; median of {rounds} (smallest .. largest)"
    )


def run(args: argparse.Namespace) -> int:
    from ._machine import describe, headline

    notes = _settle(args)
    check_writable(args.json)
    description = describe()
    print(headline(description))
    print(_title(args))
    if any(_roles(n, args.read_ratio)[1] for n in args.processes):
        notes.append("coin: with so few processes the rarer kind is less than one, so each operation is drawn")
    for note in notes:
        print(f"note: {note}")
    print()
    workload = Workload(**{key: value for key, value in vars(args).items() if key in Workload.__dataclass_fields__})
    cases = measure(workload, args.protocol, args.processes)
    _print(cases, args)
    left_out = ("json", "command")
    parameters = {key: value for key, value in vars(args).items() if key not in left_out}
    write_json(args.json, {"kind": "ycsb", **description, "parameters": parameters, "notes": notes, "cases": cases})
    return 1 if any(c["failures"] for c in cases) else 0
