# SPDX-License-Identifier: Apache-2.0
"""`shmtf dump`, `shmtf-dump`: what a store holds.  Maps it read-only; its writers never notice."""

from __future__ import annotations

import argparse
import json
import shutil
import sys
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING

from ._common import CliError, Style, attach, default_store

if TYPE_CHECKING:
    from ..store import Store
    from ._report import Report


def _count(text: str) -> int:
    value = int(text)
    if value < 1:
        raise ValueError
    return value


def _interval(text: str) -> float:
    value = float(text)
    if not 0.02 <= value <= 3600:
        raise ValueError
    return value


def _parser(prog: str) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog=prog, allow_abbrev=False, description="Show what a store holds. Maps it read-only."
    )
    parser.add_argument("name", metavar="NAME", nargs="?", help="the store (default: $SHMTF_STORE, or the only one)")
    form = parser.add_mutually_exclusive_group()
    form.add_argument("--tree", dest="form", action="store_const", const="tree", help="frames as a tree (the default)")
    form.add_argument("--json", dest="form", action="store_const", const="json", help="everything, for programs")
    form.add_argument("--yaml", dest="form", action="store_const", const="yaml", help="the frames with tf2's keys")
    form.add_argument("--dot", dest="form", action="store_const", const="dot", help="the tree for Graphviz")
    parser.add_argument("--frame", metavar="F", help="this frame: writer flag, tags, commit word, ring")
    parser.add_argument("--records", metavar="N", type=_count, help="newest N records of every frame, or of --frame")
    parser.add_argument("--watch", action="store_true", help="again and again; q or Ctrl-C ends it")
    parser.add_argument("--interval", metavar="S", type=_interval, default=1.0, help="seconds between (default 1)")
    return parser


def run(prog: str, argv: Sequence[str]) -> int:
    parser = _parser(prog)
    args = parser.parse_args(argv)
    if args.form in ("yaml", "dot") and (args.frame or args.records):
        parser.error(f"--{args.form} shows all frames; --frame and --records go with --tree and --json")
    with attach(default_store(args.name)) as store:
        if not args.watch:
            print("\n".join(_page(store, args, Style())))
            return 0
        return _watch(store, args)


def _page(store: Store, args: argparse.Namespace, style: Style, rates: dict[str, float] | None = None) -> list[str]:
    return _render(_collect(store, args), args, style, rates)


def _collect(store: Store, args: argparse.Namespace) -> Report:
    from ._report import collect

    return collect(store, args.frame, args.records or 1)


def _render(report: Report, args: argparse.Namespace, style: Style, rates: dict[str, float] | None) -> list[str]:
    from . import _text
    from ._report import as_data

    if args.form == "json":
        indent = None if args.watch else 2
        return [json.dumps(as_data(report, args.records is not None), indent=indent, allow_nan=False)]
    if args.form in ("yaml", "dot"):
        from .._dump import as_dot, as_yaml

        write = as_yaml if args.form == "yaml" else as_dot
        return [write(frame.info for frame in report.frames).rstrip("\n")]
    if args.records:
        return _text.records_page(report, style)
    if args.frame:
        return _text.frame_page(report, style)
    columns = shutil.get_terminal_size().columns if sys.stdout.isatty() else 1000  # files keep whole names
    return _text.tree(report, style, columns, rates)


# ---- watching ----


class _Rates:
    """Records per second between two looks."""

    def __init__(self) -> None:
        self._last: dict[str, tuple[int, int, int]] = {}

    def since_last(self, report: Report) -> dict[str, float]:
        rates = {}
        for frame in report.frames:
            info = frame.info
            now = (info.generation, info.n_written, report.now)
            before = self._last.get(info.name)
            if before is not None and before[0] == now[0] and now[2] > before[2]:
                rates[info.name] = (now[1] - before[1]) * 1e9 / (now[2] - before[2])
            elif info.rate is not None:
                rates[info.name] = info.rate
            self._last[info.name] = now
        return rates


def _watch(store: Store, args: argparse.Namespace) -> int:
    from ._screen import Screen

    rates = _Rates()

    def lines(style: Style) -> list[str]:
        from .. import LookupException

        try:
            report = _collect(store, args)
        except LookupException:
            if not args.frame:
                raise
            return [f'frame "{args.frame}" does not exist (any more)']
        return _render(report, args, style, rates.since_last(report))

    try:
        if not Screen.possible() or args.form in ("json", "yaml", "dot"):
            _collect(store, args)  # a wrong --frame is an error at the start, not later
            while True:
                print("\n".join(lines(Style(False))), end="\n" if args.form == "json" else "\n\n", flush=True)
                time.sleep(args.interval)
        if args.frame and not store.frame_exists(args.frame):
            raise CliError(f'frame "{args.frame}" does not exist')
        with Screen() as screen:
            style = Style()
            while True:
                page = lines(style)
                clock = time.strftime("%H:%M:%S")
                screen.show([*page, "", style.dim(f"{clock}   every {args.interval:g} s   q quits")])
                if not screen.wait(args.interval):
                    return 0
    except KeyboardInterrupt:
        return 0
