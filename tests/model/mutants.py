# SPDX-License-Identifier: Apache-2.0
"""Test the tests: small mutations of the shipped source (mutants.txt), each to be caught by a checker, by name.

Three kinds of checkers are asked: `history` records what real processes are told (tests/history) and judges it,
`xsim` runs the core in every order with crashes (tests/model), and the unit tests of tests/native. mutants.txt names,
for each mutation, the checkers that are known to catch it; they are asked first, the others only if these do not.
Tier: on demand, tools/dev mutants; a few of them in tests/history/test_mutants.py.
"""

from __future__ import annotations

import argparse
import os
import random
import shutil
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

MODEL = Path(__file__).resolve().parent
ROOT = MODEL.parents[1]
NATIVE, UNITS, HISTORY = ROOT / "native", ROOT / "tests" / "native", ROOT / "tests" / "history"
FLAGS = ("-std=c11", "-O1", "-w", '-DSHMTF_VERSION_STRING="mutant"')
WATCHDOG_S = 600
RECORDING_WATCHDOG_S = 60
UNIT_TESTS = ("stage", "txn", "ring", "names", "lookup", "arena", "agree", "paused", "paused_helper")
XSIM_RUNS = ("xsim 1 0 1", "xsim 1 1 2", "xsim 2 0 3", "xsim 2 1 8")
CHECKERS = (XSIM_RUNS[0], *UNIT_TESTS, "history", *XSIM_RUNS[1:])
# of one history after the other until one is impossible: milliseconds, writers, readers, kills per second, chaos
REGIMES = ((1000, 4, 3, 100, 16), (1000, 3, 3, 20, 0), (1500, 4, 2, 200, 48), (1500, 6, 4, 100, 4))
ROUNDS = 3

Hunk = tuple[str, str, str]  # file, what goes, what comes


@dataclass
class Mutant:
    name: str
    caught_by: list[str] = field(default_factory=list)
    hunks: list[Hunk] = field(default_factory=list)


def parse(text: str) -> dict[str, Mutant]:
    mutants: dict[str, Mutant] = {}
    for line in text.splitlines(keepends=True):
        if line.startswith("== "):
            mutant = mutants[line[3:].strip()] = Mutant(line[3:].strip())
        elif line.startswith("?? "):
            mutant.caught_by = [checker.strip() for checker in line[3:].split(",")]
        elif line.startswith("@@ "):
            mutant.hunks.append((line[3:].strip(), "", ""))
        elif line[0] in "-+":
            file, goes, comes = mutant.hunks.pop()
            mutant.hunks.append((file, goes + line[1:], comes) if line[0] == "-" else (file, goes, comes + line[1:]))
    return mutants


def load() -> dict[str, Mutant]:
    return parse((MODEL / "mutants.txt").read_text())


def mutate(native: Path, hunks: list[Hunk]) -> None:
    for file, goes, comes in hunks:
        path = native / file
        text = path.read_text()
        if text.count(goes) != 1:
            raise SystemExit(f"{file} does not hold this once any more:\n{goes}")
        path.write_text(text.replace(goes, comes))


def cc(*arguments: str) -> None:
    done = subprocess.run(["cc", *FLAGS, *arguments], check=False, capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"a mutant that does not compile:\n{done.stderr}")


class Build:
    """A source tree, mutated or not, and the programs made of it when they are asked for."""

    def __init__(self, work: Path, original: Build | None = None, hunks: list[Hunk] | None = None) -> None:
        self.work, self.original = work, original
        self.native = work / "native"
        self.changed = {file for file, _, _ in hunks or []}
        shutil.copytree(NATIVE, self.native)
        mutate(self.native, hunks or [])

    def object(self, flavour: str, source: Path, native: bool) -> Path:
        """Of an unchanged file the original's object, unless a header that it may include is changed."""
        out = self.work / flavour / f"{source.parent.name}-{source.stem}.o"
        headers = any(file.endswith(".h") for file in self.changed)
        changed = native and str(source.relative_to(self.native)) in self.changed
        if self.original and not headers and not changed:
            source = self.original.native / source.relative_to(self.native) if native else source
            return self.original.object(flavour, source, native)
        if not out.exists():
            out.parent.mkdir(exist_ok=True)
            partial = out.with_suffix(f".{os.getpid()}.{random.getrandbits(32)}")
            include = [f"-I{path}" for path in (self.native, self.native / "include", UNITS)]
            define = [] if flavour == "plain" else ["-DSHMTF_STEPS"]
            cc("-c", *define, *include, str(source), "-o", str(partial))
            partial.rename(out)
        return out

    def program(self, name: str) -> Path:
        out = self.work / name
        if out.exists():
            return out
        core = [*sorted((self.native / "core").glob("*.c")), self.native / "segment" / "layout.c"]
        flavour, own = "steps", []
        if name == "xsim":
            own = sorted(MODEL.glob("*.c"))
        elif name == "history_record":
            own = [HISTORY / f"{part}.c" for part in ("record", "operations", "reads")]
            core = [f for folder in ("core", "segment", "api") for f in sorted((self.native / folder).glob("*.c"))]
        else:
            flavour = "steps" if name.startswith("paused") else "plain"
            own = [UNITS / f"{name}.c"]
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            jobs = [pool.submit(self.object, flavour, f, f not in own) for f in [*core, *own]]
            objects = [job.result() for job in jobs]
        cc(*map(str, objects), "-lm", "-lpthread", "-o", str(out))
        return out


