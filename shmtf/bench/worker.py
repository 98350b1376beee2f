# SPDX-License-Identifier: Apache-2.0
"""One worker process of `shmtf-bench ycsb`; started by _team.py, never by hand."""

from __future__ import annotations

import json
import os
import random
import signal
import sys
import time
from typing import Any

from .. import _bench


def _work_in_c(control: _bench.Control, told: dict[str, Any]) -> bool:
    for path in told["libraries"]:
        _bench.load(path)
    told["protocols"] = [tuple(pair) for pair in told["protocols"]]
    if told["hosted"]:
        return control.host(told["parent"], told)
    return control.work(told["index"], told["parent"], told)


class PythonWorker:
    """What a Python node gets: the package's own calls, Transforms built for each update."""

    def __init__(self, control: _bench.Control, told: dict[str, Any]) -> None:
        import shmtf

        self.transform = shmtf.Transform
        self.control = control
        self.told = told
        self.index: int = told["index"]
        self.read_len: int = told["read_len"]
        self.write_len: int = told["write_len"]
        self.names = [f"link_{i:05}" for i in range(told["frames"])]
        ((_, place),) = told["protocols"]
        self.store = shmtf.Store.attach(place)
        self.until_check = 0
        self.write(0, time.monotonic_ns())  # claims what a writer needs, and opens it by name

    def read(self, first: int) -> Any:
        return self.store.lookup_latest_transform(self.names[first], self.names[first + self.read_len])

    def write(self, first: int, now_ns: int) -> None:
        stamp = self.control.update_stamp(self.write_len, first, now_ns)
        names, make = self.names, self.transform
        children = range(first + self.write_len, first, -1)
        if self.told["opposite"]:
            children = range(first + 1, first + self.write_len + 1)
        self.store.set_transforms(
            [make(names[i - 1], names[i], stamp, (0.1, 0.2, 0.3), (0.5, -0.5, 0.5, -0.5)) for i in children]
        )

    def check(self, first: int, transform: Any, start_ns: int) -> None:
        stamps = [stamp for _, _, stamp in transform.edges]
        now = time.monotonic_ns()
        self.control.check(self.index, self.write_len, first, stamps[::-1], now, start_ns)

    def phase(self, p: dict[str, Any]) -> None:
        control, index, frames = self.control, self.index, self.told["frames"]
        choose = random.Random(p["seed"] + index)
        period = int(1e9 / self.told["frequency"]) if self.told["frequency"] else 0
        control.begin(index)
        _bench.pin(_bench.cpus()[index] if p["pinned"] else -1)
        _sleep_until(p["start_ns"])
        aborts = cpu = 0
        measuring = stop = False
        now = time.monotonic_ns()
        while now < p["end_ns"] and not stop:
            if not measuring and now >= p["measure_ns"]:
                measuring, cpu, aborts = True, time.thread_time_ns(), self.store.counters()["aborts"]
            reads = choose.random() < p["read_ratio"] if p["coin"] else index < p["n_readers"]
            first = choose.randrange(frames - (self.read_len if reads else self.write_len))
            start, found = time.monotonic_ns(), None
            try:
                if reads:
                    found = self.read(first)
                else:
                    self.write(first, start)
            except Exception as error:
                control.fail(index, repr(error))
            now = time.monotonic_ns()
            if measuring and now < p["end_ns"]:
                stop = control.operation(index, reads, now - start)
                if found is not None and self._is_checked():
                    self.check(first, found, p["start_ns"])
            if period:
                _sleep_until(now + period)
                now = time.monotonic_ns()
        if measuring:
            aborts = self.store.counters()["aborts"] - aborts
            cpu = time.thread_time_ns() - cpu
        control.end(index, 0, aborts, cpu)

    def _is_checked(self) -> bool:
        every: int = self.told["check_every"]
        self.until_check = self.until_check + 1 if self.until_check < every else 1
        return every > 0 and self.until_check == every


def _sleep_until(ns: int) -> None:
    time.sleep(max(0.0, (ns - time.monotonic_ns()) / 1e9))


def _work_in_python(control: _bench.Control, told: dict[str, Any]) -> bool:
    try:
        worker = PythonWorker(control, told)
    except Exception as error:
        control.enter(told["index"], told["parent"], 0, repr(error))
        return False
    control.enter(told["index"], told["parent"], 1, "")
    last = 0
    while (phase := control.next_phase(last)) is not None:
        if not phase["number"]:
            continue
        last = phase["number"]
        if told["index"] < phase["n_active"]:
            worker.phase(phase)
    worker.store.close()
    return True


def main() -> int:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the coordinator hears Ctrl-C and says when to stop
    told = json.loads(sys.argv[1])
    try:
        control = _bench.Control(told["control"])
    except OSError:
        return 0 if os.getppid() != told["parent"] else 1
    work = _work_in_c if told["engine"] == "native" else _work_in_python
    return 0 if work(control, told) else 1


if __name__ == "__main__":
    sys.exit(main())
