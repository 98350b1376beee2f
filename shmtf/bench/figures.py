# SPDX-License-Identifier: Apache-2.0
"""`shmtf-bench figures`: the sweeps of the thesis and of its follow-up, as numbers, pictures and a report."""

from __future__ import annotations

import argparse
import json
import os
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from . import BenchError
from ._arguments import words
from ._report import SCHEMA, Bar, progress

if TYPE_CHECKING:
    from ._groups import Group, Size

_PROTOCOLS = ["shmtf", "giant", "snapshot", "latest", "silo", "tf2"]


def _groups() -> list[str]:
    from ._groups import GROUPS

    return [group.name for group in GROUPS]


def _protocols() -> list[str]:
    from ._protocols import names

    return names()


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("--out", required=True, metavar="DIR", help="for JSON, PNG and report.md; what is complete there is kept")
    size = parser.add_mutually_exclusive_group()
    size.add_argument("--full", action="store_const", const="full", dest="size", help="the thesis' sizes, for hours")
    size.add_argument("--quick", action="store_const", const="quick", dest="size", help="a minute, to see that it runs")
    add("--groups", type=words(_groups), metavar="G,G", help="(all)")
    add("--protocol", type=words(_protocols), metavar="P,P", help=f"(of {','.join(_PROTOCOLS)} those that are there)")
    add("--no-pictures", action="store_true", help="numbers only, without matplotlib")


def _duration_text(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


def _load(path: Path, parameters: dict[str, Any]) -> dict[str, Any] | None:
    """A group's result, if it is complete and of these parameters."""
    try:
        result: dict[str, Any] = json.loads(path.read_text())
    except (OSError, ValueError):
        return None
    same = result.get("schema") == SCHEMA and result.get("parameters") == parameters
    return result if same and result.get("kind") == "figures" else None


def _save(path: Path, result: dict[str, Any]) -> None:
    """At once or not at all: a file that is there is complete."""
    part = path.with_suffix(".part")
    part.write_text(json.dumps({"schema": SCHEMA, **result}, indent=1) + "\n")
    os.replace(part, path)


def _make(out: Path) -> None:
    try:
        out.mkdir(parents=True, exist_ok=True)
        (out / "report.md").touch()
    except OSError as error:
        raise BenchError(f"--out {out}: {error.strerror}") from None


class _Run:
    """Groups to measure, and what there is already."""

    def __init__(self, out: Path, size: Size, protocols: list[str], chosen: list[Group]) -> None:
        self.out = out
        self.size = size
        self.protocols = protocols
        self.chosen = chosen
        self.parameters = json.loads(json.dumps({"size": size.name, **asdict(size), "protocols": protocols}))
        self.results: dict[str, dict[str, Any]] = {}
        for group in chosen:
            if found := _load(self._path(group), self.parameters):
                self.results[group.name] = found

    def _path(self, group: Group) -> Path:
        return self.out / f"{group.name}.json"

    def missing(self) -> list[Group]:
        return [group for group in self.chosen if group.name not in self.results]

    def seconds(self, group: Group) -> float:
        return group.seconds(self.size, self.protocols)

    def measure(self) -> None:
        from ._machine import describe

        missing = self.missing()
        with Bar(sum(self.seconds(group) for group in missing)) as bar:
            for group in missing:
                bar.begin(group.title, weight=self.seconds(group))
                description = describe()
                cases, notes = group.measure(self.size, self.protocols)
                head = {"kind": "figures", "group": group.name, **description, "parameters": self.parameters}
                result = {**head, "notes": notes, "cases": cases}
                _save(self._path(group), result)
                self.results[group.name] = result
                progress("")
                print(f"  {group.name}: {len(cases)} cases" + "".join(f"\n    {note}" for note in notes), flush=True)


def run(args: argparse.Namespace) -> int:
    from . import _figure_report, _plot
    from ._groups import GROUPS, SIZES
    from ._machine import describe, headline

    if not args.no_pictures:
        _plot.matplotlib()
    out = Path(args.out)
    _make(out)
    there = _protocols()
    protocols = args.protocol or [name for name in _PROTOCOLS if name in there]
    chosen = [group for group in GROUPS if args.groups is None or group.name in args.groups]
    work = _Run(out, SIZES[args.size or "reduced"], protocols, chosen)
    print(headline(describe()))
    for name in _PROTOCOLS if args.protocol is None else ():
        if name not in there:
            print(f"note: {name} is not installed here and is left out")
    if work.results:
        print(f"kept from an earlier run: {', '.join(work.results)}")
    seconds = sum(work.seconds(group) for group in work.missing())
    print(f"{len(work.missing())} groups to measure over {', '.join(protocols)}: about {_duration_text(seconds)}")
    code = 0
    try:
        work.measure()
    except KeyboardInterrupt:
        progress("")
        print("interrupted: the report is of what is complete; the same command goes on")
        code = 130
    missing = [group.name for group in work.missing()]
    print(f"report: {_figure_report.write(out, work.results, missing, not args.no_pictures)}")
    return code
