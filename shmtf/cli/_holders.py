# SPDX-License-Identifier: Apache-2.0
"""Who has a segment mapped, as far as this user may see, and whether a process is stopped."""

from __future__ import annotations

import os
from collections.abc import Iterable

import psutil

DIRECTORY = "/dev/shm"  # where POSIX shared memory lives on Linux


def holders(names: Iterable[str]) -> dict[str, list[tuple[int, str]]]:
    """Process ids and names by segment name, in one pass over the processes; this process is left out."""
    paths = {os.path.join(DIRECTORY, name): name for name in names}
    found: dict[str, list[tuple[int, str]]] = {name: [] for name in paths.values()}
    for process in psutil.process_iter(["pid", "name"]):
        if process.pid == os.getpid():
            continue
        for path in _mapped(process.pid) & paths.keys():
            found[paths[path]].append((process.pid, process.info["name"] or "?"))
    return found


def _mapped(pid: int) -> set[str]:
    """Files of shared memory that a process maps.  psutil.memory_maps() would add up every page, which is slow."""
    try:
        with open(f"/proc/{pid}/maps", encoding="utf-8", errors="surrogateescape") as lines:
            return {line[line.index(DIRECTORY) :].rstrip("\n") for line in lines if f" {DIRECTORY}/" in line}
    except OSError:  # gone, or another user's
        return set()


def process_state(pid: int, started_ns: int = 0) -> str:
    """running, stopped or gone; unknown where it cannot be told (another PID namespace).

    started_ns: when it claimed to exist; a younger process of that id is somebody else.
    """
    if not 0 < pid < 1 << 31:  # whatever the segment says
        return "unknown"
    try:
        process = psutil.Process(pid)
        if started_ns and process.create_time() > started_ns / 1e9 + 1:
            return "unknown"
        status = process.status()
    except psutil.NoSuchProcess:
        return "gone"
    except psutil.Error:
        return "unknown"
    if status in (psutil.STATUS_STOPPED, psutil.STATUS_TRACING_STOP):
        return "stopped"
    return "gone" if status in (psutil.STATUS_ZOMBIE, psutil.STATUS_DEAD) else "running"
