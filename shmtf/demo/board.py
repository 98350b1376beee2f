# SPDX-License-Identifier: Apache-2.0
"""What the demonstration looks like: a live table, a line per second, a summary."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from ..cli._common import Style, size, table


@dataclass
class SensorView:
    """A sensor as seen from outside, in the store."""

    name: str
    note: str
    asked: float  #: Hz
    seen: float = 0.0
    age: float | None = None
    written: int = 0
    state: str = "starting"  #: running, stopped, killed
    since: float = 0.0  #: seconds in that state, if it is not running


@dataclass
class PlannerView:
    """What a planner reported."""

    name: str
    asks: str  #: the pair it shows
    readonly: bool
    per_second: float = 0.0
    last: dict[str, Any] = field(default_factory=dict)
    final: dict[str, Any] = field(default_factory=dict)


@dataclass
class View:
    """All there is to show."""

    title: str
    store: str
    size_bytes: int
    n_processes: int
    duration: float
    lesson: tuple[str, ...]  #: what to see in the freshness
    sensors: list[SensorView]
    planners: list[PlannerView]
    elapsed: float | None = None  #: None: not all planners are ready
    commits: int = 0
    history: list[str] = field(default_factory=list)  #: what was done to whom


def dump_command(view: View) -> str:
    return f"shmtf-dump {view.store}"


def opening(view: View) -> list[str]:
    return [
        view.title,
        f"{len(view.sensors)} sensors and {len(view.planners)} planners, each a process; "
        f"one store, {size(view.size_bytes)}; every answer is checked",
        f"look at it from another shell while it runs:  {dump_command(view)} --watch",
    ]


def _ms(seconds: float) -> str:
    return f"{seconds * 1e3:,.1f} ms"


def _us(ns: float) -> str:
    return f"{ns / 1e3:,.1f} us"


def _metres(value: float) -> str:
    return f"{value * 1e3:,.1f} mm"


def _bar(view: View, width: int = 40) -> str:
    if view.elapsed is None:
        return "waiting for every planner to have data"
    done = min(width, round(width * view.elapsed / view.duration))
    return f"{'━' * done}{'─' * (width - done)}  {view.elapsed:5.1f} of {view.duration:g} s"


def _state(sensor: SensorView, style: Style) -> str:
    if sensor.state == "running":
        return style.good("running")
    if sensor.state == "starting":
        return style.dim("starting")
    word = {"stopped": "STOPPED by SIGSTOP", "killed": "KILLED by SIGKILL"}[sensor.state]
    return style.bad(f"{word}, {sensor.since:.1f} s")


def page(view: View, style: Style) -> list[str]:
    """The live table."""
    first, *others = opening(view)
    lines = [style.bold(first), *map(style.dim, others), "", _bar(view), ""]
    rows = [[style.bold("SENSORS"), *(style.dim(t) for t in ("one commit writes", "wanted", "seen", "age", "state"))]]
    for s in view.sensors:
        age = "" if s.age is None else _ms(s.age) if s.age < 1 else f"{s.age:.2f} s"
        rows.append([f"  {s.name}", s.note, f"{s.asked:.3g} Hz", f"{s.seen:.1f} Hz", age, _state(s, style)])
    lines += [*table(rows, "<<>>><"), ""]
    heads = ("store mapped", "lookups/s", "p50", "p99", "wrong", "errors")
    rows = [[style.bold("PLANNERS"), *(style.dim(t) for t in heads)]]
    for p in view.planners:
        d = p.last
        counts = [style.bad(str(d[k])) if d.get(k) else str(d.get(k, "")) for k in ("wrong", "errors")]
        times = [_us(d[k]) if d else "" for k in ("p50", "p99")]
        rate = f"{p.per_second:.0f}" if d else "starting"
        rows.append([f"  {p.name}", "read-only" if p.readonly else "read-write", rate, *times, *counts])
    lines += [*table(rows, "<<>>>>>"), "", *_freshness(view, style, live=True), ""]
    return [*lines, *view.history]


def _freshness(view: View, style: Style, live: bool) -> list[str]:
    """The thesis' second problem, in numbers."""
    name, asks = 2 + max(len(p.name) for p in view.planners), max(len(p.asks) for p in view.planners)
    heads = f"{'pose of .. in ..':<{asks}}   {'age':>10} {'off by':>12}   {'age':>10} {'off by':>12}"
    above = f"{'':<{name + 2 + asks}}   {'lookup_transform(None)':>23}   {'lookup_latest_transform':>23}"
    lines = [style.dim(above), style.bold(f"{'HOW FRESH':<{name}}  ") + style.dim(heads)]
    for p in view.planners:
        d = p.last if live else p.final
        if d:
            numbers = (f"{_ms(d[kind]['age']):>10} {_metres(d[kind]['off']):>12}" for kind in ("common", "latest"))
            lines.append("   ".join([f"{'  ' + p.name:<{name}}  {p.asks:<{asks}}", *numbers]))
    return lines + [
        style.dim(f"  {text}")
        for text in (
            *view.lesson,
            "Age: of the newest data in the answer. Off by: from where it really is now. Medians.",
        )
    ]


def line(view: View) -> str:
    """Where there is no terminal: one line per second."""
    if view.elapsed is None:
        return "waiting for every planner to have data"
    away = [f"{s.name} {s.state}" for s in view.sensors if s.state not in ("running", "starting")]
    parts = [
        f"{view.elapsed:5.1f} s",
        f"{view.commits:,} commits",
        f"{sum(p.per_second for p in view.planners):,.0f} lookups/s",
        f"{sum(p.last.get('wrong', 0) for p in view.planners)} wrong",
        f"{sum(p.last.get('errors', 0) for p in view.planners)} errors",
    ]
    shown = next((p for p in view.planners if p.last), None)
    if shown is not None:
        common, latest = (_ms(shown.last[kind]["age"]) for kind in ("common", "latest"))
        parts.append(f"{shown.name} {common} old, latest {latest}")
    return "  ".join(parts + ([", ".join(away)] if away else []))


def summary(view: View, during: dict[str, tuple[float, float]], keep: bool, style: Style) -> list[str]:
    """during: lookups per second by planner, before and while sensors were away."""
    lines = [style.bold(f"{view.title}: {view.elapsed or 0:.1f} s, {view.commits:,} commits")]
    lines += [f"  {text}" for text in view.history]
    heads = ("mapped", "lookups", "wrong", "errors", "p50", "p99", "max", "per s", "while away")
    rows = [[style.bold("planner"), *(style.dim(t) for t in heads)]]
    for p in view.planners:
        d = p.final or p.last
        if not d:
            rows.append([f"  {p.name}", *["" for _ in heads]])
            continue
        before, away = during.get(p.name, (0.0, 0.0))
        rows.append([f"  {p.name}", "read-only" if p.readonly else "read-write", f"{d['lookups']:,}", str(d["wrong"]),
                     str(d["errors"]), _us(d["p50"]), _us(d["p99"]), _us(d["max"]),
                     f"{before:.0f}" if before else "", f"{away:.0f}" if away else ""])  # fmt: skip
    lines += ["", *table(rows, "<<>>>>>>>>"), "", *_freshness(view, style, live=False), ""]
    troubles = [f"{p.name}: {d['trouble']}" for p in view.planners if (d := p.final or p.last) and d.get("trouble")]
    lines += [style.bad(text) for text in troubles]
    if not troubles:
        lines.append("every answer was checked against the truth: none wrong, none failed")
    end = "look at what is left of it:" if keep else "with --keep the store stays, to be looked at with"
    return [*lines, f"{end}  {dump_command(view)}"]
