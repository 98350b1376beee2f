# SPDX-License-Identifier: Apache-2.0
"""Starting a command: what it loads, what it says when it is used wrongly."""

from __future__ import annotations

import subprocess
import sys
import types
from collections.abc import Callable

import pytest

from shmtf import cli

HEAVY = {"numpy", "rich", "psutil", "asyncio", "posix_ipc", "scipy", "zenoh"}

LOADED = """
import sys
from shmtf import cli
try:
    getattr(cli, sys.argv[1])(sys.argv[2:])
except SystemExit:
    pass
print("loaded", *sorted({name.split(".")[0] for name in sys.modules}))
"""


@pytest.mark.parametrize(
    "arguments",
    [
        ("main_dump", "--help"),
        ("main", "--help"),
        ("main", "--version"),
        *(("main", name, "--help") for name in ("list", "dump", "echo", "check", "rm")),
        ("main_dump", "--no-such-option"),
    ],
    ids=" ".join,
)
def test_help_loads_little(
    run_python: Callable[..., subprocess.CompletedProcess[str]], arguments: tuple[str, ...]
) -> None:
    out = run_python(LOADED, *arguments).stdout.splitlines()
    assert not HEAVY & set(out[-1].split())


def test_installed_help_loads_little() -> None:
    program = [sys.executable, "-X", "importtime", "-c", "from shmtf.cli import main_dump; main_dump(['--help'])"]
    done = subprocess.run(program, check=False, capture_output=True, text=True, cwd="/")
    names = {line.split("|")[-1].strip().split(".")[0] for line in done.stderr.splitlines()}
    assert "argparse" in names
    assert not HEAVY & names


def test_help_says_the_commands(command: Callable[..., subprocess.CompletedProcess[str]]) -> None:
    text = command("shmtf", "--help").stdout
    for name in ("list", "dump", "echo", "check", "rm", "bench"):
        assert f"\n  {name} " in text


def test_version(command: Callable[..., subprocess.CompletedProcess[str]]) -> None:
    import shmtf

    assert command("shmtf", "--version").stdout.strip() == shmtf.__version__


@pytest.mark.parametrize(
    "words",
    [
        ("shmtf",),
        ("shmtf", "no-such-command"),
        ("shmtf-dump", "x", "--tree", "--json"),
        ("shmtf-dump", "x", "--records", "0"),
        ("shmtf-dump", "x", "--yaml", "--records", "3"),
        ("shmtf-dump", "x", "--watch", "--interval", "0"),
        ("shmtf", "echo", "only_one"),
        ("shmtf", "echo", "a", "b", "c"),
        ("shmtf", "echo", "a", "b", "--rate", "0"),
        ("shmtf", "rm"),
    ],
    ids=" ".join,
)
def test_wrong_use(command: Callable[..., subprocess.CompletedProcess[str]], words: tuple[str, ...]) -> None:
    assert "error:" in command(*words, code=2).stderr


@pytest.mark.parametrize("words", [("shmtf-dump",), ("shmtf", "echo", "a", "b", "--store"), ("shmtf", "rm")])
def test_no_such_store(
    command: Callable[..., subprocess.CompletedProcess[str]], store_name: str, words: tuple[str, ...]
) -> None:
    done = command(*words, store_name, code=1)
    assert len(done.stderr.splitlines()) == 1
    assert store_name in done.stderr
    assert not done.stdout


def test_bench_is_delegated(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = []
    fake = types.ModuleType("shmtf.bench")
    fake.main = lambda argv: seen.append(argv) or 3  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "shmtf.bench", fake)
    assert cli.main_bench(["ycsb", "--help"]) == 3
    assert cli.main(["bench", "ycsb"]) == 3
    assert seen == [["ycsb", "--help"], ["ycsb"]]


def test_a_bug_is_not_hidden(monkeypatch: pytest.MonkeyPatch) -> None:
    fake = types.ModuleType("shmtf.bench")
    fake.main = lambda argv: 1 // 0  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "shmtf.bench", fake)
    with pytest.raises(ZeroDivisionError):
        cli.main_bench([])
