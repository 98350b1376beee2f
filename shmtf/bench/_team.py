# SPDX-License-Identifier: Apache-2.0
"""Workers and what they work on: started, waited for, and gone at the end, however it ends."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import IO, Any

from .. import _bench
from . import BenchError, _protocols
from ._report import progress
from ._transfers import Transfers

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
    mixed_rate: bool
    check_every: int


@dataclass(frozen=True)
class Phase:
    """One protocol, by all workers, once."""

    protocol: str
    processes: int
    readers: int  # where `coin` is false
    coin: bool
    read_ratio: float
    pinned: bool


class Crew:
    """Workers that share a control block: a process each, attached to every protocol's memory; or, for a protocol whose
    memory belongs to one process, threads of a host."""

    def __init__(self, job: Job, protocols: list[str], n_workers: int, hosted: bool) -> None:
        self.job = job
        self.protocols = protocols
        self.control = _bench.Control(n_workers)
        self._n = n_workers
        self._hosted = hosted
        self._places: list[tuple[str, str]] = []
        self._processes: list[subprocess.Popen[bytes]] = []
        self._errors: list[IO[bytes]] = []

    @property
    def pids(self) -> list[int]:
        return [process.pid for process in self._processes]

    def start(self) -> None:
        for protocol in self.protocols:
            name = f"shmtf-bench-{os.getpid()}-{protocol}"
            self._places.append((protocol, name if self._hosted else self._create(protocol, name)))
        told = {
            **asdict(self.job),
            "parent": os.getpid(),
            "control": self.control.path,
            "protocols": self._places,
            "libraries": _protocols.libraries(self.protocols),
            "hosted": self._hosted,
            "workers": self._n,
        }
        for index in range(1 if self._hosted else self._n):
            progress(f"starting worker {index + 1} of {self._n} ...")
            errors = tempfile.TemporaryFile()  # noqa: SIM115  closed in stop()
            self._errors.append(errors)
            command = _protocols.command(self.protocols[0], json.dumps({**told, "index": index}))
            self._processes.append(
                subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=errors)
            )

    def stop(self) -> None:
        self.control.stop()
        deadline = time.monotonic() + 2
        for process in self._processes:
            try:
                process.wait(max(0.0, deadline - time.monotonic()))
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        for file in self._errors:
            file.close()
        self.remove_names()

    def _create(self, protocol: str, name: str) -> str:
        progress(f"filling {protocol} ...")
        try:
            return _protocols.create(self.job.engine, protocol, name, asdict(self.job))
        except RuntimeError as error:
            raise BenchError(str(error)) from None
        except (OSError, ImportError) as error:
            raise BenchError(f"{protocol}: {error}") from None

    def remove_names(self) -> None:
        """As early as possible: then nothing is left even where this process is killed."""
        if not self._hosted:
            for protocol, place in self._places:
                _protocols.remove(self.job.engine, protocol, place)
        self._places.clear()

    def _why_dead(self, index: int) -> str:
        with contextlib.suppress(OSError):
            self._errors[index].seek(0)
            lines = self._errors[index].read().decode(errors="replace").strip().splitlines()
            if lines:
                return lines[-1]
        code = self._processes[index].returncode
        return f"killed by {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"

    def check_alive(self) -> None:
        for i in range(self._n):
            state, _, error = self.control.state(i)
            if state == 2:
                raise BenchError(f"worker {i} could not attach: {error}")
        for i, process in enumerate(self._processes):
            if process.poll() is not None:
                who = f"the host of {self.protocols[0]}" if self._hosted else f"worker {i}"
                raise BenchError(f"{who} is dead: {self._why_dead(i)}")

    def wait(self, is_done: Callable[[int], bool], what: str, patience_s: float, busy_s: float = 0) -> None:
        """Until it is so for all; not to be expected before `busy_s` seconds, an error `patience_s` later."""
        expected = time.monotonic() + busy_s
        waiting = list(range(self._n))
        while waiting:
            waiting = [i for i in waiting if not is_done(i)]
            self.check_alive()
            now = time.monotonic()
            if waiting and now > expected + patience_s:
                raise BenchError(f"waited {busy_s + patience_s:.0f} s for {len(waiting)} workers {what}")
            if waiting:
                time.sleep(POLL_S if now >= expected else min(LAZY_POLL_S, max(POLL_S, expected - now)))


class Team:
    """Workers for every protocol of a run, and no more of them at work at a time than the run asks for."""

    def __init__(self, job: Job, protocols: list[str], n_workers: int) -> None:
        self._crew: dict[str, Crew] = {}
        shared = [name for name in protocols if not _protocols.is_hosted(job.engine, name)]
        for names, hosted in [(shared, False), *(([name], True) for name in protocols if name not in shared)]:
            if names:
                crew = Crew(job, names, n_workers, hosted)
                self._crew.update(dict.fromkeys(names, crew))
        self._crews = list(dict.fromkeys(self._crew.values()))

    def __enter__(self) -> Team:
        try:
            for crew in self._crews:
                crew.start()
                control = crew.control
                crew.wait(lambda i, control=control: control.state(i)[0] == 1, "to attach", READY_S)  # type: ignore[misc]
                crew.remove_names()
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        for crew in self._crews:
            crew.stop()
        progress("")

    def run(self, phase: Phase, warm_up_s: float, duration_s: float, seed: int) -> dict[str, Any]:
        """Run a phase; what all its workers counted, together."""
        crew = self._crew[phase.protocol]
        control = crew.control
        start = time.monotonic_ns() + 10_000_000 + 500_000 * phase.processes
        measure = start + int(warm_up_s * 1e9)
        end = measure + int(duration_s * 1e9)
        number = control.start(
            crew.protocols.index(phase.protocol),
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
        with Transfers(crew.pids, measure, end) as transfers:
            crew.wait(lambda i: control.state(i)[1] == number, "to finish", GRACE_S, busy_s)
        result = control.result(phase.processes)
        result["line_transfers"] = transfers.count
        if result["failures"]:
            result["first_failure"] = result.pop("error")
        else:
            del result["error"]
        return result
