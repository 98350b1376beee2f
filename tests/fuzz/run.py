# SPDX-License-Identifier: Apache-2.0
"""Corrupted stores by the million: runs the fuzz targets side by side and adds up what they say.

usage: tools/dev fuzz [--runs N] [--seed S] [--seconds T] [--engine plain|libfuzzer] [--target NAME ...]

Inputs are made from a seed and a number, so a failure is repeated with the `--seed S --only I` that it names. A target
that dies is started again behind the input it died of. Exit code 1 if anything died or did not end. Tier: on demand; a
short run is part of the tests.
"""

from __future__ import annotations

import argparse
import concurrent.futures
import json
import os
import re
import subprocess
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

SHARES = {"fuzz_read": 0.5, "fuzz_race": 0.2, "fuzz_write": 0.25, "fuzz_bell": 0.05}
CHUNK = 10_000  # inputs a process
WATCHDOG_S = 900  # for a process; a call has a watchdog of its own


@dataclass
class Tally:
    """What one target did."""

    target: str
    inputs: int = 0
    attached: int = 0
    crashes: int = 0
    hangs: int = 0
    most_steps: int = 0
    most_in: str = ""
    bound: int = 0
    images: int = 0
    disturbed: int = 0
    refused: Counter[str] = field(default_factory=Counter)
    answers: Counter[str] = field(default_factory=Counter)
    reports: list[str] = field(default_factory=list)

    def add(self, line: str) -> None:
        """The last line of a target's output."""
        said = json.loads(line)
        self.inputs += said["inputs"]
        self.attached += said["attached"]
        self.disturbed += said["disturbed"]
        self.refused.update(said["refused"])
        self.answers.update(said["answers"])
        self.bound, self.images = said["bound"], said["images"]
        if said["most_steps"] > self.most_steps:
            self.most_steps, self.most_in = said["most_steps"], said["most_in"]

    def fail(self, text: str, hang: bool) -> None:
        """It died, with these last words."""
        self.hangs += hang
        self.crashes += not hang
        self.reports.append(text[-6000:])


def run_chunk(program: Path, seed: int, first: int, count: int) -> list[tuple[str, str]]:
    """Inputs [first, first + count): ("tally", line) and ("crash" or "hang", last words), one or more."""
    found = []
    end = first + count
    while first < end:
        command = [str(program), "--seed", str(seed), "--from", str(first), "--runs", str(end - first)]
        try:
            done = subprocess.run(
                command, capture_output=True, text=True, errors="replace", timeout=WATCHDOG_S, check=False
            )
        except subprocess.TimeoutExpired as error:
            found.append(("hang", f"{command} did not end\n{error.stderr!r}"))
            break
        if done.returncode == 0:
            found.append(("tally", done.stdout.splitlines()[-1]))
            break
        words = f"exit {done.returncode}\n{done.stderr}"
        found.append(("hang" if "no end:" in words else "crash", words))
        where = re.search(r"--only (\d+)", done.stderr)
        if not where:
            break
        # what came before it was fine, and is told by a run of its own
        if int(where[1]) > first:
            found += run_chunk(program, seed, first, int(where[1]) - first)
        first = int(where[1]) + 1
    return found


def run_plain(args: argparse.Namespace, tallies: dict[str, Tally]) -> None:
    """The drivers that need no engine."""
    deadline = time.monotonic() + args.seconds if args.seconds else None
    share = sum(SHARES[name] for name in tallies)
    left = {name: round(args.runs * SHARES[name] / share) for name in tallies}
    at = dict.fromkeys(tallies, 0)
    with concurrent.futures.ThreadPoolExecutor(args.jobs) as pool:
        running: dict[concurrent.futures.Future[list[tuple[str, str]]], str] = {}
        while True:
            over = deadline is not None and time.monotonic() >= deadline
            while not over and len(running) < args.jobs and any(left.values()):
                name = max(left, key=lambda n: left[n] / SHARES[n])
                count = min(CHUNK, left[name])
                running[pool.submit(run_chunk, args.programs / name, args.seed, at[name], count)] = name
                at[name] += count
                if not deadline:
                    left[name] -= count
                else:  # by time: inputs without end, in the same proportions
                    left[name] -= count / 2**40
            if not running:
                return
            for future in concurrent.futures.wait(running, return_when="FIRST_COMPLETED").done:
                tally = tallies[running.pop(future)]
                for kind, words in future.result():
                    if kind == "tally":
                        tally.add(words)
                    else:
                        tally.fail(words, kind == "hang")


