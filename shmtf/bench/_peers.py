# SPDX-License-Identifier: Apache-2.0
"""Other libraries beside ours, where they are installed: which, where, and processes in their interpreter."""

from __future__ import annotations

import functools
import json
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from .. import _bench
from . import BenchError

# what they do not do, said beside their numbers
_TF2_LACKS = (
    "tf2: one process (others get copies of every transform as messages), no update of several frames at once, "
    "no newest record of every edge"
)
_LACKS = {
    "tf2": _TF2_LACKS,
    "tf2-python": _TF2_LACKS,
    "numpy-lock": "numpy-lock: no names, no tree, no history, no times; all wait for ever where a holder dies",
}
_PROBE = "import sys, tf2_py, genpy, geometry_msgs.msg; sys.exit(sys.version_info < (3, int(sys.argv[1])))"
# shmtf and shmtf.bench without their __init__, which need what another interpreter may not have
_START = """import importlib, sys, types
for name, parts in (("shmtf", ""), ("shmtf.bench", "/bench")):
    sys.modules[name] = types.ModuleType(name)
    sys.modules[name].__path__ = [path + parts for path in sys.argv[2].split(":")]
sys.exit(importlib.import_module("shmtf.bench." + sys.argv[1]).main(sys.argv[3:]))
"""


def tf2_library() -> str | None:
    """The C++ peer, built beside the extension where tf2's headers were found."""
    path = Path(_bench.__file__).with_name("shmtf_bench_tf2.so")
    return str(path) if path.exists() else None


@functools.cache
def tf2_python(minor: int = 11) -> str | None:
    """An interpreter that has tf2_py, Python 3.`minor` or newer: seldom the one that this runs in.  Our extension needs
    the default."""
    found = (sys.executable, shutil.which("python3"), "/usr/bin/python3")
    for python in dict.fromkeys(path for path in found if path):
        try:
            done = subprocess.run([python, "-c", _PROBE, str(minor)], capture_output=True, timeout=60, check=False)
        except (OSError, subprocess.TimeoutExpired):
            continue
        if not done.returncode:
            return python
    return None


def command(python: str, module: str, *args: str) -> list[str]:
    """A module of this folder as a program of another interpreter."""
    package = Path(__file__).parents[1]
    folders = dict.fromkeys((str(package), str(Path(_bench.__file__).parent)))
    return [python, "-c", _START, module, ":".join(folders), *args]


class Helper:
    """A process in a peer's interpreter that answers lines of JSON with lines of JSON, and ends with its input."""

    def __init__(self, python: str, module: str, told: dict[str, Any]) -> None:
        self._errors = tempfile.TemporaryFile()  # noqa: SIM115  closed in close
        arguments = command(python, module, json.dumps(told))
        pipe = subprocess.PIPE
        self._process = subprocess.Popen(arguments, stdin=pipe, stdout=pipe, stderr=self._errors, text=True)

    def answer(self) -> Any:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if line:
            return json.loads(line)
        self._process.wait()
        self._errors.seek(0)
        lines = self._errors.read().decode(errors="replace").strip().splitlines()
        raise BenchError(f"the peer's process ended: {lines[-1] if lines else f'exit code {self._process.returncode}'}")

    def ask(self, question: dict[str, Any]) -> Any:
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(json.dumps(question) + "\n")
            self._process.stdin.flush()
        except BrokenPipeError:
            pass  # answer says why
        return self.answer()

    def close(self) -> None:
        self._process.kill()
        self._process.wait()
        for file in (self._process.stdin, self._process.stdout, self._errors):
            if file is not None:
                file.close()


def lacks(chosen: Sequence[str]) -> list[str]:
    """One line for what some of these protocols do not do."""
    return list(dict.fromkeys(_LACKS[name] for name in chosen if name in _LACKS))


def missing(wanted: Sequence[str]) -> list[str]:
    """One line for each peer that is not here, with what would help."""
    lines = []
    if "native" in wanted and tf2_library() is None:
        lines.append("no tf2 in C++ beside it: built where a C++ compiler and ROS 1's tf2 are (Debian: libtf2-dev)")
    if "python" in wanted and tf2_python(8) is None:
        lines.append("no tf2_py beside it: no python3 here imports it (Debian: python3-tf2)")
    return lines
