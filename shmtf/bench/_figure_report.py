# SPDX-License-Identifier: Apache-2.0
"""report.md of `shmtf-bench figures`: the machine, each picture, and its numbers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from . import _plot
from ._figure_list import FIGURES, Figure
from ._groups import GROUPS
from ._machine import headline
from ._plot import Series

_SETTING = (
    ("machine", "cpu"),
    ("machine", "cpus"),
    ("machine", "kernel"),
    ("versions", "commit"),
    ("versions", "shmtf"),
)

_ABOUT = (
    "Medians of the rounds; bars in the pictures and ranges in the JSON files go from the smallest to the largest "
    "round. Lines join measured points and say nothing between them. Figures with a number are the thesis' of that "
    "number, with processes where it has threads. With more processes than CPUs they share them. What each number "
    "is, and what is not measured, is in bench/README.md."
)


def _about(result: dict[str, Any]) -> str:
    p = result["parameters"]
    n = len(result["machine"]["cpus"])
    cpus = f"{n} CPU{'s' * (n > 1)}"
    return f"{cpus}, {p['size']} size; median of {p['rounds']} rounds, bars from the smallest to the largest"


def _setting(result: dict[str, Any]) -> tuple[str, ...]:
    """What is the same for all groups of one installation."""
    return tuple(str(result[part][key]) for part, key in _SETTING)


def _when(result: dict[str, Any]) -> str:
    """What may differ from group to group."""
    trip = result["machine"]["line_round_trip_ns"]
    line = f", cache line there and back {trip['median']:.0f} ns" if trip else ""
    return f"{result['time']}: load {result['machine']['load_before'][0]:.1f}{line}."


def _table(figure: Figure, all_series: list[Series]) -> list[str]:
    if figure.points:
        head = ["", figure.y_label, "smallest", "largest"]
        rows = [
            [s.protocol, *(_plot.text(figure, s.points[0][1][key]) for key in ("median", "min", "max"))]
            for s in all_series
        ]
    else:
        head = [figure.x_label, *(s.protocol for s in all_series)]
        xs = sorted({x for s in all_series for x, _ in s.points})
        found = {(s.protocol, x): _plot.text(figure, y["median"]) for s in all_series for x, y in s.points}
        rows = [[f"{x:,.10g}", *(found.get((s.protocol, x), "-") for s in all_series)] for x in xs]
    return [f"| {' | '.join(row)} |" for row in (head, ["---", *["---:"] * (len(head) - 1)], *rows)]


def _section(figure: Figure, all_series: list[Series], pictures: bool) -> list[str]:
    number = f"Figure {figure.key}: " if figure.key[0].isdigit() else ""
    lines = [f"### {number}{figure.title}", "", figure.question, ""]
    if pictures:
        lines += [f"![{figure.title}]({figure.file})", ""]
    drawn = {s.protocol for s in _plot.drawable(figure, all_series)}
    zero = [s.protocol for s in all_series if s.protocol not in drawn]
    note = f" {', '.join(zero)}: 0, for which a logarithmic axis has no place." if zero else ""
    return [*lines, figure.reading + note, "", *_table(figure, all_series), ""]


def _group(title: str, result: dict[str, Any], out: Path, pictures: bool) -> list[str]:
    lines = [f"## {title}", "", _when(result), ""]
    for note in result["notes"]:
        lines += [f"Note: {note}", ""]
    for figure in FIGURES:
        if figure.group != result["group"]:
            continue
        all_series = _plot.series(figure, result["cases"])
        if not _plot.drawable(figure, all_series):
            lines += [f"### {figure.title}", "", f"{figure.question} Nothing of the kind happened in this run.", ""]
            continue
        if pictures:
            _plot.draw(figure, _plot.drawable(figure, all_series), _about(result), out / figure.file)
        lines += _section(figure, all_series, pictures)
    return lines


def write(out: Path, results: dict[str, dict[str, Any]], missing: list[str], pictures: bool) -> Path:
    """Of the groups that there are; pictures anew, from the numbers."""
    lines = ["# What shmtf-bench figures measured", ""]
    machines = {_setting(result): headline(result) for result in reversed(results.values())}
    lines += [f"- {machine}" for machine in machines.values()]
    if len(machines) > 1:
        lines += ["", "Groups were measured on different machines or versions: do not compare one with another."]
    lines += ["", _ABOUT, ""]
    if missing:
        lines += [f"Not measured: {', '.join(missing)}. The same command measures them and keeps what is here.", ""]
    for group in GROUPS:
        if group.name in results:
            lines += _group(group.title, results[group.name], out, pictures)
    path = out / "report.md"
    path.write_text("\n".join(lines))
    return path
