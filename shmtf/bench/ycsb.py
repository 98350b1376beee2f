# SPDX-License-Identifier: Apache-2.0
"""`shmtf-bench ycsb`: the workloads of the thesis (chapter 5), with processes instead of threads."""

from __future__ import annotations

import argparse
import os
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from . import BenchError
from ._arguments import counts, not_negative, positive, ratio, words
from ._report import Bar, check_writable, write_json

if TYPE_CHECKING:
    from ._team import Team

MOST_PROCESSES = 1024
_RATIOS = {"A": 0.5, "B": 0.95, "C": 1.0, "mixed-rate": 0.5}
_RECORD_BYTES = 104  # of a ring, per slot
_AT_ONCE_BYTES = 2 << 30  # memory that rounds interleaved over the numbers of processes may take


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


# a robot's chain; a history that covers two periods of the slow edge at the fastest rate
MIXED_RATE = Workload(kind="mixed-rate", frames=65, history=512, write_len=1)


def _protocols() -> list[str]:
    from . import _protocols

    return list(dict.fromkeys([*_protocols.names("native"), *_protocols.names("python")]))


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    which = parser.add_mutually_exclusive_group()
    which.add_argument(
        "--workload",
        choices=list(_RATIOS),
        help="A 50 %%, B 95 %%, C 100 %% reads; mixed-rate: one edge at 1 Hz, the others at 30 to 200 Hz (A)",
    )
    which.add_argument("--read-ratio", type=ratio, metavar="R", help="another share of reads")
    add("--processes", type=counts(1), default=[1, 2, 4, 8], metavar="N,N", help="(1,2,4,8)")
    add("--frames", type=positive(int, 1e7), metavar="N", help="frames of the chain (10000; mixed-rate: 65)")
    add("--history", type=positive(int, 1e6), metavar="N", help="records kept per frame (16; mixed-rate: 512)")
    add("--read-len", type=positive(int), default=16, metavar="N", help="edges per lookup (16)")
    add("--write-len", type=positive(int), metavar="N", help="frames per update (16; mixed-rate: 1)")
    add("--frequency", type=not_negative(float), default=0.0, metavar="HZ", help="per process; 0: no pause (0)")
    add(
        "--opposite-write",
        dest="opposite",
        action="store_true",
        help="give updates from root to leaf; lookups climb from leaf to root",
    )
    add("--duration", type=positive(float), default=5.0, metavar="S", help="seconds counted per round (5)")
    add("--warm-up", type=not_negative(float), default=0.3, metavar="S", help="seconds before that (0.3)")
    add("--rounds", type=positive(int), default=3, metavar="N", help="rounds, interleaved over all rows (3)")
    add("--protocol", type=words(_protocols), metavar="P,P", help="some of those that --list shows (shmtf,giant)")
    add("--list", action="store_true", help="say which protocols there are, and stop")
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


# ---- measuring ----


def _roles(processes: int, workload: Workload) -> tuple[int, bool]:
    """How many only read; and whether, the rarer kind being less than one process, a coin decides each operation."""
    ratio = workload.read_ratio
    if workload.kind == "mixed-rate":
        return min(processes - 1, max(1, round(ratio * processes))), False
    rarer = min(ratio, 1 - ratio) * processes
    if 0 < rarer < 1 - 1e-9:
        return 0, True
    return round(ratio * processes), False


def _check(workload: Workload, protocols: list[str], processes: list[int]) -> None:
    from ._protocols import names

    if max(workload.read_len, workload.write_len) >= workload.frames:
        raise BenchError(
            f"{workload.frames} frames: must be more than the edges of a lookup ({workload.read_len}) "
            f"and the frames of an update ({workload.write_len})"
        )
    if max(processes) > MOST_PROCESSES:
        raise BenchError(f"{max(processes)} processes: at most {MOST_PROCESSES}")
    for protocol in protocols:
        if protocol not in names(workload.engine):
            raise BenchError(f"--engine {workload.engine} has no {protocol}, but: {', '.join(names(workload.engine))}")
    if workload.kind != "mixed-rate":
        return
    if workload.engine != "native":
        raise BenchError("mixed-rate runs with --engine native only")
    if workload.write_len != 1:
        raise BenchError(f"--write-len {workload.write_len}: mixed-rate writes one frame at a time, each at its rate")
    if min(processes) < 2:
        raise BenchError("mixed-rate needs a reader and a writer: --processes 2 or more")
    if not workload.warm_up:
        raise BenchError("--warm-up 0: mixed-rate needs some, in which every edge is written once")


def measure(workload: Workload, protocols: list[str], processes: list[int]) -> list[dict[str, Any]]:
    """One case for each number of processes and each protocol, in this order."""
    _check(workload, protocols, processes)
    chunks = [processes] if _fits_at_once(workload, len(protocols) * len(processes)) else [[n] for n in processes]
    cases: list[dict[str, Any]] = []
    with Bar(workload.rounds * len(protocols) * len(processes)) as bar:
        for chunk in chunks:
            cases += _measure_interleaved(workload, protocols, chunk, bar)
    for case in cases:
        _print_failures(case)
    return cases


