# SPDX-License-Identifier: Apache-2.0
"""Processes with a role each, told what to do in lines of JSON, and gone at the end, however it ends."""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import subprocess
import sys
import tempfile
import time
from typing import Any

from . import BenchError

PATIENCE_S = 120.0  # for a process to start, or to answer beyond the time that its work takes


class Member:
    """One process that runs function `role` of a module of this package; see _member.py for its side."""

    def __init__(self, module: str, role: str, **told: Any) -> None:
        self.role = role
        self._errors = tempfile.TemporaryFile()  # noqa: SIM115  closed in close()
        command = [sys.executable, "-P", "-m", f"{__package__}._member", module, role]
        pipe = subprocess.PIPE
        self.process = subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=self._errors, bufsize=0)
        self._heard = b""
        self.tell(**told)

    @property
    def pid(self) -> int:
        return self.process.pid

    def tell(self, **what: Any) -> None:
        assert self.process.stdin
        try:
            self.process.stdin.write(json.dumps(what).encode() + b"\n")
        except BrokenPipeError:
            raise self._died() from None

    def hear(self, busy_s: float = 0.0) -> Any:
        """Its next answer, which is not expected before `busy_s` seconds."""
        assert self.process.stdout
        deadline = time.monotonic() + busy_s + PATIENCE_S
        poll = select.poll()
        poll.register(self.process.stdout, select.POLLIN)
        while b"\n" not in self._heard:
            if not poll.poll(max(0.0, 1000 * (deadline - time.monotonic()))):
                raise BenchError(f"waited {busy_s + PATIENCE_S:.0f} s for an answer of the {self.role}")
            part = os.read(self.process.stdout.fileno(), 1 << 16)
            if not part:
                raise self._died()
            self._heard += part
        line, _, self._heard = self._heard.partition(b"\n")
        return json.loads(line)

    def _died(self) -> BenchError:
        code = self.process.wait(PATIENCE_S)
        why = f"killed by {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"
        with contextlib.suppress(OSError):
            self._errors.seek(0)
            lines = self._errors.read().decode(errors="replace").strip().splitlines()
            why = lines[-1] if lines else why
        return BenchError(f"the {self.role} is dead: {why}")

    def kill(self) -> int:
        """By SIGKILL; when it is gone, the time on CLOCK_MONOTONIC just before, in ns."""
        before = time.monotonic_ns()
        self.process.kill()
        self.process.wait()
        return before

    def close(self) -> None:
        self.process.kill()
        self.process.wait()
        for file in (self.process.stdin, self.process.stdout, self._errors):
            if file:
                file.close()


class Crew:
    """Some members; leaving it ends them all."""

    def __init__(self) -> None:
        self.members: list[Member] = []

    def __enter__(self) -> Crew:
        return self

    def __exit__(self, *_: object) -> None:
        for member in self.members:
            member.close()

    def add(self, module: str, role: str, **told: Any) -> Member:
        self.members.append(Member(module, role, **told))
        return self.members[-1]

    def hear_all(self, busy_s: float = 0.0) -> list[Any]:
        return [member.hear(busy_s) for member in self.members]
