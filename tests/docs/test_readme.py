# SPDX-License-Identifier: Apache-2.0
"""What the README says is run as it stands, but for the store's name."""

import re
from collections.abc import Callable
from pathlib import Path

import pytest

import shmtf

README = Path(__file__).resolve().parents[2] / "README.md"
BLOCKS = re.findall(r"^```(\w*)\n(.*?)^```", README.read_text(), re.DOTALL | re.MULTILINE)
PYTHON = [code for language, code in BLOCKS if language == "python"]


@pytest.fixture
def renamed(store_name: str) -> Callable[[str], str]:
    return lambda code: code.replace('"robot"', repr(store_name))


def test_two_processes(renamed: Callable[[str], str], run_python: Callable) -> None:
    sensor, planner = PYTHON[:2]
    run_python(renamed(sensor))
    assert run_python(renamed(planner)).stdout.startswith("[1.5 2.  0. ]")


def test_the_failing_lookup_fails_as_shown(
    renamed: Callable[[str], str], store_name: str, run_python: Callable
) -> None:
    run_python(renamed(PYTHON[0]))
    call, expected = next(code for _, code in BLOCKS if code.startswith(">>> ")).splitlines()
    with shmtf.Store.attach(store_name, readonly=True) as store, pytest.raises(shmtf.TransformException) as caught:
        eval(call.removeprefix(">>> "), {"store": store, "shmtf": shmtf})
    said = f"{type(caught.value).__module__}.{type(caught.value).__name__}: {caught.value}"
    assert re.sub(r"\d+", "0", said) == re.sub(r"\d+", "0", expected)


def test_the_tour_of_the_store(renamed: Callable[[str], str], store_name: str, run_python: Callable) -> None:
    tour = next(code for code in PYTHON if "store.set_transforms(" in code)
    head, tail = tour.split('store.lookup_transform("base_link", "arm_2", t) ')
    moving = (
        "t = shmtf.now()\n"
        "for joint in (('base_link', 'arm_1'), ('arm_1', 'arm_2')):\n"
        "    store.set_transform(shmtf.Transform(*joint, t + 10**6))\n"
        "store.set_transform(shmtf.Transform('arm_2', 'tool', t))\n"
    )
    run_python("import shmtf\n" + renamed(head) + moving + 'store.lookup_transform("base_link", "arm_2", t) ' + tail)
    with shmtf.Store.attach(store_name) as store:
        assert store.frame_exists("lidar")


def test_the_files_it_names_exist() -> None:
    names = re.findall(r"`((?:native|shmtf|bench|tests|examples|tools)/[\w/.]*\w)`", README.read_text())
    assert names
    assert [name for name in names if not (README.parent / name).exists()] == []
