# SPDX-License-Identifier: Apache-2.0
"""Fixtures that every folder of tests shares."""

from __future__ import annotations

import os
import pty
import subprocess
import sys
import textwrap
import uuid
from collections.abc import Callable, Iterator
from pathlib import Path

import hypothesis
import pytest

import shmtf

SHM = "/dev/shm"
ROOT = Path(__file__).resolve().parents[1]

# a loaded machine is no finding
hypothesis.settings.register_profile("no deadline", deadline=None)
hypothesis.settings.load_profile("no deadline")


@pytest.fixture
def new_name() -> Iterator[Callable[[], str]]:
    """Makes names of stores that no other test uses; they are removed at the end."""
    names: list[str] = []

    def make() -> str:
        names.append(f"shmtf-test-{uuid.uuid4().hex}")
        return names[-1]

    yield make
    for name in names:
        try:
            shmtf.Store.unlink(name)
        except shmtf.StoreNotFoundError:
            pass
        except shmtf.StoreError:  # a test put something else there
            path = os.path.join(SHM, name)
            (os.rmdir if os.path.isdir(path) else os.unlink)(path)


@pytest.fixture(scope="session")
def program() -> Callable[[str], Path]:
    """Path of a program that CMake builds for the tests; skips where the C tests are not built."""

    def find(name: str) -> Path:
        build = os.environ.get("SHMTF_NATIVE_BUILD")
        path = Path(build or ROOT / "build" / "native") / "programs" / name
        if not path.exists():
            if build:
                pytest.fail(f"{path} was not built")
            pytest.skip(f"{name} is not built: tools/dev native")
        return path

    return find


@pytest.fixture
def store_name(new_name: Callable[[], str]) -> str:
    """A name without a store."""
    return new_name()


@pytest.fixture
def store(store_name: str) -> Iterator[shmtf.Store]:
    """A small new store."""
    with shmtf.Store.create(store_name, max_frames=64, history=32, stream_bytes=1 << 16, authority="test") as made:
        yield made


@pytest.fixture
def open_terminal() -> Callable[[], tuple[int, int]]:
    """Makes a pseudo terminal: (master, slave)."""

    def make() -> tuple[int, int]:
        try:
            return pty.openpty()
        except OSError as error:
            pytest.skip(f"no pseudo terminals here: {error}")

    return make


@pytest.fixture
def run_python() -> Callable[..., subprocess.CompletedProcess[str]]:
    """Runs a program in a process of its own, from a folder that is not the source tree."""

    def run(code: str, *args: str, check: bool = True, **options: object) -> subprocess.CompletedProcess[str]:
        done = subprocess.run(
            [sys.executable, "-c", textwrap.dedent(code), *args],
            check=False,
            capture_output=True,
            text=True,
            cwd="/",
            timeout=120,
            **options,  # type: ignore[call-overload]
        )
        if check and done.returncode:
            pytest.fail(f"exit {done.returncode}\n{done.stdout}{done.stderr}")
        return done

    return run
