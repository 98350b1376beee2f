# SPDX-License-Identifier: Apache-2.0
"""One process of a _crew.Crew; started there, never by hand."""

from __future__ import annotations

import contextlib
import json
import os
import queue
import signal
import sys
import threading
from importlib import import_module
from typing import Any


def remove_names(name: str) -> None:
    """Of the store and of the semaphore that are called so, where they are there."""
    import posix_ipc

    import shmtf

    with contextlib.suppress(shmtf.StoreNotFoundError):
        shmtf.Store.unlink(name)
    with contextlib.suppress(posix_ipc.ExistentialError):
        posix_ipc.unlink_semaphore("/" + name)


class Link:
    """The line to the coordinator.  A process that waits in C notices the coordinator's death too: the thread that
    listens sees the pipe close, and removes the name of the store that this process was told."""

    def __init__(self) -> None:
        self._lines: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()
        threading.Thread(target=self._listen, daemon=True).start()

    def _listen(self) -> None:
        store = None
        for line in sys.stdin:
            told = json.loads(line)
            store = told.get("store", store)
            self._lines.put(told)
        if store:
            remove_names(store)
        os._exit(0)

    def hear(self) -> dict[str, Any]:
        """The next thing told; waits for it."""
        return self._lines.get()

    def tell(self, answer: Any) -> None:
        try:
            print(json.dumps(answer), flush=True)
        except BrokenPipeError:
            threading.Event().wait()  # nobody hears it: the thread that listens ends this process


def main() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the coordinator hears Ctrl-C and closes the line
    module, role = sys.argv[1:]
    getattr(import_module(f"{__package__}.{module}"), role)(Link())


if __name__ == "__main__":
    main()
