# SPDX-License-Identifier: Apache-2.0
"""Recorded histories of deliberately broken builds are rejected.

Tier: test, for a handful of mutations that show within a second or two; all of them on demand: tools/dev mutants.
"""

from __future__ import annotations

import importlib.util
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType

import log
import pytest
import tree
from linear import Operation, first_impossible

BROKEN = (
    "copy of the newest written over the one in force",
    "snapshot ignored by lookups",
    "reader ignores versions",
    "topology not checked at the commit",
    "cycles looked for among the transaction's frames alone",
)
SOON = ((700, 4, 3, 100, 16), (700, 3, 3, 20, 0))
ROUNDS = 8
SHORT = ("250", "3", "2", "0", "16", "128")
SEEDS = 40
WATCHDOG_S = 60


def load_module() -> ModuleType:
    path = Path(__file__).resolve().parents[1] / "model" / "mutants.py"
    spec = importlib.util.spec_from_file_location("mutants", path)
    assert spec and spec.loader
    module = sys.modules[spec.name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


mutants = load_module()


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Iterator[object]:
    """The source as it is, built like the mutants."""
    if not shutil.which("cc"):
        pytest.skip("no C compiler")
    folder = tmp_path_factory.mktemp("original")
    yield mutants.Build(folder / "build")
    shutil.rmtree(folder)


@pytest.fixture
def broken(original: object, tmp_path: Path) -> Iterator[Callable[[str], object]]:
    """A mutant's build."""
    folder = tmp_path / "build"

    def build(name: str) -> object:
        mutant = mutants.load()[name]
        assert "history" in mutant.caught_by
        return mutants.Build(folder, original, mutant.hunks)

    yield build
    shutil.rmtree(folder)


@pytest.mark.stress
def test_history_of_the_source_as_it_is_is_accepted(original: object) -> None:
    assert mutants.judge_histories(original, seed=1, rounds=1, regimes=SOON) is None


@pytest.mark.stress
@pytest.mark.parametrize("name", BROKEN)
def test_history_of_a_broken_build_is_rejected(name: str, broken: Callable[[str], object]) -> None:
    why = mutants.judge_histories(broken(name), seed=1, rounds=ROUNDS, regimes=SOON)
    print(f"{name}: {why}")
    assert why is not None


@pytest.mark.stress
@pytest.mark.parametrize("name", ["snapshot ignored by lookups", "reader ignores versions"])
def test_search_finds_no_serial_order_for_a_broken_build(
    name: str, broken: Callable[[str], object], store_name: str, tmp_path: Path
) -> None:
    record = str(broken(name).program("history_record"))  # type: ignore[attr-defined]
    impossible: Operation | None = None
    for seed in range(SEEDS):
        command = (record, store_name, str(tmp_path / "log"), str(seed), *SHORT)
        subprocess.run(command, check=True, capture_output=True, timeout=WATCHDOG_S)
        impossible = first_impossible(tree.operations(log.read(tmp_path / "log")), tree.NOTHING)
        if impossible:
            break
    assert impossible is not None
    print(f"seed {seed}: {impossible.name}")
