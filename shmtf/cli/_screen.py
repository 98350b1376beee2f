# SPDX-License-Identifier: Apache-2.0
"""A terminal that shows a page and shows it again: plain ANSI, works in tmux; 'q' or Ctrl-C ends it."""

from __future__ import annotations

import os
import select
import shutil
import sys
import time
from collections.abc import Sequence
from types import TracebackType
from typing import Any, Self

from ._common import crop

_ENTER = "\x1b[?1049h\x1b[?25l"  # the alternate page, no cursor
_LEAVE = "\x1b[?25h\x1b[?1049l"


class Screen:
    """Use as a context manager; the user's page and settings return at its end."""

    def __init__(self) -> None:
        self._settings: list[Any] | None = None

    @staticmethod
    def possible() -> bool:
        """Whether stdout is a terminal that can do it."""
        return sys.stdout.isatty() and os.environ.get("TERM", "dumb") != "dumb"

    def __enter__(self) -> Self:
        if sys.stdin.isatty():
            import termios
            import tty

            self._settings = termios.tcgetattr(sys.stdin)
            tty.setcbreak(sys.stdin)  # keys at once; Ctrl-C still is a signal
        sys.stdout.write(_ENTER)
        sys.stdout.flush()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, traceback: TracebackType | None
    ) -> None:
        sys.stdout.write(_LEAVE)
        sys.stdout.flush()
        if self._settings is not None:
            import termios

            termios.tcsetattr(sys.stdin, termios.TCSADRAIN, self._settings)

    def show(self, lines: Sequence[str]) -> None:
        """One page; what does not fit is counted on the last line."""
        columns, rows = shutil.get_terminal_size()
        if len(lines) > rows:
            lines = [*lines[: rows - 1], f"… {len(lines) - rows + 1} more lines"]
        page = "\x1b[K\r\n".join(crop(line, columns) for line in lines)
        sys.stdout.write(f"\x1b[H{page}\x1b[K\x1b[J")
        sys.stdout.flush()

    def wait(self, seconds: float) -> bool:
        """Sleep; False as soon as 'q' is typed."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            if self._settings is None:
                time.sleep(left)
            elif select.select([sys.stdin], [], [], left)[0]:
                key = os.read(sys.stdin.fileno(), 1)
                if key in (b"q", b"Q", b""):
                    return False
        return True
