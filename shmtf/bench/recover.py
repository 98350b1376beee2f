# SPDX-License-Identifier: Apache-2.0
"""`shmtf-bench recover`: from the kill of a writer until the next one has written the same frames."""

from __future__ import annotations

import argparse
import os
import random
import time
from typing import TYPE_CHECKING, Any

from ._arguments import counts, positive
from ._report import Bar, check_writable, distribution, duration, share, spread, table, write_json

if TYPE_CHECKING:
    from shmtf import Store, Transform

    from ._member import Link

PATIENCE_S = 30.0  # of the next writer
BATCH = 10  # victims that are attached to one store
LIFE_S = 0.005  # a victim writes for a random time up to this
_ROOT = "map"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("--frames", type=counts(1), default=[1, 16, 64], metavar="N,N", help="frames of one update (1,16,64)")
    add("--n", type=positive(int, 100000), default=100, metavar="N", help="kills per number of frames (100)")
    add("--seed", type=int, default=1, metavar="N", help="of the moments of the kills (1)")
    add("--json", metavar="FILE", help="write the result there")


def _update(frames: int) -> list[Transform]:
    import shmtf

    return [shmtf.Transform(_ROOT, f"frame_{i}") for i in range(frames)]


def victim(link: Link) -> None:
    """Writes the same frames again and again until it is killed."""
    import shmtf

    told = link.hear()
    store = shmtf.Store.attach(told["store"])
    update = _update(told["frames"])
    store.set_transforms(update)
    link.tell("ready")
    link.hear()
    link.tell("writing")
    while True:
        store.set_transforms(update, timeout=PATIENCE_S)


def _kill_one(store: Store, member: Any, update: list[Transform], life_s: float) -> dict[str, Any]:
    member.tell(go=True)
    member.hear()
    time.sleep(life_s)
    before = store.counters()
    killed = member.kill()
    dead = time.monotonic_ns()
    store.set_transforms(update, timeout=PATIENCE_S)
    through = time.monotonic_ns()
    store.set_transforms(update, timeout=PATIENCE_S)
    again = time.monotonic_ns()
    after = store.counters()
    return {
        "kill_ns": dead - killed,
        "update_ns": through - dead,
        "next_ns": again - through,
        "recoveries": after["recoveries"] - before["recoveries"],
        "helps": after["helps"] - before["helps"],
    }


def _batch(frames: int, n: int, choose: random.Random, bar: Bar, done: str) -> list[dict[str, Any]]:
    """Some kills on a store of their own, which loses its name before the first of them."""
    import shmtf

    from ._crew import Crew

    name = f"shmtf-bench-{os.getpid()}-recover"
    with Crew() as crew, shmtf.Store.create(name, frames + 8, 16, stream_bytes=0) as store:
        try:
            update = _update(frames)
            store.set_transforms(update)  # the frames are there: what a victim is killed in is no birth
            victims = [crew.add("recover", "victim", store=name, frames=frames) for _ in range(n)]
            crew.hear_all()
        finally:
            shmtf.Store.unlink(name)
        kills = []
        for k, member in enumerate(victims):
            bar.begin(f"{frames} frames, {done}, {k + 1} of the next {n}")
            kills.append(_kill_one(store, member, update, choose.uniform(0, LIFE_S)))
    return kills


def _case(frames: int, kills: list[dict[str, Any]]) -> dict[str, Any]:
    held = [k for k in kills if k["recoveries"] or k["helps"]]
    free = [k for k in kills if not k["recoveries"] and not k["helps"]]
    return {
        "frames": frames,
        "kills": len(kills),
        "left_locks": len(held),
        "locks_recovered": sum(k["recoveries"] for k in kills),
        "left_committed": sum(k["helps"] > 0 for k in kills),
        "update_after_locks_ns": distribution([k["update_ns"] for k in held]),
        "update_after_no_locks_ns": distribution([k["update_ns"] for k in free]),
        "next_ns": distribution([k["next_ns"] for k in kills]),
        "kill_ns": distribution([k["kill_ns"] for k in kills]),
        "update_ns": spread(k["update_ns"] for k in kills),
        "rounds": kills,
    }


def _measure(args: argparse.Namespace) -> list[dict[str, Any]]:
    choose = random.Random(args.seed)
    cases = []
    with Bar(args.n * len(args.frames)) as bar:
        for frames in args.frames:
            kills: list[dict[str, Any]] = []
            while len(kills) < args.n:
                n = min(BATCH, args.n - len(kills))
                kills += _batch(frames, n, choose, bar, f"{len(kills)} of {args.n} writers killed")
            cases.append(_case(frames, kills))
    return cases


def _print(cases: list[dict[str, Any]]) -> None:
    rows = []
    for c in cases:
        cells = [str(c["kills"]), f"{c['left_locks']} ({share(c['left_locks'], c['kills'])})"]
        cells.append(str(c["left_committed"]))
        for key in ("update_after_locks_ns", "update_after_no_locks_ns", "next_ns"):
            numbers = c[key]
            cells += [duration(numbers[q] if numbers else None) for q in ("p50", "max")]
        rows.append([str(c["frames"]), *cells, duration(c["kill_ns"]["p50"])])
    head = ["frames", "kills", "left locks", "committed", "then p50", "max", "none left p50", "max", "after p50", "max"]
    print(table([*head, "kill p50"], rows))
    print("  left locks: kills in the middle of an update, whose locks the next writer found; committed: of these, how")
    print("  many updates were visible already, so that it completed them, the others being undone; then: its first")
    print("  update of the same frames, called once the killed process is gone; none left: the same where the kill")
    print("  fell between two updates; after: its second update; kill: from kill(2) until waitpid(2) has returned")


def run(args: argparse.Namespace) -> int:
    from ._machine import describe, headline

    check_writable(args.json)
    description = describe()
    print(headline(description))
    print(f"{args.n} writers per line, each killed by SIGKILL within {1e3 * LIFE_S:g} ms of work, at random\n")
    cases = _measure(args)
    _print(cases)
    parameters = {key: value for key, value in vars(args).items() if key not in ("json", "command")}
    write_json(args.json, {"kind": "recover", **description, "parameters": parameters, "cases": cases})
    return 0
