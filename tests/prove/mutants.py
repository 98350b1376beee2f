# SPDX-License-Identifier: Apache-2.0
"""Test the prover: mutations of the shipped source (mutants.txt), each to be caught by `prove`, killing and stopping.

Run on demand: python3 tests/prove/mutants.py [NAME...]. Takes some minutes. Mutations that only show where two writers
run at once are in tests/model.
"""

from __future__ import annotations

import importlib.util
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

PROVE = Path(__file__).resolve().parent
ROOT = PROVE.parents[1]
FLAGS = ("-std=gnu11", "-O1", "-w", "-pthread", "-DSHMTF_STEPS", '-DSHMTF_VERSION_STRING="0"')
SHARED = ("prove", "trial", "hook", "world", "operations", "view", "check")
WATCHDOG_S = 900

spec = importlib.util.spec_from_file_location("model_mutants", ROOT / "tests" / "model" / "mutants.py")
assert spec and spec.loader
model = sys.modules[spec.name] = importlib.util.module_from_spec(spec)
spec.loader.exec_module(model)


def caught_by(native: Path, work: Path) -> str | None:
    program = work / "prove"
    sources = [
        *(PROVE / f"{name}.c" for name in SHARED),
        *(p for d in ("segment", "core", "api") for p in sorted((native / d).glob("*.c"))),
    ]
    include = [f"-I{p}" for p in (native, native / "include")]
    subprocess.run(["cc", *FLAGS, *include, *map(str, sources), "-lm", "-o", str(program)], check=True)
    try:
        done = subprocess.run(
            [str(program), "--quick"], check=False, capture_output=True, text=True, timeout=WATCHDOG_S
        )
    except subprocess.TimeoutExpired:
        return "does not end"
    if done.returncode == 0:
        return None
    lines = [line for line in done.stderr.splitlines() if line.strip()]
    return " ".join(lines[:2])[:200] or f"exit {done.returncode}"


def main(names: list[str]) -> int:
    mutants = model.parse((PROVE / "mutants.txt").read_text())
    survivors = 0
    for name in names or ["(none)", *mutants]:
        with tempfile.TemporaryDirectory() as directory:
            work = Path(directory)
            shutil.copytree(ROOT / "native", work / "native")
            if name in mutants:
                model.mutate(work / "native", mutants[name].hunks)
            why = caught_by(work / "native", work)
        wrong = (why is None) != (name == "(none)")
        survivors += wrong
        print(f"{'WRONG ' if wrong else ''}{name}: {why or 'no failure'}", flush=True)
    return survivors


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]) != 0)
