# SPDX-License-Identifier: Apache-2.0
"""tools/dev explains itself and refuses what it does not know."""

import subprocess
from pathlib import Path

DEV = Path(__file__).resolve().parents[2] / "tools" / "dev"


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([str(DEV), *arguments], capture_output=True, text=True, check=False, cwd="/")


def test_explains_itself_without_arguments() -> None:
    done = run()
    assert done.returncode == 0
    commands = [line.split()[0] for line in done.stdout.splitlines()[1:] if line[2] != " "]
    assert commands[:6] == ["setup", "build", "test", "demo", "check", "bench"]
    assert {"prove", "soak", "model", "native"} <= set(commands)
    assert commands[-1] == "ci"


def test_unknown_command_is_an_error() -> None:
    done = run("frobnicate")
    assert done.returncode == 1
    assert "no command 'frobnicate'" in done.stderr
    assert done.stdout == ""


def test_unknown_variant_is_an_error() -> None:
    done = run("native", "gremlin")
    assert done.returncode == 1
    assert "plain, address, thread" in done.stderr
