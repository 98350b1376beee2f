# SPDX-License-Identifier: Apache-2.0
"""`shmtf-bench`: what one call costs, and what many processes get done.

bench/README.md in the source tree says what the numbers mean."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from importlib import import_module

__all__ = ["main"]

# each module has add_arguments(parser) and run(args) -> exit code
_COMMANDS = {
    "micro": "what one call costs, beside the floor measured in the same run",
    "compare": "two results of the same command, number by number",
    "figures": "the sweeps of the thesis and its follow-up, as numbers, pictures and a report",
    "idle": "what processes cost that do nothing, while another one writes",
    "recover": "from the kill of a writer until the next one has written the same frames",
    "scale": "what a call costs by frames, depth, history and processes, and which lines it writes",
    "wakeup": "from a commit until a process that waits for it runs again",
    "ycsb": "the thesis' workloads over real processes on one segment",
}


class BenchError(Exception):
    """What ends a benchmark; its text is for the user."""


def main(argv: Sequence[str] | None = None) -> int:
    """`shmtf-bench COMMAND ...`."""
    parser = argparse.ArgumentParser(prog="shmtf-bench", description=__doc__, allow_abbrev=False)
    subparsers = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    modules = {name: import_module(f"{__name__}.{name}") for name in _COMMANDS}
    for name, text in _COMMANDS.items():
        sub = subparsers.add_parser(name, help=text, description=text, allow_abbrev=False)
        modules[name].add_arguments(sub)
    args = parser.parse_args(argv)
    try:
        return int(modules[args.command].run(args))
    except BenchError as error:
        print(f"shmtf-bench: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("shmtf-bench: interrupted", file=sys.stderr)
        return 130
