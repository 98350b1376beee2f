# SPDX-License-Identifier: Apache-2.0
"""Record a history, judge it, and again, for as long as asked: tools/dev history --minutes N --seed S.

Tier: on demand. Ends at the first history that is not strictly serialisable, and keeps it. Every tenth one is short
and is judged by the exhaustive search as well.
"""

from __future__ import annotations

import argparse
import os
import random
import re
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import log
import tree
from linear import first_impossible

WATCHDOG_S = 300
# milliseconds, writers, readers, kills per second, chaos, KiB per process
LONG = ((5000, 3, 3, 50, 0, 1 << 16), (5000, 4, 2, 100, 16, 1 << 16), (5000, 8, 8, 100, 2, 1 << 16))
SHORT = (250, 3, 2, 10, 16, 128)
COUNTED = re.compile(r"(\d+) (operations|commits|judged|writes gave way|snapshots expired)")


def run(*command: str) -> str:
    """What a program said; ends everything if it found something."""
    done = subprocess.run(command, check=False, capture_output=True, text=True, timeout=WATCHDOG_S)
    if done.returncode:
        raise SystemExit(f"{' '.join(command)}\n{done.stdout}{done.stderr}exit {done.returncode}")
    return done.stdout


def one_round(programs: Path, path: Path, seed: int, regime: tuple[int, ...], total: Counter[str]) -> None:
    record, replay = programs / "history_record", programs / "history_replay"
    store = f"shmtf-history-{os.getpid()}"
    try:
        said = run(str(record), store, str(path), str(seed), *map(str, regime))
    finally:
        subprocess.run([str(record), "--unlink", store], check=False, timeout=WATCHDOG_S)
    total["kills"] += int(re.search(r"(\d+) kills", said)[1])  # type: ignore[index]
    said = run(str(replay), str(path))
    for number, what in COUNTED.findall(said):
        total[what] += int(number)
    if regime is SHORT:
        impossible = first_impossible(tree.operations(log.read(path)), tree.NOTHING)
        if impossible:
            raise SystemExit(f"no serial order: {impossible.name}")
        total["searched exhaustively"] += 1


def main() -> None:
    parser = argparse.ArgumentParser(prog="tools/dev history", description=__doc__)
    parser.add_argument("--minutes", type=float, default=1.0)
    parser.add_argument("--seed", type=int, default=random.randrange(1 << 20))
    parser.add_argument("--programs", type=Path, required=True, help=argparse.SUPPRESS)
    args = parser.parse_args()
    total: Counter[str] = Counter()
    began = time.monotonic()
    path = Path(tempfile.mkdtemp(prefix="shmtf-history-")) / "log"
    print(f"seed {args.seed}; the history at hand is in {path}", flush=True)
    while time.monotonic() - began < 60 * args.minutes:
        n = total["histories"]
        one_round(args.programs, path, args.seed + n, SHORT if n % 10 == 9 else LONG[n % len(LONG)], total)
        total["histories"] += 1
        if n % 10 == 9:
            print(f"[{time.monotonic() - began:5.0f} s] {total['operations']} operations, no violation", flush=True)
    path.unlink()
    path.parent.rmdir()
    print(", ".join(f"{n} {what}" for what, n in total.items()) + "; no violation")


if __name__ == "__main__":
    sys.exit(main())
