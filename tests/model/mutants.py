# SPDX-License-Identifier: Apache-2.0
"""Test the tests: mutations of the shipped source (mutants.txt), each to be caught by the scheduler or a unit test.

Run on demand: python3 tests/model/mutants.py [NAME...]. Takes some minutes.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

MODEL = Path(__file__).resolve().parent
ROOT = MODEL.parents[1]
UNITS = ROOT / "tests" / "native"
FLAGS = ("-std=c11", "-O1", "-w")
WATCHDOG_S = 600
UNIT_TESTS = ("stage", "txn", "ring", "names", "lookup", "arena", "agree")
RUNS = (("1", "0", "1"), ("1", "1", "2"), ("2", "0", "3"), ("2", "1", "8"))

Hunk = tuple[str, str, str]  # file, what goes, what comes


def parse(text: str) -> dict[str, list[Hunk]]:
    mutants: dict[str, list[Hunk]] = {}
    for line in text.splitlines(keepends=True):
        if line.startswith("== "):
            hunks = mutants[line[3:].strip()] = []
        elif line.startswith("@@ "):
            hunks.append((line[3:].strip(), "", ""))
        elif line[0] in "-+":
            file, goes, comes = hunks.pop()
            hunks.append((file, goes + line[1:], comes) if line[0] == "-" else (file, goes, comes + line[1:]))
    return mutants


def mutate(native: Path, hunks: list[Hunk]) -> None:
    for file, goes, comes in hunks:
        path = native / file
        text = path.read_text()
        if text.count(goes) != 1:
            raise SystemExit(f"{file} does not hold this once any more:\n{goes}")
        path.write_text(text.replace(goes, comes))


def compile_to(out: Path, native: Path, sources: list[Path], *flags: str) -> None:
    core = [*sorted((native / "core").glob("*.c")), native / "segment" / "layout.c"]
    include = [f"-I{p}" for p in (native, native / "include", UNITS, MODEL)]
    command = ["cc", *FLAGS, *flags, *include, *map(str, [*sources, *core]), "-lm", "-o", str(out)]
    subprocess.run(command, check=True, capture_output=True, text=True)


def why_it_fails(*command: str) -> str | None:
    try:
        done = subprocess.run(command, check=False, capture_output=True, text=True, timeout=WATCHDOG_S)
    except subprocess.TimeoutExpired:
        return "does not end"
    if done.returncode == 0:
        return None
    lines = [line for line in (done.stdout + done.stderr).splitlines() if line.strip()]
    found = [line for line in lines if line.startswith("VIOLATION")]
    return (found or lines[-1:] or [f"exit {done.returncode}"])[0]


def caught_by(native: Path, work: Path) -> str | None:
    xsim = work / "xsim"
    compile_to(xsim, native, sorted(MODEL.glob("*.c")), "-DSHMTF_STEPS")
    for name in UNIT_TESTS:
        compile_to(work / name, native, [UNITS / f"{name}.c"])
    checks = [(f"xsim {' '.join(run)}", (str(xsim), "all", *run)) for run in RUNS]
    checks[1:1] = [(name, (str(work / name),)) for name in UNIT_TESTS]
    for name, command in checks:
        if why := why_it_fails(*command):
            return f"{name}: {why}"
    return None


def main(names: list[str]) -> int:
    mutants = parse((MODEL / "mutants.txt").read_text())
    survivors = 0
    for name in names or mutants:
        with tempfile.TemporaryDirectory() as folder:
            work = Path(folder)
            shutil.copytree(ROOT / "native", work / "native")
            mutate(work / "native", mutants[name])
            why = caught_by(work / "native", work)
        print(f"{'caught  ' if why else 'SURVIVED'} {name}: {why}", flush=True)
        survivors += why is None
    print(f"{len(names or mutants) - survivors} of {len(names or mutants)} caught")
    return survivors != 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
