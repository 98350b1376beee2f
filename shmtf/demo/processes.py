# SPDX-License-Identifier: Apache-2.0
"""The demonstration's child processes: starting, killing, stopping, listening, and leaving none behind."""

from __future__ import annotations

import contextlib
import json
import os
import selectors
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from types import TracebackType
from typing import Any, Self

_GRACE_S = 3.0


class Child:
    """One process.  It says lines of JSON on its stdout; it ends when its stdin does."""

    def __init__(self, name: str, module: str, arguments: Sequence[str]) -> None:
        self.name = name
        self.state = "running"  #: running, stopped, killed
        self._command = [sys.executable, "-m", module, *arguments, "--with-parent"]
        self.start()

    def start(self) -> None:
        """Start it, or a new one after its death."""
        self._stderr = tempfile.TemporaryFile()  # noqa: SIM115  lives as long as the process
        self._process = subprocess.Popen(
            self._command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._stderr,
            process_group=0,  # Ctrl-C reaches the parent alone; and see child.begin
        )
        assert self._process.stdout is not None
        self.stdout = self._process.stdout.fileno()
        os.set_blocking(self.stdout, False)
        self._rest = b""
        self.state = "running"

    @property
    def pid(self) -> int:
        return self._process.pid

    def kill(self) -> None:
        """SIGKILL, in the middle of whatever it does."""
        self._process.kill()
        self._process.wait()
        self.close_pipes()
        self.state = "killed"

    def stop(self) -> None:
        """SIGSTOP."""
        self._process.send_signal(signal.SIGSTOP)
        self.state = "stopped"

    def cont(self) -> None:
        """SIGCONT."""
        self._process.send_signal(signal.SIGCONT)
        self.state = "running"

    def died(self) -> str | None:
        """What it last said, if it ended without being asked to."""
        if self.state == "killed" or self._process.poll() is None:
            return None
        self._stderr.seek(0)
        words = self._stderr.read().decode(errors="replace").strip().splitlines()
        code = self._process.returncode
        how = signal.Signals(-code).name if code < 0 else f"exit code {code}"
        return f"{self.name} ended with {how}" + (f": {words[-1]}" if words else "")

    def end(self) -> None:
        """Ask it to finish."""
        with contextlib.suppress(ProcessLookupError):
            self._process.send_signal(signal.SIGCONT)
            self._process.send_signal(signal.SIGTERM)

    def reap(self, seconds: float) -> None:
        """Wait for its end, and enforce it."""
        try:
            self._process.wait(seconds)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def close_pipes(self) -> None:
        for pipe in (self._process.stdin, self._process.stdout, self._stderr):
            if pipe is not None:
                pipe.close()

    def lines(self) -> list[dict[str, Any]]:
        """What it has said since the last call."""
        while self.state != "killed":
            try:
                chunk = os.read(self.stdout, 65536)
            except BlockingIOError:
                break
            if not chunk:
                break
            self._rest += chunk
        *whole, self._rest = self._rest.split(b"\n")
        return [json.loads(line) for line in whole]


class Troupe:
    """All children.  A context manager: at its end none is left, whatever happened."""

    def __init__(self) -> None:
        self.children: list[Child] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, traceback: TracebackType | None
    ) -> None:
        for child in self.children:
            if child.state != "killed":
                child.end()
        deadline = time.monotonic() + _GRACE_S
        for child in self.children:
            if child.state != "killed":
                child.reap(max(0.0, deadline - time.monotonic()))
                child.close_pipes()

    def start(self, name: str, module: str, arguments: Sequence[str]) -> Child:
        """A new child."""
        child = Child(name, module, arguments)
        self.children.append(child)
        return child

    def listen(self, seconds: float, hear: Callable[[Child, dict[str, Any]], None]) -> None:
        """Pass on what the children say for so long."""
        deadline = time.monotonic() + seconds
        with selectors.DefaultSelector() as selector:
            for child in self.children:
                if child.state != "killed":
                    selector.register(child.stdout, selectors.EVENT_READ, child)
            while True:
                left = deadline - time.monotonic()
                for key, _ in selector.select(max(0.0, left)):
                    said = key.data.lines()
                    for line in said:
                        hear(key.data, line)
                    if not said and key.data.died():
                        selector.unregister(key.fd)
                if left <= 0:
                    return

    def finish(self, children: Sequence[Child], hear: Callable[[Child, dict[str, Any]], None]) -> None:
        """End these and hear their last words."""
        for child in children:
            child.end()
        deadline = time.monotonic() + _GRACE_S
        for child in children:
            child.reap(max(0.0, deadline - time.monotonic()))
            for line in child.lines():
                hear(child, line)

    def problem(self) -> str | None:
        """The first child that ended without being asked to."""
        return next(filter(None, (child.died() for child in self.children)), None)
