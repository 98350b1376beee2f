# SPDX-License-Identifier: Apache-2.0
"""`python -m shmtf.demo`: see it run."""

from __future__ import annotations

import argparse
import os
import signal
import sys
from collections.abc import Sequence
from typing import NoReturn

import shmtf

from ..cli._common import Style
from ..cli._screen import Screen
from . import board, child
from .stage import Failed, Stage, new_store

_LEAD_NS = 1_000_000_000  # recordings begin so long after the start, when their players are up


class Lines:
    """For files and pipes: a line per second."""

    def __init__(self) -> None:
        self._n = 0
        self._told = 0

    def show(self, view: board.View) -> bool:
        for text in view.history[self._told :]:
            print(text, flush=True)
        self._told = len(view.history)
        if self._n % 2 == 0:
            print(board.line(view), flush=True)
        self._n += 1
        return True


class Live:
    """On a terminal: a table that stays in its place."""

    def __init__(self, screen: Screen) -> None:
        self._screen = screen
        self._style = Style()

    def show(self, view: board.View) -> bool:
        self._screen.show([*board.page(view, self._style), "", self._style.dim("q quits")])
        return self._screen.wait(0.001)


def _arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m shmtf.demo",
        allow_abbrev=False,
        description="Sensors and planners, each a process, share one store; planners check every answer. "
        "Half-way one sensor is killed and one stopped.",
    )
    parser.add_argument("--duration", type=float, default=20.0, metavar="S", help="seconds (default 20)")
    parser.add_argument("--planners", type=int, default=3, metavar="N", help="planner processes (default 3)")
    parser.add_argument("--name", help="of the store (default demo-PID)")
    parser.add_argument("--keep", action="store_true", help="keep the store at the end")
    parser.add_argument("--plain", action="store_true", help="a line per second instead of a live table")
    child.add_world(parser)
    args = parser.parse_args(argv)
    if not 2 <= args.duration <= 86400:
        parser.error("--duration is 2 seconds or more, a day at most")
    if not 1 <= args.planners <= 64:
        parser.error("--planners is 1 to 64")
    if not 0.1 <= args.speed <= 10:
        parser.error("--speed is 0.1 to 10")
    args.start = shmtf.now() + _LEAD_NS
    args.data = args.data.absolute() if args.data else None
    return args


def _interrupted(number: int, frame: object) -> NoReturn:
    raise KeyboardInterrupt


def main(argv: Sequence[str] | None = None) -> int:
    """Run it; 1 if an answer was wrong or something died."""
    args = _arguments(argv)
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, _interrupted)
    name = args.name or f"demo-{os.getpid()}"
    to_children = ["--start", str(args.start), *([] if args.keep else ["--remove"])]
    if args.data:
        to_children += ["--data", str(args.data), "--speed", str(args.speed)]
    try:
        world = child.world(args)
        with new_store(name, args.keep) as store:
            if Screen.possible() and not args.plain:
                with Screen() as screen:
                    stage = Stage(store, world, args.duration, args.planners, to_children, Live(screen))
                    stage.run()
            else:
                stage = Stage(store, world, args.duration, args.planners, to_children, Lines())
                print("\n".join(board.opening(stage.view)), flush=True)
                stage.run()
            print("\n".join(board.summary(stage.view, stage.during(), args.keep, Style())))
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return 130
    except (Failed, shmtf.StoreError, shmtf.TransformException, OSError, ValueError) as error:
        print(f"shmtf.demo: {error}", file=sys.stderr)
        return 1
    problem = stage.verdict()
    if problem:
        print(f"shmtf.demo: {problem}", file=sys.stderr)
    return 1 if problem else 0


if __name__ == "__main__":
    sys.exit(main())
