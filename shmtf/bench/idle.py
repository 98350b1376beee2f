# SPDX-License-Identifier: Apache-2.0
"""`shmtf-bench idle`: what processes cost that do nothing, while another one writes."""

from __future__ import annotations

import argparse
import os
import statistics
import time
from typing import TYPE_CHECKING, Any

from ._arguments import counts, positive
from ._report import Bar, check_writable, duration, quantity, spread, table, write_json

if TYPE_CHECKING:
    from ._crew import Crew, Member
    from ._member import Link

_ROOT = "map"
_START_S = 0.2  # before the clocks are read: everybody has gone to sleep
_MODES = ("attached", "waiting")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("--processes", type=counts(0), default=[0, 1, 8, 32], metavar="N,N", help="idle processes (0,1,8,32)")
    add("--rate", type=positive(float, 100000), default=1000.0, metavar="HZ", help="commits of the writer (1000)")
    add("--frames", type=positive(int, 10000), default=16, metavar="N", help="frames it writes, in turn (16)")
    add("--duration", type=positive(float), default=3.0, metavar="S", help="seconds counted per round (3)")
    add("--rounds", type=positive(int, 99), default=3, metavar="N", help="rounds, interleaved over the modes (3)")
    add("--json", metavar="FILE", help="write the result there")


# ---- the processes' side ----


def _usage() -> tuple[int, int]:
    """Processor time in ns, and how often this process went to sleep."""
    import resource

    return time.process_time_ns(), resource.getrusage(resource.RUSAGE_SELF).ru_nvcsw


def _sleep_until(ns: int) -> None:
    time.sleep(max(0.0, (ns - time.monotonic_ns()) / 1e9))


def sleeper(link: Link) -> None:
    """Attached only, or in a lookup of a frame that does not come.  Tells processor time and sleeps."""
    import shmtf

    told = link.hear()
    store = shmtf.Store.attach(told["store"])
    # opens the bell, which is found by a name that is removed once all members are ready
    store.can_transform(_ROOT, "nobody", timeout=0.001)
    link.tell("ready")
    while True:
        order = link.hear()
        _sleep_until(order["start_ns"])
        before, sleeps = _usage()
        while (left_ns := order["end_ns"] - time.monotonic_ns()) > 0:
            if order["mode"] == "waiting":
                store.can_transform(_ROOT, "nobody", timeout=left_ns / 1e9)
            else:
                time.sleep(left_ns / 1e9)
        after, sleeps_after = _usage()
        link.tell({"cpu_ns": after - before, "sleeps": sleeps_after - sleeps})


def writer(link: Link) -> None:
    """Writes its frames in turn, at a rate.  Tells processor time and commits."""
    import shmtf

    told = link.hear()
    store = shmtf.Store.attach(told["store"])
    names = [f"frame_{i}" for i in range(told["frames"])]
    for name in names:
        store.set_transform(shmtf.Transform(_ROOT, name))
    link.tell("ready")
    period_ns = int(1e9 / told["rate"])
    while True:
        order = link.hear()
        due = order["start_ns"]
        _sleep_until(due)
        before, _ = _usage()
        commits = 0
        while due < order["end_ns"]:
            store.set_transform(shmtf.Transform(_ROOT, names[commits % len(names)]))
            commits += 1
            due += period_ns
            _sleep_until(due)
        after, _ = _usage()
        link.tell({"cpu_ns": after - before, "commits": commits})


# ---- the coordinator's ----


def _assemble(crew: Crew, processes: int, args: argparse.Namespace) -> tuple[Member, list[Member]]:
    """A store without a name, and everybody attached to it."""
    import shmtf

    name = f"shmtf-bench-{os.getpid()}-idle"
    store = shmtf.Store.create(name, args.frames + 8, 16, stream_bytes=0)
    try:
        source = crew.add("idle", "writer", store=name, frames=args.frames, rate=args.rate)
        sleepers = [crew.add("idle", "sleeper", store=name) for _ in range(processes)]
        crew.hear_all()
    finally:
        store.close()
        shmtf.Store.unlink(name)
    return source, sleepers


