# SPDX-License-Identifier: Apache-2.0
"""`python -m shmtf.demo.planners TASK --store NAME`: one planner, looking up at 100 Hz and checking every answer."""

from __future__ import annotations

import random
import signal
import time
from array import array
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import shmtf

from . import child
from .checker import Checker, Wrong
from .poses import distance
from .world import Task

_RATE = 100
_REPORT_S = 1.0
_PAST_NS = 500_000_000  # lookups at a time go so far behind the common time
_PATIENCE_S = 60.0


class Fresh:
    """How old the answers of one kind of lookup are, seconds, and how far off the present, metres."""

    def __init__(self) -> None:
        self._ages = array("d")
        self._offs = array("d")

    def add(self, age: float, off: float) -> None:
        self._ages.append(age)
        self._offs.append(off)

    def medians(self) -> dict[str, float]:
        return {"age": _quantile(self._ages, 0.5), "off": _quantile(self._offs, 0.5)}


def _quantile(values: array[Any], q: float) -> Any:
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, int(q * len(ordered)))] if ordered else 0


@dataclass
class Stats:
    """What is reported."""

    lookups: int = 0
    errors: int = 0
    wrong: int = 0
    trouble: str = ""
    latencies: array[int] = field(default_factory=lambda: array("q"))
    common: Fresh = field(default_factory=Fresh)
    latest: Fresh = field(default_factory=Fresh)

    def data(self) -> dict[str, Any]:
        return {
            "lookups": self.lookups,
            "errors": self.errors,
            "wrong": self.wrong,
            "trouble": self.trouble,
            "p50": _quantile(self.latencies, 0.5),
            "p99": _quantile(self.latencies, 0.99),
            "max": _quantile(self.latencies, 1.0),
            "common": self.common.medians(),
            "latest": self.latest.medians(),
        }


class Planner:
    """Looks up the pairs of a task in turn, three ways each, and checks."""

    def __init__(self, store: shmtf.Store, task: Task, checker: Checker) -> None:
        self._store = store
        self._task = task
        self._checker = checker
        self._random = random.Random(0)
        self._floor: dict[tuple[str, str], int] = {}  # from here on every edge of the pair has data
        self.total = Stats()
        self.window = Stats()

    def wait_for_data(self, ending: list[int]) -> None:
        """Until every pair can be looked up, or it is to end."""
        deadline = time.monotonic() + _PATIENCE_S
        for pair in self._task.pairs:
            while not ending:
                try:
                    self._floor[pair] = self._store.lookup_transform(*pair, timeout=0.5).stamp or 0
                    break
                except shmtf.TransformException:
                    if time.monotonic() > deadline:
                        raise

    def tick(self, i: int) -> None:
        """One pair, three ways."""
        pair = self._task.pairs[i % len(self._task.pairs)]
        shown = pair == self._task.pairs[0]
        store, checker = self._store, self._checker
        common = self._ask(lambda: store.lookup_transform(*pair))
        latest = self._ask(lambda: store.lookup_latest_transform(*pair))
        now = shmtf.now()
        if latest is not None:
            self._check(lambda: checker.latest(latest, *pair))
            if shown and latest.stamp_range is not None:
                self._fresh("latest", latest, now, latest.stamp_range[1])
        if common is None:
            return
        self._check(lambda: checker.at(common, *pair, None))
        if common.stamp is None:
            return
        if shown:
            self._fresh("common", common, now, common.stamp)
        past = max(self._floor[pair], common.stamp - self._random.randrange(_PAST_NS))
        then = self._ask(lambda: store.lookup_transform(*pair, past))
        if then is not None:
            self._check(lambda: checker.at(then, *pair, past))

    def _ask(self, lookup: Callable[[], shmtf.Transform]) -> shmtf.Transform | None:
        began = time.perf_counter_ns()
        try:
            T = lookup()
        except (shmtf.TransformException, shmtf.StoreError) as error:
            self._count(errors=1, trouble=f"{type(error).__name__}: {error}")
            return None
        took = time.perf_counter_ns() - began
        for stats in (self.total, self.window):
            stats.lookups += 1
            stats.latencies.append(took)
        return T

    def _check(self, check: Callable[[], None]) -> None:
        try:
            check()
        except Wrong as error:
            self._count(wrong=1, trouble=f"wrong: {error}")

    def _count(self, errors: int = 0, wrong: int = 0, trouble: str = "") -> None:
        for stats in (self.total, self.window):
            stats.errors += errors
            stats.wrong += wrong
            stats.trouble = stats.trouble or trouble

    def _fresh(self, kind: str, T: shmtf.Transform, now: int, newest: int) -> None:
        truth = self._checker.truth(T, now)
        off = distance([float(v) for v in T.translation], truth)
        for stats in (self.total, self.window):
            getattr(stats, kind).add((now - newest) / 1e9, off)


def main(argv: Sequence[str] | None = None) -> None:
    """Plan until SIGTERM."""
    parser = child.parser("planners")
    parser.add_argument("task")
    parser.add_argument("--readonly", action="store_true")
    args = parser.parse_args(argv)
    child.begin(args)
    world = child.world(args)
    tasks = {task.name: task for task in world.tasks}
    if args.task not in tasks:
        parser.error(f"TASK is one of {', '.join(tasks)}")
    ending: list[int] = []
    signal.signal(signal.SIGTERM, lambda number, _: ending.append(number))
    with shmtf.Store.attach(
        args.store, readonly=args.readonly, timeout=10.0, authority=f"planner {args.task}"
    ) as store:
        checker = Checker(world, lambda frame: [record["stamp"] for record in store._records(frame)])
        planner = Planner(store, tasks[args.task], checker)
        planner.wait_for_data(ending)
        child.report(ready=True)
        _loop(planner, ending)
        child.report(final=True, gaps=checker.gaps, **planner.total.data())


def _loop(planner: Planner, ending: list[int]) -> None:
    due = said = time.monotonic()
    uneven = random.Random(1)
    i = 0
    while not ending:
        planner.tick(i)
        i += 1
        now = time.monotonic()
        if now - said >= _REPORT_S:
            total = planner.total
            window = planner.window.data()
            trouble = planner.total.trouble
            counts = {"lookups": total.lookups, "errors": total.errors, "wrong": total.wrong, "trouble": trouble}
            child.report(seconds=now - said, window=planner.window.lookups, **{**window, **counts})
            planner.window = Stats()
            said = now
        # irregular, so that it does not keep in step with a sensor; after a pause it does not catch up
        due = max(due + uneven.uniform(0.5, 1.5) / _RATE, now - 0.1)
        time.sleep(max(0.0, due - time.monotonic()))


if __name__ == "__main__":
    main()