def run_libfuzzer(args: argparse.Namespace, tallies: dict[str, Tally]) -> None:
    """clang's engine, which looks for inputs that reach new code."""
    for name, tally in tallies.items():
        with tempfile.TemporaryDirectory() as corpus:
            limit = [f"-runs={round(args.runs * SHARES[name])}"]
            if args.seconds:
                limit = [f"-max_total_time={max(1, round(args.seconds / len(tallies)))}"]
            command = [str(args.programs / name), f"-seed={args.seed}", *limit, "-max_len=1024", "-timeout=60"]
            command += [f"-artifact_prefix={corpus}/", corpus]
            done = subprocess.run(command, capture_output=True, text=True, errors="replace", check=False)
            lines = [line for line in done.stdout.splitlines() if line.startswith('{"target"')]
            if lines:
                tally.add(lines[-1])
            if done.returncode:
                tally.fail(
                    f"exit {done.returncode}\n{done.stderr}", "timeout" in done.stderr or "no end:" in done.stderr
                )


def print_table(tallies: dict[str, Tally], seed: int, seconds: float) -> None:
    """One row a target, then what the calls answered."""
    print(f"seed {seed}, {seconds:.0f} s, images to begin with: {max(t.images for t in tallies.values())}")
    row = "{:<11} {:>9} {:>9} {:>9} {:>9} {:>8} {:>7} {:>12} {:>12}  {}"
    heads = ("attached", "VERSION", "CORRUPT", "crashes", "hangs", "most steps", "bound")
    print(row.format("target", "inputs", *heads, "in"))
    for t in tallies.values():
        numbers = (
            t.inputs,
            t.attached,
            t.refused["VERSION"],
            t.refused["CORRUPT"],
            t.crashes,
            t.hangs,
            t.most_steps,
            t.bound,
        )
        print(row.format(t.target, *numbers, t.most_in))
    statuses = sorted(
        {s for t in tallies.values() for s in t.answers}, key=lambda s: -sum(t.answers[s] for t in tallies.values())
    )
    print("\n{:<18}".format("answers") + "".join(f"{name:>12}" for name in tallies))
    for status in statuses:
        print(f"{status:<18}" + "".join(f"{t.answers[status]:>12}" for t in tallies.values()))
    print(f"{'words changed':<18}" + "".join(f"{t.disturbed:>12}" for t in tallies.values()) + "  (during calls)")


def main() -> int:
    parser = argparse.ArgumentParser(prog="tools/dev fuzz")
    parser.add_argument("--programs", type=Path, required=True, help="where the targets are")
    parser.add_argument("--runs", type=int, default=1_000_000, help="inputs over all targets")
    parser.add_argument("--seconds", type=float, help="run for this long instead")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--engine", choices=("plain", "libfuzzer"), default="plain")
    parser.add_argument("--target", action="append", choices=sorted(SHARES))
    parser.add_argument("--jobs", type=int, default=len(os.sched_getaffinity(0)))
    args = parser.parse_args()
    tallies = {name: Tally(name) for name in SHARES if not args.target or name in args.target}
    began = time.monotonic()
    (run_plain if args.engine == "plain" else run_libfuzzer)(args, tallies)
    print_table(tallies, args.seed, time.monotonic() - began)
    for tally in tallies.values():
        for report in tally.reports[:5]:
            print(f"\n---- {tally.target}\n{report}", file=sys.stderr)
    wrong = any(t.crashes or t.hangs or not t.inputs for t in tallies.values())
    print("FAILED" if wrong else "no crash, no hang, no access outside of a store")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
