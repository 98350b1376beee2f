# SPDX-License-Identifier: Apache-2.0
"""Cache lines that came from another core's cache, counted by `perf` where the machine lets it."""

from __future__ import annotations

import contextlib
import functools
import shutil
import signal
import subprocess
import time

# Intel since Skylake, before; AMD since Zen 2; Arm
_EVENTS = (
    "mem_load_l3_hit_retired.xsnp_fwd",
    "mem_load_l3_hit_retired.xsnp_hitm",
    "mem_load_uops_l3_hit_retired.xsnp_hitm",
    "ls_dmnd_fills_from_sys.local_ccx",
    "l2d_cache_refill_outer",
)


def _count(output: str) -> int | None:
    """The number in a line of `perf stat -x,`."""
    for line in output.splitlines():
        word = line.split(",")[0]
        if word.isdigit():
            return int(word)
    return None


@functools.cache
def event() -> str | None:
    """The first event that counts here; None: no perf, or a machine (most virtual ones) that does not say."""
    perf = shutil.which("perf")
    for name in _EVENTS if perf else ():
        command = [perf or "", "stat", "-x,", "-e", name, "--", "true"]
        with contextlib.suppress(OSError, subprocess.TimeoutExpired):
            done = subprocess.run(command, capture_output=True, text=True, timeout=30, check=False)
            if done.returncode == 0 and _count(done.stderr) is not None:
                return name
    return None


class Transfers:
    """Counts in these processes from measure_ns to end_ns, to the precision with which a program starts."""

    def __init__(self, pids: list[int], measure_ns: int, end_ns: int) -> None:
        self._pids = pids
        self._measure_ns = measure_ns
        self._end_ns = end_ns
        self._process: subprocess.Popen[str] | None = None
        self.count: int | None = None

    def __enter__(self) -> Transfers:
        name = event()
        if name:
            delay_ms = max(1, (self._measure_ns - time.monotonic_ns()) // 1_000_000)
            seconds = max(0.001, (self._end_ns - time.monotonic_ns()) / 1e9)
            pids = ",".join(str(pid) for pid in self._pids)
            command = [
                "perf",
                "stat",
                "-x,",
                "-e",
                name,
                "-D",
                str(delay_ms),
                "-p",
                pids,
                "--",
                "sleep",
                f"{seconds:.3f}",
            ]
            self._process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        if not self._process:
            return
        if kind:
            self._process.send_signal(signal.SIGINT)
        self.count = _count(self._process.communicate()[1])
