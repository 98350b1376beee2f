# SPDX-License-Identifier: Apache-2.0
"""The command lines.  A subcommand's module is loaded when that subcommand runs, and numpy only after its arguments."""

from __future__ import annotations

import argparse
import contextlib
import os
import sys
from collections.abc import Callable, Sequence
from importlib import import_module

__all__ = ["main", "main_bench", "main_dump"]

_COMMANDS = {
    "list": "the stores of this machine, and who has them mapped",
    "dump": "what a store holds: its tree, frames, records, writers",
    "echo": "print a transform, again and again",
    "check": "look at every word of a store; repair what dead writers left",
    "rm": "remove stores",
    "bench": "measure (shmtf-bench)",
}


def main(argv: Sequence[str] | None = None) -> int:
    """`shmtf COMMAND ...`."""
    lines = "\n".join(f"  {name:<7}{text}" for name, text in _COMMANDS.items())
    parser = argparse.ArgumentParser(
        prog="shmtf",
        allow_abbrev=False,
        usage="shmtf [-h] [--version] COMMAND ...",
        description="A robot's transform tree in one POSIX shared-memory segment.",
        epilog=f"commands:\n{lines}\n\nshmtf COMMAND --help says more.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="store_true", help="print the version and exit")
    parser.add_argument("command", metavar="COMMAND", nargs="?", choices=list(_COMMANDS), help=argparse.SUPPRESS)
    parser.add_argument("rest", nargs=argparse.REMAINDER, help=argparse.SUPPRESS)
    args = parser.parse_args(argv)
    if args.version:
        from .. import __version__

        print(__version__)
        return 0
    if args.command is None:
        parser.error("a command is needed: " + ", ".join(_COMMANDS))
    return _run(args.command, f"shmtf {args.command}", args.rest)


def main_dump(argv: Sequence[str] | None = None) -> int:
    """`shmtf-dump NAME ...`."""
    return _run("dump", "shmtf-dump", sys.argv[1:] if argv is None else argv)


def main_bench(argv: Sequence[str] | None = None) -> int:
    """`shmtf-bench ...`."""
    return _run("bench", "shmtf-bench", sys.argv[1:] if argv is None else argv)


def _run(command: str, prog: str, argv: Sequence[str]) -> int:
    return _guard(prog, lambda: int(import_module(f"{__name__}.{command}").run(prog, argv) or 0))


def _guard(prog: str, action: Callable[[], int]) -> int:
    """Run it; what a user can get wrong ends as one line on stderr."""
    try:
        code = action()
        sys.stdout.flush()
        return code
    except KeyboardInterrupt:
        return 130
    except BrokenPipeError:  # the reader, such as head, has seen enough
        with contextlib.suppress(OSError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except Exception as error:
        from ._common import CliError, shown_error

        message = shown_error(error)
        if message is None:
            raise
        print(f"{prog}: {message}", file=sys.stderr)
        return error.code if isinstance(error, CliError) else 1
