# SPDX-License-Identifier: Apache-2.0
"""What the tests of a machine's faults share: namespaces, preloaded libraries, programs."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import textwrap
from collections.abc import Callable
from pathlib import Path

import pytest

HERE = Path(__file__).resolve().parent
WATCHDOG_S = 120
SMALL = {"max_frames": 16, "history": 8, "stream_bytes": 1 << 12}


def path_of(name: str) -> str:
    return os.path.join("/dev/shm", name)


@pytest.fixture(scope="session")
def unshare() -> Callable[..., list[str]]:
    """The command that runs another in namespaces of its own; skips where that is refused."""

    def command(*flags: str) -> list[str]:
        if not shutil.which("unshare"):
            pytest.skip("no unshare(1)")
        for user in ([], ["--map-root-user"]):
            whole = ["unshare", *user, *flags, "--"]
            if subprocess.run([*whole, "true"], check=False, capture_output=True, timeout=WATCHDOG_S).returncode == 0:
                return whole
        return pytest.skip(f"unshare {' '.join(flags)} is refused here")

    return command


@pytest.fixture(scope="session")
def preload(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], str]:
    """Compiles a C file of this folder into a library for LD_PRELOAD; skips where there is no compiler."""

    def build(source: str) -> str:
        compiler = (os.environ.get("CC") or "cc").split()
        if not shutil.which(compiler[0]):
            pytest.skip("no C compiler")
        target = tmp_path_factory.mktemp("preload") / source.replace(".c", ".so")
        flags = ["-shared", "-fPIC", "-O1", "-Wall", "-Werror", "-o", str(target)]
        subprocess.run([*compiler, *flags, str(HERE / source), "-ldl"], check=True, timeout=WATCHDOG_S)
        return str(target)

    return build


@pytest.fixture
def python() -> Callable[..., str]:
    """Runs Python code to its end, behind a command if one is given, and returns what it printed."""

    def run(
        code: str, *args: object, before: tuple[str, ...] | list[str] = (), flags: tuple[str, ...] = (), **env: str
    ) -> str:
        done = subprocess.run(
            [*before, sys.executable, *flags, "-c", textwrap.dedent(code), *map(str, args)],
            check=False,
            capture_output=True,
            text=True,
            cwd="/",
            timeout=WATCHDOG_S,
            env={**os.environ, **env},
        )
        if done.returncode:
            pytest.fail(f"exit {done.returncode}\n{done.stdout}{done.stderr}")
        return done.stdout

    return run
