# SPDX-License-Identifier: Apache-2.0
"""One worker of `shmtf-bench ycsb`, or the host of several; started by _team.py, never by hand.

Runs in a peer's interpreter too, which may lack what the package needs."""

from __future__ import annotations

import json
import os
import random
import signal
import sys
import threading
import time
import traceback
from collections.abc import Sequence
from typing import Any

from .. import _bench
from ._python_protocols import PYTHON_PROTOCOLS, PythonProtocol


def _work_in_c(control: _bench.Control, told: dict[str, Any]) -> bool:
    for path in told["libraries"]:
        _bench.load(path)
    told["protocols"] = [tuple(pair) for pair in told["protocols"]]
    if told["hosted"]:
        return control.host(told["parent"], told)
    return control.work(told["index"], told["parent"], told)


class PythonWorker:
    """What a Python node gets."""

    def __init__(self, control: _bench.Control, told: dict[str, Any], index: int) -> None:
        self.control = control
        self.told = told
        self.index = index
        self.clients = [PYTHON_PROTOCOLS[name](place, told) for name, place in told["protocols"]]
        self.until_check = 0
        for client in self.clients:  # the first write claims what a writer needs, and opens it by name
            client.write(0, control.update_stamp(told["write_len"], 0, time.monotonic_ns()))

    def close(self) -> None:
        for client in self.clients:
            client.close()

    def phase(self, p: dict[str, Any]) -> None:
        control, index, told, client = self.control, self.index, self.told, self.clients[p["protocol"]]
        choose = random.Random(p["seed"] + index)
        period = int(1e9 / told["frequency"]) if told["frequency"] else 0
        control.begin(index)
        _bench.pin(_bench.cpus()[index] if p["pinned"] else -1)
        _sleep_until(p["start_ns"])
        cpu, before = 0, (0, 0)
        measuring = stop = False
        now = time.monotonic_ns()
        while now < p["end_ns"] and not stop:
            if not measuring and now >= p["measure_ns"]:
                measuring, cpu, before = True, time.thread_time_ns(), client.retries()
            reads = choose.random() < p["read_ratio"] if p["coin"] else index < p["n_readers"]
            first = choose.randrange(told["frames"] - told["read_len" if reads else "write_len"])
            start, found = time.monotonic_ns(), None
            try:
                if reads:
                    found = client.read(first)
                else:
                    client.write(first, control.update_stamp(told["write_len"], first, start))
            except Exception as error:
                control.fail(index, repr(error))
            now = time.monotonic_ns()
            if measuring and now < p["end_ns"]:
                stop = control.operation(index, reads, now - start)
                if found is not None and self._is_checked():
                    self._check(client, first, found, p["start_ns"])
            if period:
                _sleep_until(now + period)
                now = time.monotonic_ns()
        reads_again = writes_again = 0
        if measuring:
            after = client.retries()
            reads_again, writes_again = after[0] - before[0], after[1] - before[1]
            cpu = time.thread_time_ns() - cpu
        control.end(index, reads_again, writes_again, cpu)

    def _check(self, client: PythonProtocol, first: int, answer: Any, start_ns: int) -> None:
        now = time.monotonic_ns()
        self.control.check(self.index, self.told["write_len"], first, client.stamps(answer), now, start_ns)

    def _is_checked(self) -> bool:
        every: int = self.told["check_every"]
        self.until_check = self.until_check + 1 if self.until_check < every else 1
        return every > 0 and self.until_check == every


def _sleep_until(ns: int) -> None:
    time.sleep(max(0.0, (ns - time.monotonic_ns()) / 1e9))


def _work_in_python(control: _bench.Control, told: dict[str, Any], index: int) -> bool:
    try:
        worker = PythonWorker(control, told, index)
    except Exception as error:
        control.enter(index, told["parent"], 0, repr(error))
        return False
    control.enter(index, told["parent"], 1, "")
    last = 0
    while (phase := control.next_phase(last)) is not None:
        if not phase["number"]:
            continue
        last = phase["number"]
        if index < phase["n_active"]:
            worker.phase(phase)
    worker.close()
    return True


def _be_thread(control: _bench.Control, told: dict[str, Any], index: int) -> None:
    try:
        _work_in_python(control, told, index)
    except BaseException:  # a thread that ends unseen would be waited for
        traceback.print_exc()
        sys.stderr.flush()
        os._exit(1)


def _host_in_python(control: _bench.Control, told: dict[str, Any]) -> bool:
    ((name, wish),) = told["protocols"]
    try:
        place = PYTHON_PROTOCOLS[name].create(wish, told)
    except Exception as error:
        for index in range(told["workers"]):
            control.enter(index, told["parent"], 0, repr(error))
        return False
    told = {**told, "protocols": [(name, place)]}
    threads = [threading.Thread(target=_be_thread, args=(control, told, index)) for index in range(told["workers"])]
    for thread in threads:
        thread.start()
    while not all(control.state(index)[0] for index in range(told["workers"])):
        time.sleep(0.001)
    PYTHON_PROTOCOLS[name].remove(place)  # as soon as all are attached: nothing is left even where this is killed
    for thread in threads:
        thread.join()
    return True


def main(argv: Sequence[str] | None = None) -> int:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the coordinator hears Ctrl-C and says when to stop
    told = json.loads((sys.argv[1:] if argv is None else argv)[0])
    try:
        control = _bench.Control(told["control"])
    except OSError:
        return 0 if os.getppid() != told["parent"] else 1
    if told["engine"] == "native":
        done = _work_in_c(control, told)
    elif told["hosted"]:
        done = _host_in_python(control, told)
    else:
        done = _work_in_python(control, told, told["index"])
    return 0 if done else 1


if __name__ == "__main__":
    sys.exit(main())
