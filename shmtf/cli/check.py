# SPDX-License-Identifier: Apache-2.0
"""`shmtf check`: look at every word of a store, and repair what dead writers left."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from ._common import CliError, attach, default_store, printable

if TYPE_CHECKING:
    from ..store import Store

_EXIT = """exit code:
  0  fine
  1  writer flags of dead processes (writers who meet one clear it; --repair clears all now)
  2  corrupt, or it cannot be looked at
"""


def run(prog: str, argv: Sequence[str]) -> int:
    parser = argparse.ArgumentParser(
        prog=prog,
        allow_abbrev=False,
        description="Look at every word of a store while it is in use.",
        epilog=_EXIT,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("name", metavar="NAME", nargs="?", help="the store (default: $SHMTF_STORE, or the only one)")
    parser.add_argument("--repair", action="store_true", help="finish or undo what dead writers left")
    parser.add_argument("--json", action="store_true", help="for programs")
    args = parser.parse_args(argv)
    from .. import StoreError

    name = default_store(args.name)
    try:
        with attach(name, readonly=not args.repair) as store:
            report = store._check(args.repair)
            left = store._check(False) if args.repair and not report["corrupt"] else report
            stopped = _stopped(store) if report["locks_held"] else []
    except CliError as error:
        error.code = 2
        raise
    except StoreError as error:
        raise CliError(printable(str(error)), 2) from None
    code = 2 if report["corrupt"] else 1 if left["locks_dead"] else 0
    if args.json:
        print(json.dumps({**report, "exit_code": code}, indent=2))
    else:
        print("\n".join(_lines(name, report, args.repair, stopped)))
    return code


def _stopped(store: Store) -> list[str]:
    """Writers that live but do not run."""
    from ._holders import process_state

    alive = [w for w in store._writers() if w["alive"]]
    stopped = [w for w in alive if process_state(w["pid"], w["started"]) == "stopped"]
    return [f'"{printable(w["name"])}" (process {w["pid"]})' for w in stopped]


def _lines(name: str, report: dict[str, Any], repair: bool, stopped: list[str]) -> list[str]:
    shown = f'store "{printable(name)}"'
    if report["corrupt"]:
        first = printable(report["first_problem"])
        return [
            f"{shown}: corrupt: {report['bad_words']:,} impossible words, the first: {first}",
            "Nothing was changed. Copy what is needed, then create the store anew.",
        ]
    dead, held = report["locks_dead"], report["locks_held"]
    lines = [f"{shown}: {report['records']:,} records looked at, every word is possible"]
    if held - dead:
        lines.append(
            f"{held - dead} frames are being written by living processes"
            + (f", of which stopped: {', '.join(stopped)}" if stopped else "")
        )
    if repair:
        lines.append(f"{report['locks_repaired']} writer flags finished or undone")
    elif dead:
        lines.append(f"{dead} frames have the flag of a dead writer: the next writer clears it, or --repair now")
    return lines
