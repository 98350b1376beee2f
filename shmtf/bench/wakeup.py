# SPDX-License-Identifier: Apache-2.0
"""`shmtf-bench wakeup`: from a commit until a process that waits for it runs again."""

from __future__ import annotations

import argparse
import os
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ._arguments import counts, positive
from ._report import Bar, check_writable, distribution, duration, spread, table, write_json

if TYPE_CHECKING:
    from ._crew import Crew, Member
    from ._member import Link

PATIENCE_S = 30.0  # of a waiting lookup
_ROOT = "map"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("--waiters", type=counts(1), default=[1, 8], metavar="N,N", help="waiting processes (1,8)")
    add("--n", type=positive(int, 100000), default=300, metavar="N", help="commits per round (300)")
    add("--gap-ms", type=positive(float), default=2.0, metavar="MS", help="between two commits (2)")
    add("--rounds", type=positive(int, 99), default=5, metavar="N", help="rounds, interleaved over the cases (5)")
    add("--json", metavar="FILE", help="write the result there")


@dataclass(frozen=True)
class _Case:
    kind: str  # "semaphore", "same", "different" or "nobody"
    waiters: int

    def order(self, commits: int, base: int) -> dict[str, Any]:
        """What the members are told: stamps above `base` belong to this round."""
        n_frames = self.waiters if self.kind == "different" else 1
        each = commits // n_frames
        return {"kind": self.kind, "n_frames": n_frames, "each": each, "base": base}


_WHAT = {
    "semaphore": "floor: sem_post, sem_wait",
    "nobody": "commits, nobody waits",
    "same": "all wait for one frame",
    "different": "each waits for its own frame",
}


# ---- the processes' side ----


def _semaphore(name: str) -> Any:
    import posix_ipc

    return posix_ipc.Semaphore("/" + name)


def waiter(link: Link) -> None:
    """Tells, per lookup: when it was called, when it returned, how often it slept."""
    import shmtf

    told = link.hear()
    store = shmtf.Store.attach(told["store"])
    semaphore = _semaphore(told["store"])
    # opens the bell, which is found by a name that is removed once all members are ready
    store.can_transform(_ROOT, "nobody", timeout=0.001)
    link.tell("ready")
    while True:
        order = link.hear()
        frame = f"frame_{told['index'] % order['n_frames']}"
        calls = []
        for k in range(order["each"]):
            before = store.counters()["waits"]
            begin = time.monotonic_ns()
            if order["kind"] == "semaphore":
                semaphore.acquire(PATIENCE_S)
            else:
                store.lookup_transform(_ROOT, frame, order["base"] + k + 1, timeout=PATIENCE_S)
            end = time.monotonic_ns()
            calls.append((begin, end, store.counters()["waits"] - before))
        link.tell(calls)


def writer(link: Link) -> None:
    """Tells, per commit: when it was called and when it returned."""
    import shmtf

    told = link.hear()
    store = shmtf.Store.attach(told["store"])
    semaphore = _semaphore(told["store"])
    for frame in range(told["n_frames"]):
        store.set_transform(shmtf.Transform(_ROOT, f"frame_{frame}", 1))
    link.tell("ready")
    while True:
        order = link.hear()
        commits = []
        due = time.monotonic_ns()
        for k in range(order["each"] * order["n_frames"]):
            stamp = order["base"] + k // order["n_frames"] + 1
            transform = shmtf.Transform(_ROOT, f"frame_{k % order['n_frames']}", stamp)
            due += told["gap_ns"]
            time.sleep(max(0.0, (due - time.monotonic_ns()) / 1e9))
            begin = time.monotonic_ns()
            if order["kind"] == "semaphore":
                semaphore.release()
            else:
                store.set_transform(transform)
            commits.append((begin, time.monotonic_ns()))
        link.tell(commits)


# ---- the coordinator's ----


def _assemble(crew: Crew, args: argparse.Namespace) -> tuple[Member, list[Member]]:
    """A store without a name, and everybody attached to it."""
    import posix_ipc

    import shmtf

    from ._member import remove_names

    most = max(args.waiters)
    name = f"shmtf-bench-{os.getpid()}-wakeup"
    store = shmtf.Store.create(name, most + 8, args.n + 16, cache_time=None, stream_bytes=0)
    try:
        posix_ipc.Semaphore("/" + name, posix_ipc.O_CREX, mode=0o600).close()
        told = {"store": name, "n_frames": most, "gap_ns": int(args.gap_ms * 1e6)}
        source = crew.add("wakeup", "writer", **told)
        sinks = [crew.add("wakeup", "waiter", index=i, **told) for i in range(most)]
        crew.hear_all()
    finally:
        store.close()
        remove_names(name)
    return source, sinks


