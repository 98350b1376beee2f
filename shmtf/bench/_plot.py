# SPDX-License-Identifier: Apache-2.0
"""Figures from measured cases: their points, and pictures of them.  Nothing that was not measured is drawn."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from . import BenchError
from ._report import duration, quantity, share, spread

if TYPE_CHECKING:
    from ._figure_list import Figure

Case = dict[str, Any]
Spread = dict[str, float]

# Okabe and Ito's colours, which people with any colour vision tell apart; shapes do it in print
_STYLES = {
    "shmtf": ("#0072B2", "o"),
    "shmtf-common": ("#56B4E9", "D"),
    "giant": ("#000000", "s"),
    "giant-atomic": ("#7F7F7F", "P"),
    "snapshot": ("#E69F00", "^"),
    "latest": ("#009E73", "v"),
    "silo": ("#D55E00", "X"),
    "tf2": ("#CC79A7", "*"),
    "shmtf, updates": ("#0072B2", "o"),
    "shmtf, births": ("#D55E00", "X"),
}
_UNKNOWN = ("#999999", "h")
_SIZE = (7.2, 4.0)  # inches
_DPI = 110


def matplotlib() -> Any:
    """The library, without a window."""
    try:
        import matplotlib as found
    except ImportError:
        raise BenchError(
            "pictures need matplotlib: pip install 'shmtf[plot]'; or give --no-pictures for numbers only"
        ) from None
    found.use("Agg")
    return found


def value(case: Case, y: str) -> Spread | None:
    """Median, smallest and largest over the rounds; None: this case has no such number."""
    rounds = case.get("rounds", [])
    if y == "operations_per_s":
        return spread((r["reads"] + r["writes"]) / case["duration_s"] for r in rounds) if rounds else None
    if y == "retries_per_write":
        found = [r["write_retries"] / r["writes"] for r in rounds if r["writes"]]
        return spread(found) if found else None
    if y == "mixed_reads":
        found = [r["mixed"] / r["checked"] for r in rounds if r["checked"] and r["mixed"] is not None]
        return spread(found) if found else None
    key, _, quantile = y.partition(".")
    histograms = [r[key] for r in rounds if r.get(key)]
    if quantile and histograms:
        return spread(h[quantile] for h in histograms)
    inner = case.get(key)
    inner = inner.get(quantile) if quantile and inner else inner
    if not isinstance(inner, dict) or inner.keys() < {"median", "min", "max"} or not inner["max"]:
        return None
    return {"median": inner["median"], "min": inner["min"], "max": inner["max"]}


@dataclass(frozen=True)
class Series:
    protocol: str
    points: list[tuple[float, Spread]]  # by x


def series(figure: Figure, cases: list[Case]) -> list[Series]:
    found: dict[str, list[tuple[float, Spread]]] = {}
    for case in cases:
        if case["protocol"] in figure.leave_out or any(case.get(key) != at for key, at in figure.only):
            continue
        y = value(case, figure.y)
        if y is not None:
            found.setdefault(case["protocol"], []).append((case[figure.x], y))
    return [Series(name, sorted(points, key=lambda p: p[0])) for name, points in found.items()]


def drawable(figure: Figure, all_series: list[Series]) -> list[Series]:
    """Those with a place on the axes: a logarithmic one has none for 0."""
    if not figure.log_y:
        return all_series
    kept = [Series(s.protocol, [(x, y) for x, y in s.points if y["min"] > 0]) for s in all_series]
    return [s for s in kept if s.points]


def text(figure: Figure, number: float) -> str:
    if figure.unit == "ns":
        return duration(number)
    if figure.unit == "share":
        return share(number, 1)
    return quantity(number)


def _style(protocol: str) -> dict[str, Any]:
    colour, marker = _STYLES.get(protocol, _UNKNOWN)
    return {"color": colour, "marker": marker, "markersize": 6, "linewidth": 1.4, "capsize": 2.5, "elinewidth": 1.0}


def _errors(points: list[tuple[float, Spread]]) -> list[list[float]]:
    below = [y["median"] - y["min"] for _, y in points]
    return [below, [y["max"] - y["median"] for _, y in points]]


def _draw_lines(axes: Any, figure: Figure, all_series: list[Series]) -> None:
    from matplotlib.ticker import FixedLocator, NullLocator

    for s in all_series:
        ys = [y["median"] for _, y in s.points]
        axes.errorbar([x for x, _ in s.points], ys, yerr=_errors(s.points), label=s.protocol, **_style(s.protocol))
    xs = sorted({x for s in all_series for x, _ in s.points})
    if figure.log_x:
        axes.set_xscale("log")
    if len(xs) <= 14:
        axes.xaxis.set_major_locator(FixedLocator(xs))
        axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_formatter(lambda x, _: _short(x))
    if figure.log_x and len(xs) > 8:
        axes.tick_params(axis="x", labelrotation=45)
    axes.set_xlabel(figure.x_label)
    axes.set_ylabel(figure.y_label)


def _draw_points(axes: Any, figure: Figure, all_series: list[Series]) -> None:
    for row, s in enumerate(reversed(all_series)):
        _, y = s.points[0]
        error = [[y["median"] - y["min"]], [y["max"] - y["median"]]]
        axes.errorbar([y["median"]], [row], xerr=error, **{**_style(s.protocol), "linestyle": "none"})
        axes.annotate(text(figure, y["median"]), (y["median"], row), (0, 7), textcoords="offset points", ha="center")
    axes.set_yticks(range(len(all_series)), [s.protocol for s in reversed(all_series)])
    axes.set_ylim(-0.6, len(all_series) - 0.4)
    axes.margins(x=0.15)
    axes.set_xlabel(figure.y_label)


def _short(number: float) -> str:
    for limit, prefix in ((1e6, "M"), (1e3, "k")):
        if abs(number) >= limit:
            return f"{number / limit:g}{prefix}"
    return f"{number:g}"


def _format_values(axis: Any, figure: Figure) -> None:
    from matplotlib.ticker import LogLocator, NullFormatter

    axis.set_major_formatter(lambda y, _: _tick(figure, y))
    if figure.log_y:
        axis.set_major_locator(LogLocator(base=10, subs=(1.0, 2.0, 5.0), numticks=12))
        axis.set_minor_formatter(NullFormatter())


def _tick(figure: Figure, y: float) -> str:
    if figure.unit == "ns":
        for limit, unit in ((1e9, "s"), (1e6, "ms"), (1e3, "us")):
            if abs(y) >= limit:
                return f"{y / limit:g} {unit}"
        return f"{y:g} ns" if y else "0"
    return f"{100 * y:g} %" if figure.unit == "share" else _short(y)


def draw(figure: Figure, all_series: list[Series], subtitle: str, path: Path) -> None:
    from matplotlib import pyplot

    canvas, axes = pyplot.subplots(figsize=_SIZE, layout="constrained")
    try:
        (_draw_points if figure.points else _draw_lines)(axes, figure, all_series)
        value_axis = axes.xaxis if figure.points else axes.yaxis
        if figure.log_y:
            (axes.set_xscale if figure.points else axes.set_yscale)("log")
        else:
            axes.set_ylim(bottom=0)
        _format_values(value_axis, figure)
        axes.set_title(f"{figure.title}\n", loc="left", fontsize=11, fontweight="bold")
        axes.text(0, 1.02, subtitle, transform=axes.transAxes, fontsize=8, color="#555555")
        axes.grid(axis="x" if figure.points else "y", color="#DDDDDD", linewidth=0.7)
        axes.set_axisbelow(True)
        axes.spines[["top", "right"]].set_visible(False)
        if not figure.points:
            _legend(axes, all_series)
        canvas.savefig(path, dpi=_DPI)
    finally:
        pyplot.close(canvas)


def _legend(axes: Any, all_series: list[Series]) -> None:
    """Beside the axes, in the order in which the lines end."""
    handles, labels = axes.get_legend_handles_labels()
    last = {s.protocol: s.points[-1][1]["median"] for s in all_series}
    order = sorted(range(len(labels)), key=lambda i: -last[labels[i]])
    axes.legend(
        [handles[i] for i in order],
        [labels[i] for i in order],
        loc="upper left",
        bbox_to_anchor=(1.0, 1.0),
        frameon=False,
        fontsize=9,
    )
