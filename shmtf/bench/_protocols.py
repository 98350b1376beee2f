# SPDX-License-Identifier: Apache-2.0
"""Which protocols there are: those of this build, and peers in libraries of their own beside the extension."""

from __future__ import annotations

import functools
from pathlib import Path

from .. import _bench

PYTHON = ["shmtf"]  # of --engine python
SORTING = {"shmtf", "shmtf-common", "silo"}  # lock in an order of their own, whatever the order given


@functools.cache
def _peers() -> tuple[dict[str, str], list[str]]:
    """{name: library}, and why others could not be loaded."""
    loaded, notes = {}, []
    for path in sorted(Path(_bench.__file__).parent.glob("shmtf_bench_*.so")):
        try:
            loaded[_bench.load(str(path))] = str(path)
        except OSError as error:
            notes.append(f"peer left out: {error}")
    return loaded, notes


def names(engine: str = "native") -> list[str]:
    _peers()
    return list(_bench.protocols()) if engine == "native" else PYTHON


def notes() -> list[str]:
    return _peers()[1]


def libraries(chosen: list[str]) -> list[str]:
    """What a worker must load for these protocols."""
    return [path for name, path in _peers()[0].items() if name in chosen]


def is_hosted(engine: str, name: str) -> bool:
    """Does its memory belong to one process, whose threads are the workers?"""
    return engine == "native" and _bench.protocols()[name][1]


def has_common_time(engine: str, name: str) -> bool:
    """Are its lookups at one time for all edges, so that their stamps show no mixture?"""
    return engine == "native" and _bench.protocols()[name][2]
