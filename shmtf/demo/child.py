# SPDX-License-Identifier: Apache-2.0
"""What sensors and planners have in common: their world, their reports, and that they end with their parent."""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import sys
import threading
from pathlib import Path
from typing import Any

import shmtf

from .world import World


def parser(role: str) -> argparse.ArgumentParser:
    """Arguments that say which store and which world."""
    made = argparse.ArgumentParser(prog=f"python -m shmtf.demo.{role}", allow_abbrev=False)
    made.add_argument("--store", required=True)
    add_world(made)
    made.add_argument("--start", type=int, default=0, help="stamp of the recordings' first reports, nanoseconds")
    made.add_argument("--with-parent", action="store_true", help="end when stdin does")
    made.add_argument(
        "--remove", action="store_true", help="and then remove the store, which the parent cannot any more"
    )
    return made


def add_world(to: argparse.ArgumentParser) -> None:
    """The arguments that choose a world."""
    to.add_argument("--data", type=Path, metavar="DIR", help="play the recordings in DIR instead of the simulation")
    to.add_argument("--speed", type=float, default=1.0, metavar="X", help="of the recordings (default 1)")


def world(args: argparse.Namespace) -> World:
    """The world that the arguments name.  Raises FileNotFoundError, ValueError."""
    from . import recordings, simulation

    return recordings.make(args.data, args.start, args.speed) if args.data else simulation.make()


def begin(args: argparse.Namespace) -> None:
    """Be gone when the parent is: its end of our stdin closes with it, however it dies.

    A stopped child cannot look; the kernel continues and hangs up a stopped process group that loses its parent, so
    each child leads a group of its own.
    """
    if args.with_parent:
        store = args.store if args.remove else None
        threading.Thread(target=_follow, args=(store,), name="parent", daemon=True).start()


def _follow(store: str | None) -> None:
    while os.read(0, 4096):
        pass
    if store is not None:
        with contextlib.suppress(shmtf.StoreError):  # another child was faster
            shmtf.Store.unlink(store)
    os._exit(0)


def report(**fields: Any) -> None:
    """A line of JSON to the parent."""
    print(json.dumps(fields), file=sys.stdout, flush=True)
