# SPDX-License-Identifier: Apache-2.0
"""The installed package, whichever way it was installed: a store, a write, a lookup from another process, the tools.

CI copies this file out of the checkout and runs it against a wheel, so it may use nothing but the package.
"""

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from importlib.metadata import version

import pytest

import shmtf

T_MAP_BASE = shmtf.Transform("map", "base_link", 1_000_000_000, (1.0, 2.0, 3.0), (0.0, 0.0, 0.0, 1.0))

LOOK_UP = """
import sys, shmtf
with shmtf.Store.attach(sys.argv[1], readonly=True) as store:
    T = store.lookup_latest_transform("map", "base_link")
    print(T.stamp, *T.translation)
"""


@pytest.fixture
def name() -> Iterator[str]:
    name = f"smoke-{os.getpid()}"
    with shmtf.Store.create(name, max_frames=16, history=8) as store:
        store.set_transform(T_MAP_BASE)
        try:
            yield name
        finally:
            shmtf.Store.unlink(name)


def run(*command: str) -> str:
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_version() -> None:
    assert shmtf.__version__ == version("shmtf")


def test_other_process_reads(name: str) -> None:
    assert run(sys.executable, "-c", LOOK_UP, name).split() == ["1000000000", "1.0", "2.0", "3.0"]


def test_dump(name: str) -> None:
    script = os.path.join(os.path.dirname(sys.executable), "shmtf-dump")
    text = run(script, name, "--json")
    json.loads(text)
    assert "base_link" in text
