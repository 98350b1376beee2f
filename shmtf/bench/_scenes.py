# SPDX-License-Identifier: Apache-2.0
"""Workloads of the follow-up paper that are no chain, over shmtf, as Python nodes: many snakes, and obstacles that are
born while drones fly."""

from __future__ import annotations

import os
import random
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from ._crew import Crew, Member
from ._report import Bar, distribution, spread

if TYPE_CHECKING:
    from ._groups import Size
    from ._member import Link

_ROOT = "map"
READERS = WRITERS = 1
PARTS = 10  # of a flight, each with numbers of its own
INSERT_S = 0.005  # between two obstacles
OVERHEAD_S = 3.0  # a crew's start and its store
_PAIRS = 1 << 12  # chosen before the clock runs


def _sleep_until(ns: int) -> None:
    time.sleep(max(0.0, (ns - time.monotonic_ns()) / 1e9))


def _timed(call: Callable[[int], Any], start_ns: int, end_ns: int, pause_s: float = 0.0) -> list[tuple[int, int]]:
    """(begin, ns) of calls from one instant to another."""
    found = []
    _sleep_until(start_ns)
    k = 0
    while (begin := time.monotonic_ns()) < end_ns:
        call(k)
        found.append((begin, time.monotonic_ns() - begin))
        k += 1
        if pause_s:
            time.sleep(pause_s)
    return found


