# SPDX-License-Identifier: Apache-2.0
"""`shmtf echo TARGET SOURCE`."""

from __future__ import annotations

import math
import re
import signal
import subprocess
from collections.abc import Callable

import pytest

import shmtf

from .conftest import script

Run = Callable[..., subprocess.CompletedProcess[str]]


def numbers(text: str, label: str) -> list[float]:
    line = next(line for line in text.splitlines() if line.strip().startswith(label))
    return [float(v) for v in re.findall(r"-?\d+\.\d+(?:e-?\d+)?", line)]


def test_what_it_prints(command: Run, store: shmtf.Store) -> None:
    store.set_transform(shmtf.Transform.from_rpy("map", "base", 10**18 + 7, (1.0, 2.0, 3.0), (0.1, -0.2, 0.3)))
    store.set_transform(shmtf.Transform("base", "laser", None, (0.5, 0.0, 0.0)), static=True)
    out = command("shmtf", "echo", "map", "laser", "--store", store.name).stdout
    T = store.lookup_latest_transform("map", "laser")
    assert out.startswith('pose of "laser" in "map"')
    assert "1000000000.000000007" in out
    assert numbers(out, "translation") == pytest.approx(T.translation, abs=1e-6)
    assert numbers(out, "quaternion") == pytest.approx(T.rotation, abs=1e-6)
    assert numbers(out, "rpy") == pytest.approx((0.1, -0.2, 0.3), abs=1e-6)
    assert numbers(out, "roll") == pytest.approx([math.degrees(v) for v in (0.1, -0.2, 0.3)], abs=1e-3)
    other = command("shmtf", "echo", "--source", "map", "--target", "laser", "--store", store.name).stdout
    assert other.startswith('pose of "map" in "laser"')
    assert numbers(other, "translation") == pytest.approx(T.inv().translation, abs=1e-6)


def test_static_has_no_stamp(command: Run, store: shmtf.Store) -> None:
    store.set_transform(shmtf.Transform("base", "laser"), static=True)
    assert "every edge is static" in command("shmtf", "echo", "base", "laser", "--store", store.name).stdout


def test_latest_and_common(command: Run, store: shmtf.Store) -> None:
    for k in range(5):
        store.set_transform(shmtf.Transform("odom", "base", 10**18 + k, (float(k), 0.0, 0.0)))
    store.set_transform(shmtf.Transform("map", "odom", 10**18 + 2))
    arguments = ("shmtf", "echo", "map", "base", "--store", store.name)
    assert numbers(command(*arguments).stdout, "translation")[0] == 4
    assert numbers(command(*arguments, "--time", "common").stdout, "translation")[0] == 2


def test_again_and_again(command: Run, live: shmtf.Store) -> None:
    out = command("shmtf", "echo", "map", "arm6", "--store", live.name, "--rate", "100", "-n", "5").stdout
    stamps = re.findall(r"stamp +(\d+\.\d+)", out)
    assert len(stamps) == 5
    assert stamps == sorted(stamps)


def test_interrupt(live: shmtf.Store) -> None:
    process = subprocess.Popen(
        [script("shmtf"), "echo", "map", "arm6", "--store", live.name, "--rate", "50"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd="/",
    )
    assert process.stdout is not None
    while "rpy" not in process.stdout.readline():
        assert process.poll() is None
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate()
    assert (process.returncode, errors) == (0, "")


def test_failures(command: Run, live: shmtf.Store) -> None:
    arguments = ("shmtf", "echo", "map", "arm9", "--store", live.name)
    done = command(*arguments, code=1)
    assert 'frame "arm9" does not exist' in done.stderr
    assert len(done.stderr.splitlines()) == 1
    command(*arguments, "--rate", "100", "-n", "3", code=1)
