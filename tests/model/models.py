# SPDX-License-Identifier: Apache-2.0
"""Every model of the protocol, and one table of what was visited: python3 models.py XSIM [--all] [--spin-only].

1. xsim, the shipped source under every schedule with bounded preemptions and kills (scenarios.c), on all processors;
2. commit.pml with spin, and each error that its switches plant, which has to be found;
3. weak/, the scenarios for weak memory models, where GenMC and herd7 are on PATH (weak.py).

Tier: .ci/run, some minutes on two processors; with --all on demand, an hour and more. Run by tools/dev model.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

import weak

MODEL = Path(__file__).resolve().parent
WATCHDOG_S = 7200

# preemptions, crashes, stride (1: every schedule within the bounds; n: about one point in n may preempt or crash)
XSIM_CI = ((1, 0, 1), (1, 1, 1), (2, 1, 5), (1, 2, 3))
XSIM_ALL = (*XSIM_CI, (2, 0, 1), (2, 1, 2), (1, 2, 1), (2, 2, 6), (3, 1, 9))

SPIN_CI = (("ALONE", 2), ("ATOMICITY", 0), ("SHAPE", 0))
SPIN_ALL = (*SPIN_CI, ("FORK", 0), ("ATOMICITY", 1))
PLANTED = (
    ("WITHOUT_DECIDED", "ATOMICITY", 0),
    ("WITHOUT_VERSIONS", "ATOMICITY", 0),
    ("WITHOUT_SETTLE", "FORK", 0),
    ("WITHOUT_SECOND_LOOK", "ALONE", 1),
    ("WITHOUT_TOPOLOGY_CHECK", "SHAPE", 0),
    ("WITHOUT_HELPERS_TOPOLOGY", "SHAPE", 0),
    ("WITHOUT_OWNERS_TOPOLOGY", "SHAPE", 0),
    ("WITH_HEAD_FIRST", "ATOMICITY", 0),
    ("WITH_HEAD_AFTER_COMMIT", "ATOMICITY", 0),
    ("WITH_PLAIN_RELEASE", "ATOMICITY", 1),
    ("WITH_NUMBERS_AGAIN", "ATOMICITY GOES_ON", 1),
)


class Row(NamedTuple):
    what: str
    bounds: str
    visited: str
    violations: str


def run(command: list[str], folder: Path | None = None) -> str:
    """Output, with the exit code in its last line if it is not 0."""
    options = {"capture_output": True, "text": True, "errors": "replace", "timeout": WATCHDOG_S}
    done = subprocess.run(command, cwd=folder, check=False, **options)
    return done.stdout + done.stderr + (f"\nexit {done.returncode}" if done.returncode else "")


# ---- the scheduler ---------------------------------------------------------------------------------------------------


def scenarios() -> list[str]:
    table = (MODEL / "scenarios.c").read_text().split("const scenario scenarios[]")[1]
    return re.findall(r'^ {4}\{"([^"]+)", \d', table, re.MULTILINE)


def run_xsim(xsim: str, bounds: tuple[int, int, int]) -> Row:
    preemptions, crashes, stride = bounds
    began = time.monotonic()
    names = scenarios()
    with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
        outputs = list(pool.map(lambda name: run([xsim, name, *map(str, bounds)]), names))
    executions = kills = 0
    bad = []
    for name, text in zip(names, outputs, strict=True):
        found = re.search(r": (\d+) executions, (\d+) crashes", text)
        if found and "no violation" in text:
            executions, kills = executions + int(found[1]), kills + int(found[2])
        else:
            bad.append(f"{name}: {text.strip()}")
    print("\n".join(bad), end="\n" if bad else "", flush=True)
    what = f"{executions:,} executions, {kills:,} kills, {time.monotonic() - began:.0f} s"
    every = "every schedule" if stride == 1 else f"points 1 in {stride}"
    limits = f"{preemptions} preemptions, {crashes} crashes, {every}"
    return Row(f"xsim, {len(names)} scenarios", limits, what, str(len(bad)))


# ---- spin ------------------------------------------------------------------------------------------------------------


def spin(switches: list[str], folder: Path, depth: int = 1_000_000) -> tuple[int, str]:
    """(errors, states); raises if it did not finish."""
    text = run(["spin", "-a", *[f"-D{s}" for s in switches], str(MODEL / "commit.pml")], folder)
    if (folder / "pan.c").exists():
        text += run(["cc", "-O2", "-w", "-DSAFETY", "-DCOLLAPSE", "-DMEMLIM=12000", "-o", "pan", "pan.c"], folder)
        text += run(["./pan", f"-m{depth}"], folder)
    errors, states = re.search(r"errors: (\d+)", text), re.search(r"(\d\S*) states, stored", text)
    if not errors or not states or "max search depth too small" in text or "out of memory" in text:
        raise RuntimeError(f"spin {' '.join(switches)} did not finish:\n{text[-1500:]}")
    return int(errors[1]), states[1]


def run_spin(case: tuple[str, int]) -> Row:
    with tempfile.TemporaryDirectory() as folder:
        errors, states = spin([*case[0].split(), f"CRASHES={case[1]}"], Path(folder))
    return Row("commit.pml", f"{case[0]}, {case[1]} crashes", f"{float(states):,.0f} states", str(errors))


def run_planted(case: tuple[str, str, int]) -> Row:
    error, check, crashes = case
    with tempfile.TemporaryDirectory() as folder:
        errors, states = spin([*check.split(), f"CRASHES={crashes}", error], Path(folder))
    what = f"found after {float(states):,.0f} states" if errors else "not found"
    return Row(f"  {error.lower()}", f"{check}, {crashes} crashes", what, "0" if errors else "1")


# ---- all -------------------------------------------------------------------------------------------------------------


def run_weak(everything: bool) -> list[Row]:
    n_c, n_litmus = len(weak.CHECKS), len(list(weak.WEAK.glob("*.litmus")))
    rows = []
    if shutil.which("genmc"):
        bad = weak.run_genmc([], everything)
        rows.append(Row("weak/*.c with GenMC", "RC11", f"{n_c} runs", str(bad)))
    else:
        rows.append(Row("weak/*.c", "RC11", f"not run: genmc is not on PATH ({n_c} runs)", "-"))
    if shutil.which("herd7"):
        rows.append(Row("weak/*.litmus with herd7", "AArch64", f"{n_litmus} files", str(weak.run_herd([]))))
    else:
        rows.append(Row("weak/*.litmus", "AArch64", f"not run: herd7 is not on PATH ({n_litmus} files)", "-"))
    return rows


def show(rows: list[Row]) -> None:
    widths = [max(len(row[i]) for row in rows) for i in range(3)]
    for row in rows:
        print("  ".join(cell.ljust(width) for cell, width in zip(row[:3], widths, strict=True)), " ", row.violations)


def main(arguments: list[str]) -> int:
    everything = "--all" in arguments
    paths = [a for a in arguments if not a.startswith("-")]
    rows = [Row("what", "bounds", "visited", "violations")]
    rows += [run_xsim(xsim, bounds) for xsim in paths for bounds in (XSIM_ALL if everything else XSIM_CI)]
    if shutil.which("spin"):
        with ThreadPoolExecutor(1 if everything else 2) as pool:
            rows += pool.map(run_spin, SPIN_ALL if everything else SPIN_CI)
            rows += pool.map(run_planted, PLANTED)
    else:
        rows.append(Row("commit.pml", "", "not run: spin is not installed", "-"))
    rows += run_weak(everything)
    show(rows)
    return any(row.violations not in "0-" for row in rows[1:])


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