def why_it_fails(*command: str, watchdog_s: float = WATCHDOG_S) -> str | None:
    try:
        done = subprocess.run(command, check=False, capture_output=True, text=True, timeout=watchdog_s)
    except subprocess.TimeoutExpired:
        return "does not end"
    if done.returncode == 0:
        return None
    lines = [line for line in (done.stdout + done.stderr).splitlines() if line.strip()]
    found = [line for line in lines if line.startswith("VIOLATION")]
    return (found or lines[-1:] or [f"exit {done.returncode}"])[0].split("; process")[0]


def replay_program(work: Path) -> Path:
    """The judge is made of the real header, never of a mutant's."""
    out = work / "history_replay"
    if not out.exists():
        include = [f"-I{NATIVE}", f"-I{NATIVE / 'include'}", f"-I{HISTORY}"]
        cc(*include, *(str(HISTORY / f"{part}.c") for part in ("replay", "model", "answers")), "-lm", "-o", str(out))
    return out


def judge_histories(
    build: Build, seed: int, rounds: int = ROUNDS, regimes: tuple[tuple[int, ...], ...] = REGIMES
) -> str | None:
    replay = replay_program((build.original or build).work)
    log, record = build.work / "log", build.program("history_record")
    for n in range(rounds):
        for regime in regimes:
            milliseconds, *rest = map(str, regime)
            store = f"shmtf-mutant-{os.getpid()}-{random.getrandbits(48):x}"
            command = (str(record), store, str(log), str(seed + n), milliseconds, *rest)
            try:
                why = why_it_fails(*command, watchdog_s=RECORDING_WATCHDOG_S) or why_it_fails(str(replay), str(log))
            finally:
                subprocess.run([str(record), "--unlink", store], check=False, timeout=WATCHDOG_S)
                log.unlink(missing_ok=True)
            if why:
                return why
    return None


def ask(checker: str, build: Build, seed: int) -> str | None:
    if checker == "history":
        return judge_histories(build, seed)
    name, *arguments = checker.split()
    return why_it_fails(str(build.program(name)), *(["all", *arguments] if name == "xsim" else []))


@dataclass
class Verdict:
    name: str
    caught: dict[str, str]  # checker: what it said
    seconds: float


def judge(mutant: Mutant, original: Build, every: bool, checkers: list[str], seed: int) -> Verdict:
    began = time.monotonic()
    order = sorted(checkers, key=lambda c: mutant.caught_by.index(c) if c in mutant.caught_by else len(CHECKERS))
    caught = {}
    with tempfile.TemporaryDirectory() as folder:
        build = Build(Path(folder), original, mutant.hunks)
        for checker in order:
            if why := ask(checker, build, seed):
                caught[checker] = why
                if not every:
                    break
    return Verdict(mutant.name, caught, time.monotonic() - began)


def table(verdicts: list[Verdict]) -> None:
    print("\nmutation | caught by\n--- | ---")
    for v in verdicts:
        print(f"{v.name} | {', '.join(v.caught) or 'NOTHING'}")


def arguments(argv: list[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="tools/dev mutants", description=__doc__)
    parser.add_argument("names", nargs="*", help="of mutations; default: all")
    parser.add_argument("--every", action="store_true", help="ask every checker, not only until one catches it")
    parser.add_argument("--checker", action="append", choices=CHECKERS, help="ask only these")
    parser.add_argument("--seed", type=int, default=random.randrange(1 << 20), help="of the histories")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    return parser.parse_args(argv)


def main(argv: list[str]) -> int:
    args = arguments(argv)
    mutants = load()
    checkers = [checker for checker in CHECKERS if not args.checker or checker in args.checker]
    print(f"seed {args.seed}", flush=True)
    with tempfile.TemporaryDirectory() as folder:
        original = Build(Path(folder))
        replay_program(original.work)
        with ThreadPoolExecutor(args.jobs) as pool:
            running = [
                pool.submit(judge, mutants[name], original, args.every, checkers, args.seed)
                for name in args.names or mutants
            ]
            verdicts = []
            for job in running:
                v = job.result()
                verdicts.append(v)
                said = "; ".join(f"{checker}: {why}" for checker, why in v.caught.items())
                print(f"{'caught  ' if v.caught else 'SURVIVED'} [{v.seconds:5.1f} s] {v.name}: {said}", flush=True)
    table(verdicts)
    survivors = sum(not v.caught for v in verdicts)
    print(f"{len(verdicts) - survivors} of {len(verdicts)} caught")
    return survivors != 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
