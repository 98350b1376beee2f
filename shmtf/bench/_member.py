# SPDX-License-Identifier: Apache-2.0
"""One process of a _crew.Crew; started there, never by hand."""

from __future__ import annotations

import json
import os
import queue
import signal
import sys
import threading
from importlib import import_module
from typing import Any


class Link:
    """The line to the coordinator.  A process that waits in C notices the coordinator's death too: the thread that
    listens sees the pipe close."""

    def __init__(self) -> None:
        self._lines: queue.SimpleQueue[str] = queue.SimpleQueue()
        threading.Thread(target=self._listen, daemon=True).start()

    def _listen(self) -> None:
        for line in sys.stdin:
            self._lines.put(line)
        os._exit(0)

    def hear(self) -> dict[str, Any]:
        """The next thing told; waits for it."""
        told: dict[str, Any] = json.loads(self._lines.get())
        return told

    def tell(self, answer: Any) -> None:
        print(json.dumps(answer), flush=True)


def main() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the coordinator hears Ctrl-C and closes the line
    module, role = sys.argv[1:]
    getattr(import_module(f"{__package__}.{module}"), role)(Link())


if __name__ == "__main__":
    main()
