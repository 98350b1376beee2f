# SPDX-License-Identifier: Apache-2.0
"""Which protocols there are: those of this build, and peers in libraries of their own beside the extension."""

from __future__ import annotations

import functools
import sys
from pathlib import Path

from .. import _bench
from . import _peers
from ._python_protocols import PYTHON_PROTOCOLS

# which of them --opposite-write acts on
_IN_GIVEN_ORDER = {"snapshot", "latest"}
_SORTING = {"shmtf", "shmtf-common", "silo"}


@functools.cache
def _libraries() -> tuple[dict[str, str], list[str]]:
    """{name: library}, and why others could not be loaded."""
    loaded, notes = {}, []
    for path in sorted(Path(_bench.__file__).parent.glob("shmtf_bench_*.so")):
        try:
            loaded[_bench.load(str(path))] = str(path)
        except OSError as error:
            notes.append(f"peer left out: {error}")
    return loaded, notes


def names(engine: str = "native") -> list[str]:
    _libraries()
    if engine == "native":
        return list(_bench.protocols())
    return [name for name in PYTHON_PROTOCOLS if name != "tf2-python" or _peers.tf2_python()]


def what(engine: str, name: str) -> str:
    return _bench.protocols()[name][0] if engine == "native" else PYTHON_PROTOCOLS[name].what


def notes(engine: str) -> list[str]:
    return _libraries()[1] + _peers.missing([engine])


def libraries(chosen: list[str]) -> list[str]:
    """What a worker must load for these protocols."""
    return [path for name, path in _libraries()[0].items() if name in chosen]


def is_hosted(engine: str, name: str) -> bool:
    """Does its memory belong to one process, whose threads are the workers?"""
    return _bench.protocols()[name][1] if engine == "native" else PYTHON_PROTOCOLS[name].threads


def has_common_time(engine: str, name: str) -> bool:
    """Are its lookups at one time for all edges, so that their stamps show no mixture?"""
    return _bench.protocols()[name][2] if engine == "native" else PYTHON_PROTOCOLS[name].common_time


def create(engine: str, name: str, wish: str, told: dict[str, int]) -> str:
    """Make its memory here; what workers attach to."""
    if engine == "native":
        return _bench.create(name, wish, told["frames"], told["history"], told["read_len"], told["write_len"])
    return PYTHON_PROTOCOLS[name].create(wish, told)


def remove(engine: str, name: str, place: str) -> None:
    if engine == "native":
        _bench.remove(name, place)
    else:
        PYTHON_PROTOCOLS[name].remove(place)


def command(name: str, told: str) -> list[str]:
    """A worker, in the interpreter that has what it needs."""
    python = _peers.tf2_python() if name == "tf2-python" else None
    if python:
        return _peers.command(python, "worker", told)
    return [sys.executable, "-P", "-m", f"{__package__}.worker", told]


def _opposite(name: str) -> str:
    if name in _IN_GIVEN_ORDER:
        return "acts on {}: locks are taken frame after frame in the order given"
    if name in _SORTING:
        return "does not act on {}: locks are taken in the order of frame ids"
    return "does not act on {}: there is one lock"


def opposite_notes(chosen: list[str]) -> list[str]:
    """What --opposite-write does with each."""
    groups: dict[str, list[str]] = {}
    for name in chosen:
        groups.setdefault(_opposite(name), []).append(name)
    return [f"--opposite-write {text.format(', '.join(those))}" for text, those in groups.items()]