def _round(mode: str, source: Member, sleepers: list[Member], duration_s: float) -> dict[str, Any]:
    start = time.monotonic_ns() + int(_START_S * 1e9)
    end = start + int(duration_s * 1e9)
    for member in (*sleepers, source):
        member.tell(mode=mode, start_ns=start, end_ns=end)
    busy_s = _START_S + duration_s
    wrote = source.hear(busy_s)
    slept = [member.hear(busy_s) for member in sleepers]
    shares = [s["cpu_ns"] / 1e9 / duration_s for s in slept]
    return {
        "cpu_share": statistics.median(shares) if shares else None,
        "cpu_share_max": max(shares, default=None),
        "cpu_share_all": sum(shares),
        "sleeps_per_s": statistics.median(s["sleeps"] for s in slept) / duration_s if slept else None,
        "writer_cpu_share": wrote["cpu_ns"] / 1e9 / duration_s,
        "writer_cpu_ns_per_commit": wrote["cpu_ns"] / max(1, wrote["commits"]),
        "commits_per_s": wrote["commits"] / duration_s,
    }


def _case(mode: str, processes: int, rounds: list[dict[str, Any]]) -> dict[str, Any]:
    numbers = {key: spread(r[key] for r in rounds) if rounds[0][key] is not None else None for key in rounds[0]}
    return {"mode": mode, "processes": processes, **numbers, "rounds": rounds}


def _measure(args: argparse.Namespace) -> list[dict[str, Any]]:
    from ._crew import Crew

    cases = []
    modes = {n: _MODES if n else ("nobody",) for n in args.processes}
    with Bar(args.rounds * sum(len(m) for m in modes.values())) as bar:
        for processes in args.processes:
            found: dict[str, list[dict[str, Any]]] = {mode: [] for mode in modes[processes]}
            with Crew() as crew:
                source, sleepers = _assemble(crew, processes, args)
                for k in range(args.rounds):
                    for mode, rounds in found.items():
                        bar.begin(f"{processes} processes, {mode}, round {k + 1} of {args.rounds}")
                        rounds.append(_round(mode, source, sleepers, args.duration))
            cases += [_case(mode, processes, rounds) for mode, rounds in found.items()]
    return cases


def _percent(value: float | None) -> str:
    return "-" if value is None else f"{100 * value:.3f} %"


def _print(cases: list[dict[str, Any]]) -> None:
    def middle(case: dict[str, Any], key: str, which: str = "median") -> float | None:
        return case[key][which] if case[key] else None

    rows = []
    for c in cases:
        cells = [_percent(middle(c, "cpu_share")), _percent(middle(c, "cpu_share_max", "max"))]
        sleeps = middle(c, "sleeps_per_s")
        cells += [_percent(c["cpu_share_all"]["median"]), "-" if sleeps is None else quantity(sleeps)]
        cells += [_percent(c["writer_cpu_share"]["median"]), duration(c["writer_cpu_ns_per_commit"]["median"])]
        rows.append([str(c["processes"]), c["mode"], *cells, quantity(c["commits_per_s"]["median"])])
    head = ["idle", "mode", "CPU each", "most", "all", "sleeps/s", "writer's CPU", "per commit", "commits/s"]
    print(table(head, rows, left=2))
    print("  100 %: one CPU; waiting: in a lookup, with a timeout, of a frame that nobody writes;")
    print("  per commit: the writer's processor time, Python's loop and its sleep included;")
    print("  with tf2 each of them is a listener, which receives, parses and stores every message itself: its CPU")
    print("  grows with the rate of all writers together, and the publisher sends once more for each; not run here")


def run(args: argparse.Namespace) -> int:
    from ._machine import describe, headline

    check_writable(args.json)
    description = describe()
    print(headline(description))
    text = f"a writer commits {args.rate:g} times a second, in turn to {args.frames} frames"
    print(f"{text}; median of {args.rounds} rounds of {args.duration:g} s\n")
    cases = _measure(args)
    _print(cases)
    parameters = {key: value for key, value in vars(args).items() if key not in ("json", "command")}
    write_json(args.json, {"kind": "idle", **description, "parameters": parameters, "cases": cases})
    return 0