def _in_parts(calls: list[tuple[int, int]], order: dict[str, Any]) -> list[Any]:
    length = max(1, (order["end_ns"] - order["start_ns"]) // order["parts"])
    parts: list[list[int]] = [[] for _ in range(order["parts"])]
    for begin, ns in calls:
        parts[min(order["parts"] - 1, (begin - order["start_ns"]) // length)].append(ns)
    return [distribution(part) for part in parts]


def _serve(link: Link, call: Callable[[int], Any], pause_s: float = 0.0) -> None:
    link.tell("ready")
    while True:
        order = link.hear()
        calls = _timed(call, order["start_ns"], order["end_ns"], pause_s)
        link.tell(_in_parts(calls, order))


# ---- snakes ----


def _joint(snake: int, joint: int) -> str:
    return f"snake_{snake}_{joint}" if joint else _ROOT


def snake_reader(link: Link) -> None:
    import shmtf

    told = link.hear()
    store = shmtf.Store.attach(told["store"], readonly=True)
    choose = random.Random(told["index"])
    pairs = []
    for _ in range(_PAIRS):
        snake, joint = choose.randrange(told["snakes"]), choose.randint(0, told["joints"] - told["length"])
        pairs.append((_joint(snake, joint), _joint(snake, joint + told["length"])))
    _serve(link, lambda k: store.lookup_latest_transform(*pairs[k % _PAIRS]))


def snake_writer(link: Link) -> None:
    import shmtf

    told = link.hear()
    store = shmtf.Store.attach(told["store"])
    choose = random.Random(1000 + told["index"])
    n = told["length"]
    store.set_transforms([shmtf.Transform(_joint(0, i), _joint(0, i + 1)) for i in range(n)])

    def update(_: int) -> None:
        snake, first = choose.randrange(told["snakes"]), choose.randint(0, told["joints"] - n)
        names = [_joint(snake, joint) for joint in range(first, first + n + 1)]
        store.set_transforms([shmtf.Transform(names[i], names[i + 1]) for i in range(n)])

    _serve(link, update)


@contextmanager
def _store(role: str, frames: int) -> Iterator[Any]:
    """Its name goes as soon as this is left."""
    import shmtf

    name = f"shmtf-bench-{os.getpid()}-{role}"
    store = shmtf.Store.create(name, frames, 16, cache_time=None, stream_bytes=0)
    try:
        yield store
    finally:
        store.close()
        shmtf.Store.unlink(name)


def _fill_snakes(store: Any, snakes: int, joints: int) -> None:
    import shmtf

    for snake in range(snakes):
        names = [_joint(snake, joint) for joint in range(joints + 1)]
        store.set_transforms([shmtf.Transform(names[i], names[i + 1], shmtf.now()) for i in range(joints)])


def _round(readers: list[Member], writers: list[Member], duration_s: float, parts: int) -> tuple[list[Any], list[Any]]:
    start = time.monotonic_ns() + 100_000_000
    for member in (*readers, *writers):
        member.tell(start_ns=start, end_ns=start + int(duration_s * 1e9), parts=parts)
    return [m.hear(duration_s) for m in readers], [m.hear(duration_s) for m in writers]


def _merge(answers: list[Any]) -> dict[str, Any]:
    """Of several processes: counts together, each other number that of the process in which it was largest."""
    found = [a for a in answers if a]
    if not found:
        return {"count": 0}
    return {"count": sum(a["count"] for a in found), **{q: max(a[q] for a in found) for q in found[0] if q != "count"}}


def _spreads(rounds: list[dict[str, Any]], key: str) -> dict[str, Any] | None:
    found = [r[key] for r in rounds if r[key]["count"]]
    return {q: spread(f[q] for f in found) for q in ("mean", "p50", "p99", "p99_9", "max")} if found else None


def snakes_seconds(size: Size) -> float:
    fill_s = sum(size.snakes) * size.snake_joints * 2e-6
    return len(size.snakes) * (OVERHEAD_S + size.rounds * (size.duration + 0.2)) + fill_s


def snakes(size: Size) -> Iterator[dict[str, Any]]:
    length = min(16, size.snake_joints)
    with Bar(len(size.snakes)) as bar:
        for n in size.snakes:
            bar.begin(f"{n} snakes of {size.snake_joints} joints")
            rounds = []
            with Crew() as crew:
                with _store("snakes", n * size.snake_joints + 64) as store:
                    _fill_snakes(store, n, size.snake_joints)
                    told = {"store": store.name, "snakes": n, "joints": size.snake_joints, "length": length}
                    readers = [crew.add("_scenes", "snake_reader", index=i, **told) for i in range(READERS)]
                    writers = [crew.add("_scenes", "snake_writer", index=i, **told) for i in range(WRITERS)]
                    crew.hear_all()
                for _ in range(size.rounds):
                    reads, writes = _round(readers, writers, size.duration, 1)
                    rounds.append(
                        {"read_ns": _merge([r[0] for r in reads]), "write_ns": _merge([w[0] for w in writes])}
                    )
            yield {
                "protocol": "shmtf",
                "snakes": n,
                "joints": size.snake_joints,
                "reads_per_s": spread(r["read_ns"]["count"] / size.duration for r in rounds),
                "writes_per_s": spread(r["write_ns"]["count"] / size.duration for r in rounds),
                "read_ns": _spreads(rounds, "read_ns"),
                "write_ns": _spreads(rounds, "write_ns"),
                "duration_s": size.duration,
            }


# ---- drones ----


def drone_reader(link: Link) -> None:
    import shmtf

    told = link.hear()
    store = shmtf.Store.attach(told["store"], readonly=True)
    choose = random.Random(told["index"])
    pairs = [choose.sample(range(told["drones"]), 2) for _ in range(_PAIRS)]
    names = [(f"drone_{a}", f"drone_{b}") for a, b in pairs]
    _serve(link, lambda k: store.lookup_latest_transform(*names[k % _PAIRS]))


def drone_writer(link: Link) -> None:
    """Every drone in turn, as fast as it goes; or, told so, a new obstacle every few milliseconds."""
    import shmtf

    told = link.hear()
    store = shmtf.Store.attach(told["store"])
    drones = told["drones"]
    store.set_transform(shmtf.Transform(_ROOT, "drone_0"))
    if told["inserts"]:
        _serve(link, lambda k: store.set_transform(shmtf.Transform(_ROOT, f"obstacle_{k}")), INSERT_S)
    else:
        _serve(link, lambda k: store.set_transform(shmtf.Transform(_ROOT, f"drone_{k % drones}")), INSERT_S)


def drones_seconds(size: Size) -> float:
    return 2 * size.rounds * (OVERHEAD_S + size.drone_duration)


def _flight(size: Size, births: bool) -> list[dict[str, Any]]:
    """One flight over a store of its own: an obstacle is born once only.  Its parts."""
    import shmtf

    room = int(size.drone_duration / INSERT_S) + 64
    with Crew() as crew:
        with _store("drones", size.drones + room) as store:
            for i in range(size.drones):
                store.set_transform(shmtf.Transform(_ROOT, f"drone_{i}"))
            told = {"store": store.name, "drones": size.drones}
            readers = [crew.add("_scenes", "drone_reader", index=i, **told) for i in range(READERS)]
            writers = [crew.add("_scenes", "drone_writer", inserts=births, **told)]
            crew.hear_all()
        reads, writes = _round(readers, writers, size.drone_duration, PARTS)
    return [
        {"read_ns": _merge([r[part] for r in reads]), "write_ns": _merge([w[part] for w in writes])}
        for part in range(PARTS)
    ]


def drones(size: Size) -> Iterator[dict[str, Any]]:
    flights: dict[str, list[list[dict[str, Any]]]] = {"updates": [], "births": []}
    with Bar(2 * size.rounds) as bar:
        for k in range(size.rounds):
            for what, found in flights.items():
                bar.begin(f"{size.drones} drones, {what}, round {k + 1} of {size.rounds}")
                found.append(_flight(size, what == "births"))
    for what, found in flights.items():
        for part in range(PARTS):
            rounds = [flight[part] for flight in found]
            end_s = (part + 1) * size.drone_duration / PARTS
            yield {
                "mode": what,
                "protocol": f"shmtf, {what}",
                "at_s": end_s,
                "drones": size.drones,
                "read_ns": _spreads(rounds, "read_ns"),
                "write_ns": _spreads(rounds, "write_ns"),
                "writes_per_s": spread(r["write_ns"]["count"] * PARTS / size.drone_duration for r in rounds),
                "duration_s": size.drone_duration,
            }
