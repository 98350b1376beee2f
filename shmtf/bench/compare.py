# SPDX-License-Identifier: Apache-2.0
"""`shmtf-bench compare`: two results of the same kind, number by number."""

from __future__ import annotations

import argparse
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from . import BenchError
from ._report import SCHEMA, check_writable, duration, quantity, spread, table, write_json

# what names a case; whatever else a case holds is measured
_IDENTITY = ("engine", "sweep", "case", "mode", "protocol", "processes", "waiters", "frames", "history", "depth")
_IDENTITY_TEXT = ("name", "what", "x")
_SPREAD = {"median", "min", "max"}
_QUANTILES = ("p50", "p99", "p99_9")

_Numbers = dict[str, dict[str, float]]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("a", metavar="A.json", help="a result of any command here, written with --json")
    add("b", metavar="B.json", help="another one of the same command")
    add("--only", metavar="TEXT", default="", help="numbers whose case or name contains it")
    add("--json", metavar="FILE", help="write the comparison there")


def _load(path: str) -> dict[str, Any]:
    try:
        result = json.loads(Path(path).read_text())
    except OSError as error:
        raise BenchError(f"{path}: {error.strerror}") from None
    except ValueError as error:
        raise BenchError(f"{path}: no JSON: {error}") from None
    if not isinstance(result, dict) or result.get("schema") != SCHEMA or "kind" not in result:
        raise BenchError(f"{path}: no result of shmtf-bench ({SCHEMA}); write one with --json FILE")
    if not {"cases", "configurations"} & result.keys():
        raise BenchError(f"{path}: a result of {result['kind']} has no cases to compare")
    return result


def _cases(result: dict[str, Any]) -> Iterator[dict[str, Any]]:
    yield from result.get("cases", [])
    for config in result.get("configurations", []):
        for row in config["rows"]:
            yield {"frames": config["frames"], "history": config["history"], **row}


def _label(case: dict[str, Any]) -> str:
    words = [f"{key} {case[key]}" for key in _IDENTITY if case.get(key) is not None]
    return ", ".join(words + [str(case[key]) for key in _IDENTITY_TEXT if case.get(key) is not None])


def _spreads(value: dict[str, Any], path: str = "") -> Iterator[tuple[str, dict[str, float]]]:
    for key, inner in value.items():
        name = f"{path}.{key}" if path else key
        if isinstance(inner, dict) and inner.keys() >= _SPREAD:
            yield name, {k: inner[k] for k in _SPREAD}
        elif isinstance(inner, dict):
            yield from _spreads(inner, name)


def _histograms(rounds: list[dict[str, Any]]) -> Iterator[tuple[str, dict[str, float]]]:
    """A round's histograms have quantiles; their spread is that over the rounds."""
    for key in rounds[0] if rounds else ():
        found = [r[key] for r in rounds if isinstance(r[key], dict) and r[key].keys() >= set(_QUANTILES)]
        for q in _QUANTILES if found else ():
            yield f"{key}.{q}", spread(f[q] for f in found)


def _numbers(result: dict[str, Any]) -> dict[str, _Numbers]:
    found: dict[str, _Numbers] = {}
    for case in _cases(result):
        numbers = found.setdefault(_label(case), {})
        numbers.update(_spreads({key: value for key, value in case.items() if key != "rounds"}))
        numbers.update((name, s) for name, s in _histograms(case.get("rounds", [])) if name not in numbers)
    return found


def _differences(a: dict[str, Any], b: dict[str, Any]) -> list[str]:
    """What makes the numbers hard to compare."""
    texts = []
    for part, ignored in (
        ("machine", {"load_before", "line_round_trip_ns"}),
        ("versions", set()),
        ("parameters", set()),
    ):
        left, right = a.get(part, {}), b.get(part, {})
        for key in [*left, *(key for key in right if key not in left)]:
            if key not in ignored and left.get(key) != right.get(key):
                texts.append(f"{part}, {key}: {left.get(key)} in A, {right.get(key)} in B")
    trips = [r.get("machine", {}).get("line_round_trip_ns") for r in (a, b)]
    if all(trips) and not _overlap(*trips):
        there = [f"{t['median']:.0f} ns ({t['min']:.0f} .. {t['max']:.0f})" for t in trips]
        texts.append(f"machine, a cache line there and back: {there[0]} in A, {there[1]} in B")
    return texts


def _overlap(a: dict[str, float], b: dict[str, float]) -> bool:
    return a["min"] <= b["max"] and b["min"] <= a["max"]


def _rows(a: dict[str, Any], b: dict[str, Any], only: str) -> list[dict[str, Any]]:
    left, right = _numbers(a), _numbers(b)
    rows = []
    for label in (label for label in left if label in right):
        for name in (name for name in left[label] if name in right[label]):
            if only not in label and only not in name:
                continue
            x, y = left[label][name], right[label][name]
            ratio = y["median"] / x["median"] if x["median"] else None
            rows.append({"case": label, "number": name, "a": x, "b": y, "ratio": ratio, "overlap": _overlap(x, y)})
    return rows


def _print(rows: list[dict[str, Any]]) -> None:
    lines = []
    shown = ""
    for row in rows:
        if row["case"] != shown:
            shown = row["case"]
            lines.append([shown, "", "", "", ""])
        write = duration if re.search(r"(^|_|\.)ns(\.|$)", row["number"]) else quantity
        values = [write(row[side]["median"]) for side in "ab"]
        ratio = "-" if row["ratio"] is None else f"{row['ratio']:.3f}"
        lines.append([f"  {row['number']}", *values, ratio, "" if row["overlap"] else "apart"])
    print(table(["", "A", "B", "B / A", "min .. max"], lines))
    apart = sum(not row["overlap"] for row in rows)
    print(f"  medians; apart: the smallest of one is above the largest of the other ({apart} of {len(rows)})")


def run(args: argparse.Namespace) -> int:
    check_writable(args.json)
    a, b = _load(args.a), _load(args.b)
    if a["kind"] != b["kind"]:
        raise BenchError(
            f"{args.a} is a result of {a['kind']}, {args.b} of {b['kind']}: compare results of one command"
        )
    differences = _differences(a, b)
    for text in differences:
        print(f"differs: {text}")
    rows = _rows(a, b, args.only)
    if not rows:
        raise BenchError(f"{args.a} and {args.b} have no number in common" + f" with {args.only!r}" * bool(args.only))
    _print(rows)
    of = {"of": a["kind"], "a": args.a, "b": args.b}
    write_json(args.json, {"kind": "compare", **of, "differences": differences, "rows": rows})
    return 0
