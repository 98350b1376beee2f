# SPDX-License-Identifier: Apache-2.0
"""Worker processes and what they work on: started, waited for, and gone at the end, however it ends."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import IO, Any

from .. import _bench
from . import BenchError
from ._report import progress

READY_S = 120.0  # for all workers to attach
GRACE_S = 30.0  # for a phase to end after its end
POLL_S = 0.01
LAZY_POLL_S = 0.1  # while nothing is expected: this process shares the CPUs with its workers


@dataclass(frozen=True)
class Job:
    """What every worker is told at its start, as JSON."""

    engine: str
    frames: int
    history: int
    read_len: int
    write_len: int
    by_name: bool
    frequency: float
    opposite: bool
    check_every: int


@dataclass(frozen=True)
class Phase:
    """One protocol, by some of the workers, once."""

    protocol: int
    processes: int
    readers: int  # where `coin` is false
    coin: bool
    read_ratio: float
    pinned: bool


class Team:
    """As many worker processes as the largest phase needs, each attached to every protocol's memory."""

    def __init__(self, job: Job, protocols: list[str], n_workers: int) -> None:
        self.job = job
        self.protocols = protocols
        self.control = _bench.Control(n_workers)
        self._places: list[tuple[str, str]] = []
        self._workers: list[subprocess.Popen[bytes]] = []
        self._errors: list[IO[bytes]] = []
        self._n = n_workers

    def __enter__(self) -> Team:
        try:
            self._create()
            self._spawn()
            self._wait(range(self._n), lambda i: self.control.state(i)[0] == 1, "to attach", READY_S)
            self._remove_names()
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.control.stop()
        deadline = time.monotonic() + 2
        for worker in self._workers:
            try:
                worker.wait(max(0.0, deadline - time.monotonic()))
            except subprocess.TimeoutExpired:
                worker.kill()
                worker.wait()
        for file in self._errors:
            file.close()
        self._remove_names()
        progress("")

    def _create(self) -> None:
        job = self.job
        for protocol in self.protocols:
            progress(f"filling {protocol} ...")
            name = f"shmtf-bench-{os.getpid()}-{protocol}"
            try:
                place = _bench.create(protocol, name, job.frames, job.history, job.read_len, job.write_len)
            except RuntimeError as error:
                raise BenchError(str(error)) from None
            self._places.append((protocol, place))

    def _remove_names(self) -> None:
        """As early as possible: then nothing is left even where this process is killed."""
        for protocol, place in self._places:
            _bench.remove(protocol, place)
        self._places.clear()

    def _spawn(self) -> None:
        told = {
            **asdict(self.job),
            "parent": os.getpid(),
            "control": self.control.path,
            "protocols": self._places,
        }
        for index in range(self._n):
            progress(f"starting worker {index + 1} of {self._n} ...")
            errors = tempfile.TemporaryFile()  # noqa: SIM115  closed in __exit__
            self._errors.append(errors)
            command = [sys.executable, "-P", "-m", f"{__package__}.worker", json.dumps({**told, "index": index})]
            self._workers.append(
                subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=errors)
            )

    def _why_dead(self, index: int) -> str:
        with contextlib.suppress(OSError):
            self._errors[index].seek(0)
            lines = self._errors[index].read().decode(errors="replace").strip().splitlines()
            if lines:
                return lines[-1]
        code = self._workers[index].returncode
        return f"killed by {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"

    def _wait(
        self, indices: range, is_done: Callable[[int], bool], what: str, patience_s: float, busy_s: float = 0
    ) -> None:
        """Until it is so for all of them; not to be expected before `busy_s` seconds, an error `patience_s` later."""
        expected = time.monotonic() + busy_s
        waiting = list(indices)
        while waiting:
            waiting = [i for i in waiting if not is_done(i)]
            for i, worker in enumerate(self._workers):
                state, _, error = self.control.state(i)
                if state == 2:
                    raise BenchError(f"worker {i} could not attach: {error}")
                if worker.poll() is not None:
                    raise BenchError(f"worker {i} is dead: {self._why_dead(i)}")
            now = time.monotonic()
            if waiting and now > expected + patience_s:
                raise BenchError(f"waited {busy_s + patience_s:.0f} s for {len(waiting)} workers {what}")
            if waiting:
                time.sleep(POLL_S if now >= expected else min(LAZY_POLL_S, max(POLL_S, expected - now)))

    def run(self, phase: Phase, warm_up_s: float, duration_s: float, seed: int) -> dict[str, Any]:
        """Run a phase; what all its workers counted, together."""
        start = time.monotonic_ns() + 10_000_000 + 500_000 * phase.processes
        measure = start + int(warm_up_s * 1e9)
        end = measure + int(duration_s * 1e9)
        number = self.control.start(
            phase.protocol,
            phase.processes,
            phase.readers,
            phase.coin,
            phase.pinned,
            phase.read_ratio,
            start,
            measure,
            end,
            seed,
        )
        busy_s = (end - time.monotonic_ns()) / 1e9
        self._wait(range(phase.processes), lambda i: self.control.state(i)[1] == number, "to finish", GRACE_S, busy_s)
        result = self.control.result(phase.processes)
        if result["failures"]:
            result["first_failure"] = result.pop("error")
        else:
            del result["error"]
        return result
