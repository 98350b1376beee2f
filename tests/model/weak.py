# SPDX-License-Identifier: Apache-2.0
"""The scenarios of weak/ for checkers of weak memory models: GenMC (*.c: the shipped source) and herd7 (*.litmus).

Each scenario runs as it is, where nothing may be found, and with an end of an edge taken away, which has to be found.
An end is a line of the source that carries the edge's label, or the line after a comment that does: there a release
or acquire becomes relaxed, a sequentially consistent access acquire and release, and a fence goes. Neither checker is
packaged; native/MEMORY_MODEL.md says what was run. Tier: on demand (tools/dev model, where they are on PATH).
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

MODEL = Path(__file__).resolve().parent
WEAK = MODEL / "weak"
NATIVE = MODEL.parents[1] / "native"
WATCHDOG_S = 3600
CRASH_STEPS = 60  # no writer of a scenario makes that many stores

TO_RELAXED = {"cas_acq_rel(": "cas_relaxed(", "cas_seq_cst(": "cas_relaxed(", "raise_to(": "raise_relaxed("}
WEAKER = {
    "release": TO_RELAXED | {"store_release(": "store_relaxed(", "fence_release()": "(void)0"},
    "acquire": {
        "load_acquire(": "load_relaxed(",
        "load_seq_cst(": "load_relaxed(",
        "fence_acquire()": "(void)0",
    },
    "seq_cst": {
        "load_seq_cst(": "load_acquire(",
        "cas_seq_cst(": "cas_acq_rel(",
        "fetch_or_seq_cst(": "fetch_or_acq_rel(",
        "fence_seq_cst()": "(void)0",
    },
}
ADDED = """
static inline bool cas_relaxed(shmtf_word *w, uint64_t expected, uint64_t desired) {
    shmtf_step(SHMTF_STEP_STORE, (const void *)w);
    return atomic_compare_exchange_strong_explicit(w, &expected, desired, memory_order_relaxed, memory_order_relaxed);
}
static inline uint64_t fetch_or_acq_rel(shmtf_word *w, uint64_t bits) {
    return atomic_fetch_or_explicit(w, bits, memory_order_acq_rel);
}
static inline void raise_relaxed(shmtf_word *w, uint64_t v) {
    uint64_t old = load_relaxed(w);
    while (old < v && !cas_relaxed(w, old, v)) old = load_relaxed(w);
}
"""
# Functions of files that need an operating system, which the checkers do not have.
PARTS = {
    "bell_part.c": ("segment/wait.c", "void bell_ring(", "static struct timespec to_timespec"),
    "authority_part.c": ("api/store.c", "enum { CLAIM_WRITING", "uint16_t store_authority("),
}


class Check(NamedTuple):
    scenario: str
    define: str = ""
    broken: str = ""  # "E3 release": the ends that are taken away; several, where one of them is enough to be safe
    long: bool = False


CHECKS = [
    Check("layout.c"),
    Check("layout.c", broken="E1 release"),
    Check("layout.c", broken="E1 acquire"),
    Check("commit.c"),
    Check("commit.c", "APART", long=True),
    Check("commit.c", "OPPOSITE", long=True),
    Check("commit.c", broken="E2 release"),
    Check("commit.c", broken="E2 acquire"),
    Check("help.c"),
    Check("help.c", broken="E4 release"),
    Check("help.c", broken="E4 acquire"),
    Check("record.c"),
    Check("record.c", broken="E3 release"),
    Check("record.c", broken="E3 acquire"),
    Check("quick.c"),
    Check("quick.c", broken="E3 release"),
    Check("quick.c", broken="E3 acquire"),
    Check("quick.c", broken="E5 release"),
    Check("quick.c", broken="E5 acquire"),
    Check("topology.c"),
    Check("topology.c", broken="E4 release, E6 release"),
    Check("topology.c", broken="E4 acquire, E6 acquire"),
    Check("names.c"),
    Check("names.c", broken="E7 release"),
    Check("names.c", broken="E7 acquire"),
    Check("names.c", "HINTS"),
    Check("names.c", "HINTS", broken="E8 release"),
    Check("names.c", "HINTS", broken="E8 acquire"),
    Check("bell.c"),
    Check("bell.c", broken="E9 seq_cst"),
    Check("death.c"),
    Check("death.c", "CRASH_AT", broken="E10 seq_cst"),
    Check("authority.c"),
    Check("authority.c", broken="E11 release"),
    Check("authority.c", broken="E11 acquire"),
    *[Check(f, f"CRASH_AT={k}") for f in ("commit.c", "death.c") for k in range(1, CRASH_STEPS)],
]


def code_of(line: str) -> str:
    return re.sub(r"/\*.*?(\*/|$)|^\s*\*.*", "", line).strip()


def weaken(text: str, broken: str) -> tuple[str, int]:
    """The text without the named ends, and how many there were."""
    lines, n = text.splitlines(keepends=True), 0
    side = broken.split()[-1]
    ends = [re.escape(end.strip()) for end in broken.split(",")]
    for i, line in enumerate(lines):
        if not re.search(rf"\[({'|'.join(ends)})\b", line):
            continue
        at = i
        while not code_of(lines[at]):
            at += 1
        for goes, comes in WEAKER[side].items():
            n += lines[at].count(goes)
            lines[at] = lines[at].replace(goes, comes)
    return "".join(lines), n


def patches(text: str) -> list[tuple[str, str, str]]:
    hunks: list[tuple[str, str, str]] = []
    for line in text.splitlines(keepends=True):
        if line.startswith("@@ "):
            hunks.append((line[3:].strip(), "", ""))
        elif hunks and line[0] in "-+":
            file, goes, comes = hunks.pop()
            hunks.append((file, goes + line[1:], comes) if line[0] == "-" else (file, goes, comes + line[1:]))
    return hunks


def prepare(folder: Path, broken: str) -> None:
    """A copy of the source and the scenarios as a checker wants them, without the ends named in `broken`."""
    shutil.copytree(NATIVE, folder, dirs_exist_ok=True)
    for path in (*WEAK.glob("*.c"), WEAK / "scenario.h"):
        shutil.copy(path, folder)
    for file, goes, comes in patches((WEAK / "patches.txt").read_text()):
        text = (folder / file).read_text()
        if text.count(goes) != 1:
            raise SystemExit(f"weak/patches.txt: {file} does not hold this once any more:\n{goes}")
        (folder / file).write_text(text.replace(goes, comes))
    n = 0
    for path in [p for p in folder.rglob("*.[ch]") if broken]:
        text, found = weaken(path.read_text(), broken)
        path.write_text(text)
        n += found
    if broken and not n:
        raise SystemExit(f"no line carries [{broken}]")
    for name, (file, begin, end) in PARTS.items():
        text = (folder / file).read_text()
        at = text.index(begin)
        (folder / name).write_text(text[at : text.index(end, at)] + "\n")
    header = folder / "segment" / "atomic.h"
    header.write_text(header.read_text().replace("/* A hint to the core", ADDED + "\n/* A hint to the core"))


def genmc(check: Check, model: str = "--rc11") -> tuple[bool, str]:
    """(whether it is as it has to be, what was found)"""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        prepare(folder, check.broken)
        steps = range(1, CRASH_STEPS) if check.define == "CRASH_AT" else [0]
        done = None
        for k in steps:
            define = [f"-D{check.define}={k}" if k else f"-D{check.define}"] if check.define else []
            flags = ["--", "-w", "-I.", "-Iinclude", *define, check.scenario]
            command = ["genmc", model, "--disable-race-detection", *flags]
            done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=WATCHDOG_S, check=False)
            if "Assertion violation" in done.stdout + done.stderr:
                break
        assert done is not None
    text = done.stdout + done.stderr
    if "Assertion violation" in text:
        return bool(check.broken), "found"
    if "No errors were detected" in text:
        count = re.search(r"complete executions explored: (\d+)", text)
        return not check.broken, f"{count[1] if count else '?'} executions, none wrong"
    return False, text.strip().splitlines()[-1] if text.strip() else f"exit {done.returncode}"


def litmus(path: Path) -> tuple[bool, str]:
    """A litmus file says in a comment what its `exists` has to be: never, or sometimes."""
    expected = re.search(r"expect: (never|sometimes)", path.read_text())
    command = ["herd7", str(path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=WATCHDOG_S, check=False)
    verdict = re.search(r"^Observation \S+ (\w+) (\d+) (\d+)", done.stdout, re.MULTILINE)
    if not verdict or not expected:
        return False, (done.stderr or done.stdout).strip()[-200:]
    return verdict[1].lower() == expected[1], f"{verdict[1].lower()}, {int(verdict[2]) + int(verdict[3])} outcomes"


def run_genmc(wanted: list[str], everything: bool) -> int:
    failures = 0
    for check in CHECKS:
        if (wanted and check.scenario not in wanted) or (check.long and not everything):
            continue
        began = time.monotonic()
        good, what = genmc(check)
        failures += not good
        name = f"{check.scenario} {check.define}".strip() + (f" without {check.broken}" if check.broken else "")
        print(f"{'ok  ' if good else 'FAIL'} genmc {name}: {what} ({time.monotonic() - began:.0f} s)", flush=True)
    return failures


def run_herd(wanted: list[str]) -> int:
    failures = 0
    for path in sorted(WEAK.glob("*.litmus")):
        if wanted and path.name not in wanted:
            continue
        good, what = litmus(path)
        failures += not good
        print(f"{'ok  ' if good else 'FAIL'} herd7 {path.name}: {what}", flush=True)
    return failures


def main(arguments: list[str]) -> int:
    wanted = [a for a in arguments if not a.startswith("-")]
    failures = run_genmc(wanted, "--all" in arguments) if shutil.which("genmc") else 0
    return (failures + run_herd(wanted) if shutil.which("herd7") else failures) != 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