def _round(case: _Case, source: Member, sinks: list[Member], args: argparse.Namespace, base: int) -> dict[str, Any]:
    order = case.order(args.n, base)
    active = sinks[: case.waiters]
    for member in (*active, source):  # the writer's first gap is the time to fall asleep in
        member.tell(**order)
    busy_s = order["each"] * order["n_frames"] * args.gap_ms / 1e3
    commits = source.hear(busy_s)
    wake_ns: list[int] = []
    late = for_nothing = 0
    for index, member in enumerate(active):
        mine = commits[index % order["n_frames"] :: order["n_frames"]]
        for (begin, end, slept), (committed, _) in zip(member.hear(), mine, strict=True):
            if begin > committed:
                late += 1
            else:
                wake_ns.append(end - committed)
            for_nothing += max(0, slept - 1)
    return {
        "wake_ns": distribution(wake_ns),
        "commit_ns": distribution([end - begin for begin, end in commits]),
        "wakes": len(wake_ns),
        "late": late,
        "for_nothing": for_nothing,
    }


def _case(case: _Case, rounds: list[dict[str, Any]]) -> dict[str, Any]:
    result: dict[str, Any] = {"case": case.kind, "waiters": case.waiters}
    for key in ("wake_ns", "commit_ns"):
        found = [r[key] for r in rounds if r[key]]
        result[key] = {q: spread(f[q] for f in found) for q in ("mean", "p50", "p99", "max")} if found else None
    totals = {key: sum(r[key] for r in rounds) for key in ("wakes", "late", "for_nothing")}
    return {**result, **totals, "rounds": rounds}


def _cases(waiters: list[int]) -> list[_Case]:
    cases = [_Case("semaphore", 1), _Case("nobody", 0)]
    for n in waiters:
        cases.append(_Case("same", n))
        if n > 1:
            cases.append(_Case("different", n))
    return cases


def _measure(args: argparse.Namespace) -> list[dict[str, Any]]:
    from ._crew import Crew

    cases = _cases([n for n in args.waiters if n <= args.n])
    found: list[list[dict[str, Any]]] = [[] for _ in cases]
    with Bar(args.rounds * len(cases)) as bar, Crew() as crew:
        source, sinks = _assemble(crew, args)
        base = 1
        for k in range(args.rounds):
            for case, rounds in zip(cases, found, strict=True):
                bar.begin(f"round {k + 1} of {args.rounds}, {_WHAT[case.kind]}, {case.waiters} waiters")
                rounds.append(_round(case, source, sinks, args, base))
                base += args.n
    return [_case(case, rounds) for case, rounds in zip(cases, found, strict=True)]


def _print(cases: list[dict[str, Any]]) -> None:
    def middle(numbers: dict[str, Any] | None, key: str) -> str:
        return duration(numbers[key]["median"] if numbers else None)

    rows = []
    for c in cases:
        wake, commit = c["wake_ns"], c["commit_ns"]
        cells = [middle(wake, "p50"), middle(wake, "p99"), duration(wake["max"]["max"] if wake else None)]
        cells += [middle(commit, "p50"), middle(commit, "p99")]
        cells += [str(c[key]) for key in ("wakes", "for_nothing", "late")]
        rows.append([_WHAT[c["case"]], str(c["waiters"]), *cells])
    head = ["", "waiters", "wake p50", "p99", "max", "commit p50", "p99", "wakes", "for nothing", "late"]
    print(table(head, rows))
    print("  wake: from the call of set_transform until the waiting lookup has returned, both called from Python;")
    print("  commit: the call of set_transform, which wakes who waits; for nothing: slept, woke, slept again;")
    print("  late: the waiter had not yet asked when the commit began, so it did not count")


def run(args: argparse.Namespace) -> int:
    from ._machine import describe, headline

    check_writable(args.json)
    description = describe()
    print(headline(description))
    print(f"median of {args.rounds} rounds of {args.n} commits, {args.gap_ms:g} ms apart; the largest of all rounds\n")
    cases = _measure(args)
    _print(cases)
    parameters = {key: value for key, value in vars(args).items() if key not in ("json", "command")}
    write_json(args.json, {"kind": "wakeup", **description, "parameters": parameters, "cases": cases})
    return 0
