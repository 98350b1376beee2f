# SPDX-License-Identifier: Apache-2.0
"""Where and with what a result was made: a number without it cannot be compared."""

from __future__ import annotations

import datetime
import os
import platform
import subprocess
from importlib import metadata
from pathlib import Path
from typing import Any

from .. import _bench
from ._report import spread

ROUND_TRIPS = 7


def _first_line(path: str) -> str | None:
    try:
        return Path(path).read_text().splitlines()[0].strip()
    except (OSError, IndexError):
        return None


def _cpu_model() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = []
    for key in ("model name", "Model", "Hardware"):
        for line in lines:
            name, _, value = line.partition(":")
            if name.strip() == key:
                return value.strip()
    return platform.processor() or platform.machine()


def line_round_trip() -> dict[str, float] | None:
    """ns for a cache line between the first two CPUs and back; None: there is one CPU only."""
    cpus = _bench.cpus()
    if len(cpus) < 2:
        return None
    trips = [ns for ns in (_bench.round_trip(cpus[0], cpus[1]) for _ in range(ROUND_TRIPS)) if ns is not None]
    return spread(trips) if trips else None


def machine() -> dict[str, Any]:
    """The hardware, as far as this process sees it, and how busy it is."""
    cpuinfo = Path("/proc/cpuinfo")
    return {
        "cpu": _cpu_model(),
        "cpus": _bench.cpus(),
        "virtual": cpuinfo.exists() and " hypervisor" in cpuinfo.read_text(),
        "governor": _first_line("/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor"),
        "shared_memory_huge_pages": _first_line("/sys/kernel/mm/transparent_hugepage/shmem_enabled"),
        "memory_bytes": os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"),
        "kernel": platform.release(),
        "architecture": platform.machine(),
        "load_before": os.getloadavg(),
        "line_round_trip_ns": line_round_trip(),
    }


def _commit() -> str | None:
    """Of the source tree that this package runs from, if it does; '+' where it was changed since."""
    root = Path(__file__).resolve().parents[2]
    if not (root / ".git").exists():
        return None
    try:
        run = ["git", "-C", str(root)]
        head = subprocess.run([*run, "rev-parse", "HEAD"], capture_output=True, text=True, check=True).stdout.strip()
        changed = subprocess.run([*run, "status", "--porcelain"], capture_output=True, text=True, check=True).stdout
    except (OSError, subprocess.CalledProcessError):
        return None
    return head + ("+" if changed else "")


def versions() -> dict[str, Any]:
    found = {"shmtf": _bench.LIBRARY, "commit": _commit(), "compiler": _bench.COMPILER}
    found["python"] = platform.python_version()
    found["libc"] = " ".join(platform.libc_ver())
    for package in ("numpy", "posix_ipc"):
        try:
            found[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            found[package] = None
    return found


def describe() -> dict[str, Any]:
    """The part of a result that is the same for all benchmarks."""
    now = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
    return {"time": now, "machine": machine(), "versions": versions()}


def headline(description: dict[str, Any]) -> str:
    m, v = description["machine"], description["versions"]
    trip = m["line_round_trip_ns"]
    parts = [
        f"{m['cpu']}, {len(m['cpus'])} CPU{'s' if len(m['cpus']) > 1 else ''}{' (virtual)' if m['virtual'] else ''}",
        f"Linux {m['kernel']}",
        f"load {m['load_before'][0]:.1f}",
        f"shmtf {v['shmtf']}" + (f" at {v['commit'][:12]}{'+' * v['commit'].endswith('+')}" if v["commit"] else ""),
        v["compiler"],
        f"Python {v['python']}",
    ]
    if trip:
        parts.insert(1, f"cache line there and back {trip['median']:.0f} ns ({trip['min']:.0f} .. {trip['max']:.0f})")
    return " | ".join(parts)