def _fits_at_once(workload: Workload, n_stores: int) -> bool:
    """May the memory of all rows exist at the same time?"""
    free = os.statvfs("/dev/shm")
    room = min(_AT_ONCE_BYTES, free.f_bavail * free.f_frsize // 4)
    return n_stores * workload.frames * 2 * workload.history * _RECORD_BYTES < room


def _measure_interleaved(
    workload: Workload, protocols: list[str], processes: list[int], bar: Bar
) -> list[dict[str, Any]]:
    """Every row once per round, so that a disturbance hits a round and not a row; each round begins with another."""
    from .. import _bench
    from ._cases import case
    from ._protocols import has_common_time
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
        mixed_rate=workload.kind == "mixed-rate",
        check_every=workload.check_every,
    )
    rows = [(n, name) for n in processes for name in protocols]
    found: dict[tuple[int, str], list[dict[str, Any]]] = {row: [] for row in rows}
    with ExitStack() as stack:
        teams = {n: stack.enter_context(Team(job, protocols, n)) for n in processes}
        for k in range(workload.rounds):
            for n, name in rows[k % len(rows) :] + rows[: k % len(rows)]:
                bar.begin(f"round {k + 1} of {workload.rounds}, {n} processes, {name} ...")
                found[n, name].append(_run(teams[n], workload, name, n, 1 + k))
    cases = []
    for n, name in rows:
        readers, coin = _roles(n, workload)
        mixtures = workload.write_len > 1 and not has_common_time(workload.engine, name)
        numbers = case(found[n, name], workload.duration, None if coin else readers, mixtures)
        roles = {"readers": None if coin else readers, "coin": coin, "pinned": _is_pinned(n)}
        if workload.kind == "mixed-rate":
            numbers["asked_writes_per_s"] = _bench.mixed_rate(workload.frames)
        cases.append({"protocol": name, "processes": n, **roles, **numbers})
    return cases


def _is_pinned(processes: int) -> bool:
    from .. import _bench

    return processes <= len(_bench.cpus())


def _run(team: Team, workload: Workload, protocol: str, processes: int, seed: int) -> dict[str, Any]:
    from ._team import Phase

    readers, coin = _roles(processes, workload)
    phase = Phase(protocol, processes, readers, coin, workload.read_ratio, _is_pinned(processes))
    return team.run(phase, workload.warm_up, workload.duration, seed)


def _print_failures(case: dict[str, Any]) -> None:
    if case["failures"]:
        why = next(r["first_failure"] for r in case["rounds"] if r["failures"])
        if case["protocol"].endswith("-common"):
            why += " (the newest common time lies before it: more --history keeps more)"
        print(f"  {case['protocol']}, {case['processes']} processes: {case['failures']} operations failed: {why}")


# ---- the command ----


def _workload(args: argparse.Namespace) -> Workload:
    name = args.workload or ("A" if args.read_ratio is None else None)
    given = {key: value for key, value in vars(args).items() if key in Workload.__dataclass_fields__}
    given = {key: value for key, value in given.items() if value is not None}
    if name:
        given["read_ratio"] = _RATIOS[name]
    if args.engine == "python":
        given["by"] = "name"
    return Workload(**{**asdict(MIXED_RATE if name == "mixed-rate" else Workload()), **given})


def _default_protocols(workload: Workload) -> list[str]:
    if workload.engine == "python":
        return ["shmtf", "numpy-lock"]
    return ["shmtf", "shmtf-common"] if workload.kind == "mixed-rate" else ["shmtf", "giant"]


def _notes(workload: Workload, protocols: list[str], processes: list[int]) -> list[str]:
    """What the reader must be told."""
    from . import _protocols, _transfers
    from ._peers import lacks

    notes = [*_protocols.notes(workload.engine), *lacks(protocols)]
    if workload.opposite:
        notes += _protocols.opposite_notes(protocols)
    if any(_roles(n, workload)[1] for n in processes):
        notes.append("coin: with so few processes the rarer kind is less than one, so each operation is drawn")
    if _transfers.event() is None:
        notes.append("no count of cache lines from other cores: no perf here, or no such event on this machine")
    return notes


def _title(workload: Workload, name: str | None) -> str:
    pace = f", {workload.frequency:g} Hz per process" if workload.frequency else ""
    engine = "C" if workload.engine == "native" else "Python"
    rounds = f"{workload.rounds} rounds of {workload.duration:g} s"
    frames = "1 frame" if workload.write_len == 1 else f"{workload.write_len} frames"
    which = f"workload {name}" if name else "workload"
    return (
        f"{which}: {100 * workload.read_ratio:g} % reads; {workload.frames} frames, lookups "
        f"over {workload.read_len} edges, updates of {frames}, by {workload.by}{pace}; loops in {engine}; "
        f"median of {rounds} (smallest .. largest)"
    )


def _print_protocols() -> int:
    from . import _protocols

    for engine in ("native", "python"):
        print(f"--engine {engine}")
        for name in _protocols.names(engine):
            print(f"  {name:14}{_protocols.what(engine, name)}")
        for note in _protocols.notes(engine):
            print(f"  note: {note}")
    return 0


def run(args: argparse.Namespace) -> int:
    from ._machine import describe, headline
    from ._ycsb_tables import tables

    if args.list:
        return _print_protocols()
    workload = _workload(args)
    protocols = args.protocol or _default_protocols(workload)
    _check(workload, protocols, args.processes)
    check_writable(args.json)
    description = describe()
    notes = _notes(workload, protocols, args.processes)
    name = args.workload or ("A" if args.read_ratio is None else None)
    print(headline(description))
    print(_title(workload, name))
    for note in notes:
        print(f"note: {note}")
    print()
    cases = measure(workload, protocols, args.processes)
    print(tables(cases, workload.write_len))
    parameters = {**asdict(workload), "workload": name, "protocol": protocols, "processes": args.processes}
    write_json(args.json, {"kind": "ycsb", **description, "parameters": parameters, "notes": notes, "cases": cases})
    return 1 if any(c["failures"] for c in cases) else 0
