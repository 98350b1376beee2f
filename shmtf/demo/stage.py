# SPDX-License-Identifier: Apache-2.0
"""The play: sensors and planners come on, half-way one sensor is killed and one stopped, and nothing else notices."""

from __future__ import annotations

import contextlib
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import shmtf

from . import board
from .processes import Child, Troupe
from .world import World

_RATE_WINDOW_S = 4.0
_TICK_S = 0.5
_LONGEST_AWAY_S = 6.0  # less than the cache time
_PATIENCE_S = 90.0


class Failed(Exception):
    """The demonstration cannot go on."""


class Show(Protocol):
    """Where it is shown."""

    def show(self, view: board.View) -> bool:
        """Show it; False if the user has seen enough."""


@dataclass(frozen=True)
class Act:
    """Something that happens at a time, seconds after all planners are ready."""

    at: float
    do: Callable[[], None]


class Stage:
    """Runs one demonstration on a store that exists."""

    def __init__(
        self, store: shmtf.Store, world: World, duration: float, n_planners: int, child_arguments: list[str], show: Show
    ) -> None:
        self._store = store
        self._world = world
        self._show = show
        self._troupe = Troupe()
        self._arguments = ["--store", store.name, *child_arguments]
        self._sensors: dict[str, Child] = {}
        self._planners: dict[Child, board.PlannerView] = {}
        self._seen: dict[str, deque[tuple[float, int]]] = {name: deque() for name in world.tracks}
        self._away_since: dict[str, float] = {}
        self._samples: list[tuple[float, str, float]] = []  # elapsed, planner, lookups per second
        self._ready: set[Child] = set()
        self._began: float | None = None
        self.quit = False  #: the user has seen enough
        tasks = [world.tasks[i % len(world.tasks)] for i in range(n_planners)]
        self._cast = [(task, f"{task.name} {i // len(world.tasks) + 1}" if i >= len(world.tasks) else task.name)
                      for i, task in enumerate(tasks)]  # fmt: skip
        self.view = board.View(
            title=world.title,
            store=store.name,
            size_bytes=shmtf.store_info(store.name).size_bytes,
            n_processes=len(world.tracks) + n_planners,
            duration=duration,
            lesson=world.lesson,
            sensors=[board.SensorView(t.name, t.note, t.rate) for t in world.tracks.values()],
            planners=[
                board.PlannerView(name, f"{task.pairs[0][1]} in {task.pairs[0][0]}", readonly=i > 0)
                for i, (task, name) in enumerate(self._cast)
            ],
        )
        away = min(_LONGEST_AWAY_S, 0.2 * duration)
        self._acts = [
            Act(0.5 * duration, self._attack),
            Act(0.5 * duration + away, self._heal),
        ]
        self._away = (0.5 * duration, 0.5 * duration + away)

    # ---- the play ----

    def run(self) -> None:
        """All of it.  Raises Failed."""
        with self._troupe:
            self._store.set_transforms(
                [shmtf.Transform(p, c, None, pose[:3], pose[3:]) for p, c, pose in self._world.statics],
                static=True,
                authority="mounts",
            )
            for name in self._world.tracks:
                self._sensors[name] = self._troupe.start(name, "shmtf.demo.sensors", [name, *self._arguments])
            for (task, _), view in zip(self._cast, self.view.planners, strict=True):
                arguments = [task.name, *self._arguments, *(["--readonly"] if view.readonly else [])]
                self._planners[self._troupe.start(view.name, "shmtf.demo.planners", arguments)] = view
            patience = time.monotonic() + _PATIENCE_S
            while not self._over():
                if self._began is None and time.monotonic() > patience:
                    raise Failed("the planners did not get ready")
                self._troupe.listen(self._until_next(), self._hear)
                self._look()
                if problem := self._troupe.problem():
                    raise Failed(problem)
                if not self._show.show(self.view):
                    self.quit = True
                    break
            self._heal()
            self._troupe.finish(list(self._planners), self._hear)
            self._look()

    def during(self) -> dict[str, tuple[float, float]]:
        """Mean lookups per second of each planner before sensors were away, and meanwhile."""
        out = {}
        for view in self.view.planners:
            before = [rate for at, name, rate in self._samples if name == view.name and at <= self._away[0]]
            meanwhile = [
                rate
                for at, name, rate in self._samples
                if name == view.name and self._away[0] + 1.0 < at <= self._away[1] + _TICK_S
            ]
            out[view.name] = tuple(sum(rates) / len(rates) if rates else 0.0 for rates in (before, meanwhile))
        return out  # type: ignore[return-value]

    def verdict(self) -> str | None:
        """What went wrong, or None."""
        for planner in self.view.planners:
            final = planner.final
            if not final:
                if self.quit:
                    continue
                return f"{planner.name} said nothing at its end"
            if final["wrong"] or final["errors"]:
                return f"{planner.name}: {final['wrong']} wrong answers, {final['errors']} errors; {final['trouble']}"
            if not final["lookups"] and not self.quit:
                return f"{planner.name} looked nothing up"
        return None

    # ---- parts ----

    def _hear(self, child: Child, said: dict[str, Any]) -> None:
        view = self._planners[child]
        if said.get("ready"):
            self._ready.add(child)
            if len(self._ready) == len(self._planners):
                self._began = time.monotonic()
        elif said.get("final"):
            view.final = said
        else:
            view.last = said
            view.per_second = said["window"] / said["seconds"]
            if self._began is not None:
                self._samples.append((time.monotonic() - self._began, view.name, view.per_second))

    def _over(self) -> bool:
        if self._began is None:
            return False
        self.view.elapsed = time.monotonic() - self._began
        while self._acts and self._acts[0].at <= self.view.elapsed:
            self._acts.pop(0).do()
        return self.view.elapsed >= self.view.duration

    def _look(self) -> None:
        """Rates and ages as anybody can see them in the store."""
        now = time.monotonic()
        self.view.commits = self._store.version
        for view in self.view.sensors:
            child = self._sensors[view.name]
            view.state, view.since = child.state, now - self._away_since.get(view.name, now)
            try:
                info = self._store.frame_info(self._world.tracks[view.name].edges[0][1])
            except shmtf.LookupException:  # not yet
                view.state = "starting"
                continue
            view.age, view.written = info.age, info.n_written
            seen = self._seen[view.name]
            seen.append((now, info.n_written))
            window = _RATE_WINDOW_S if view.asked < 25 else 2.0
            while len(seen) > 2 and seen[1][0] <= now - window:
                seen.popleft()
            if len(seen) > 1:
                view.seen = (seen[-1][1] - seen[0][1]) / (seen[-1][0] - seen[0][0])

    def _until_next(self) -> float:
        """Seconds to listen: a tick, or less if something is to happen."""
        if self._began is None:
            return _TICK_S
        due = min([act.at for act in self._acts] + [self.view.duration])
        return max(0.01, min(_TICK_S, self._began + due - time.monotonic()))

    def _attack(self) -> None:
        killed, stopped = self._world.victims
        self._sensors[killed].kill()
        self._sensors[stopped].stop()
        self._away_since = dict.fromkeys((killed, stopped), time.monotonic())
        self._say(f"SIGKILL to {killed}, SIGSTOP to {stopped}: nothing else may notice")

    def _heal(self) -> None:
        if not self._away_since:
            return
        self._away_since.clear()
        killed, stopped = self._world.victims
        self._sensors[stopped].cont()
        self._sensors[killed].start()
        self._say(f"SIGCONT to {stopped}, {killed} started anew")

    def _say(self, event: str) -> None:
        self.view.history.append(f"at {self.view.elapsed or 0:.1f} s: {event}")


@contextlib.contextmanager
def new_store(name: str, keep: bool) -> Any:
    """A store for the demonstration; its name is gone afterwards, unless it is to be kept."""
    with shmtf.Store.create(name, max_frames=128, history=128, stream_bytes=16 << 20, authority="demo") as store:
        try:
            yield store
        finally:
            if not keep:
                with contextlib.suppress(shmtf.StoreNotFoundError):
                    shmtf.Store.unlink(name)
