# SPDX-License-Identifier: Apache-2.0
"""The long run: many processes on one store, killed, stopped and started again, while every answer is checked.

    tools/dev soak --minutes N [--seed S]

Tier: on demand; fifteen seconds of it are in the test suite.  Ends with a report, and with exit code 1 if a promise was
broken.  Ctrl-C ends it at once, with the report so far.
"""

from __future__ import annotations

import argparse
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path

from board import LUCK, OPS, Board
from epilogue import Stores
from report import Chaos, text

HERE = Path(__file__).resolve().parent
STUCK_S = 120  # a member that runs and has got nothing done for so long, hangs
LONG_S = 60  # of a shorter run nothing can be said about memory
C_SLACK_KIB, PYTHON_SLACK_KIB = 128, 8192  # a dump of all frames is some megabytes for as long as it takes
C_ROLES = [
    "singles", "singles", "batches", "batches", "big", "shape", "shape", "clears",
    "reader", "readonly", "second-reader", "waiter", "readonly-waiter",
]  # fmt: skip
PYTHON_ROLES = ["py-writer", "py-reader", "py-waiter", "beside", "beside-reader"]
LASTING = ["reader", "readonly", "py-reader"]  # never killed: their memory must not grow
WRITERS = {"singles", "batches", "big", "shape", "clears"}


@dataclass
class Member:
    """One place in the crew, and the process that fills it now."""

    number: int
    role: str
    lasting: bool
    process: subprocess.Popen[bytes] | None = None
    stopped_until: float | None = None
    done: int = 0
    done_at: float = field(default_factory=time.monotonic)
    memory: int | None = None

    @property
    def is_python(self) -> bool:
        return self.role in PYTHON_ROLES


class Run:
    """Crew, chaos and watch."""

    def __init__(self, programs: Path, seed: int, directory: str) -> None:
        roles = [(r, False) for r in C_ROLES + PYTHON_ROLES] + [(r, True) for r in LASTING]
        self.members = [Member(i, role, lasting) for i, (role, lasting) in enumerate(roles)]
        self.board = Board(os.path.join(directory, "board"), len(roles) + 1)
        self.program = programs / "soak_member"
        self.random = random.Random(seed)
        self.seed, self.births = seed, 0
        self.chaos = Chaos()
        self.interrupted = False
        self.stores = Stores(f"shmtf-soak-{os.getpid()}")

    def command(self, role: str, number: int) -> list[str]:
        self.births += 1
        arguments = [role, *self.stores.names, self.board.path, str(number), str(self.seed * 1000003 + self.births)]
        if role in PYTHON_ROLES:
            return [sys.executable, str(HERE / "crew.py"), *arguments]
        return [str(self.program), *arguments]

    def start(self, member: Member) -> None:
        member.process = subprocess.Popen(self.command(member.role, member.number), start_new_session=True)
        member.stopped_until = None
        member.done_at = time.monotonic()

    def problem(self, what: str) -> None:
        self.chaos.problems.append(what)

    # ---- chaos ----

    def kill(self, member: Member) -> None:
        assert member.process
        if member.process.poll() is not None:
            return  # by itself: look() says so
        self.board.cells[member.number].will_stop()
        self.chaos.killed_while_stopped += member.stopped_until is not None
        self.chaos.kills += 1
        member.process.kill()
        if member.process.wait() != -signal.SIGKILL:
            self.problem(f"{member.role} ended with {member.process.returncode} before it was killed")
        self.start(member)

    def stop(self, member: Member, seconds: float) -> None:
        assert member.process
        if member.stopped_until is not None or member.process.poll() is not None:
            return
        self.board.cells[member.number].will_stop()
        member.process.send_signal(signal.SIGSTOP)
        member.stopped_until = time.monotonic() + seconds
        self.chaos.stops += 1

    def wake(self, everybody: bool = False) -> None:
        now = time.monotonic()
        for member in self.members:
            if member.stopped_until is not None and (everybody or member.stopped_until <= now):
                assert member.process
                member.process.send_signal(signal.SIGCONT)
                member.stopped_until = None
                member.done_at = now

    def disturb(self) -> None:
        """Something happens to somebody."""
        what = self.random.random()
        mortal = [m for m in self.members if not m.lasting]
        quick = [m for m in mortal if not m.is_python]
        if what < 0.001:
            self.chaos.bursts += 1
            for member in self.random.sample(quick, 2 * len(quick) // 3):
                self.kill(member)
        elif what < 0.002:
            self.chaos.bursts += 1
            for member in self.random.sample(self.members, len(self.members) // 2):
                self.stop(member, self.random.uniform(0.01, 0.3))
        elif what < 0.006:
            self.kill(self.random.choice([m for m in mortal if m.is_python]))
        elif what < 0.7:
            self.kill(self.random.choice(quick))
        else:
            long = self.random.random() < 0.02
            seconds = self.random.uniform(0.5, 2) if long else self.random.uniform(0, 0.1)
            self.stop(self.random.choice(self.members), seconds)

    # ---- watch ----

    def look(self) -> None:
        """Is anybody's promise broken, anybody gone by himself, anybody stuck?"""
        now = time.monotonic()
        for member in self.members:
            cell, process = self.board.cells[member.number], member.process
            assert process
            if (said := cell.violation) is not None:
                self.problem(f"{member.role} (pid {process.pid}): {said}")
            elif process.poll() is not None:
                self.problem(f"{member.role} (pid {process.pid}) ended by itself with {process.returncode}")
            done = sum(cell.ops)
            if done != member.done or member.stopped_until is not None:
                member.done, member.done_at = done, now
            elif now - member.done_at > STUCK_S:
                self.problem(f"{member.role} (pid {process.pid}) has got nothing done for {STUCK_S} s")

    def note_memory(self, last: bool) -> None:
        for member in self.members:
            if not member.lasting or not member.process:
                continue
            kib = anonymous_kib(member.process.pid)
            if member.memory is None or not last:
                member.memory = kib
                continue
            self.chaos.memory.append(f"{member.role}: {member.memory} KiB early, {kib} KiB late")
            if kib > member.memory + (PYTHON_SLACK_KIB if member.is_python else C_SLACK_KIB):
                self.problem(f"the memory of {member.role} grew from {member.memory} to {kib} KiB")

    # ---- the whole ----

    def build(self) -> None:
        self.stores.create()
        subprocess.run(self.command("build", len(self.members)), check=True, timeout=60)
        for member in self.members:
            self.start(member)

    def until(self, end: float, begun: float) -> None:
        early = begun + (end - begun) / 5 if end - begun >= LONG_S else 0.0
        next_look = begun
        while (now := time.monotonic()) < end and not self.chaos.problems and not self.interrupted:
            time.sleep(self.random.random() / 100)
            self.wake()
            for _ in range(self.random.randrange(1, 5)):
                self.disturb()
            if now >= next_look:
                self.look()
                self.chaos.problems += self.stores.files_problems()
                next_look = now + 1
            if early and now >= early:
                self.note_memory(False)
                early = 0.0
        if any(m.memory is not None for m in self.members) and not self.chaos.problems:
            self.wake(everybody=True)
            self.note_memory(True)

    def finish(self) -> None:
        """The writers die where they stand; the others see that it is over."""
        for member in self.members:
            if member.role in WRITERS and member.process and member.process.poll() is None:
                member.process.kill()
                self.chaos.kills += 1
        self.board.end()
        self.wake(everybody=True)
        for member in self.members:
            if not member.process:
                continue
            try:
                code = member.process.wait(timeout=STUCK_S)
            except subprocess.TimeoutExpired:
                self.problem(f"{member.role} (pid {member.process.pid}) does not end")
                member.process.kill()
                member.process.wait()
                continue
            said = self.board.cells[member.number].violation
            if said and any(said in problem for problem in self.chaos.problems):
                continue
            if code and not (member.role in WRITERS and code == -signal.SIGKILL):
                self.problem(f"{member.role} ended with {code}: {said}")

    def epilogue(self) -> None:
        silent = [OPS[i] for i, n in enumerate(self.totals()) if not n and i not in LUCK]
        if silent and self.chaos.seconds > 10:
            self.problem(f"nobody did: {', '.join(silent)}")
        if not self.chaos.problems:
            found, problems = self.stores.take_stock()
            self.chaos.left += found
            self.chaos.problems += problems

    def totals(self) -> list[int]:
        return [sum(column) for column in zip(*(cell.ops for cell in self.board.cells), strict=True)]

    def clean_up(self) -> None:
        for member in self.members:
            if member.process and member.process.poll() is None:
                member.process.kill()
                member.process.wait()
        self.stores.close()
        lives = Path(self.board.path + ".lives")
        uuids = set(lives.read_text().split()) if lives.exists() else set()
        self.chaos.lives_beside = len(uuids)
        left = self.stores.unlink(uuids)
        if left:
            self.problem(f"left in /dev/shm: {', '.join(left)}")
        else:
            self.chaos.left.append("nothing left in /dev/shm")


def anonymous_kib(pid: int) -> int:
    for line in Path(f"/proc/{pid}/status").read_text().splitlines():
        if line.startswith("RssAnon:"):
            return int(line.split()[1])
    return 0


def run(programs: Path, seconds: float, seed: int) -> int:
    with tempfile.TemporaryDirectory() as directory:
        it = Run(programs, seed, directory)
        begun = time.monotonic()

        def interrupt(*_: object) -> None:  # not an exception: that would lose who was just being killed or started
            it.interrupted = True

        signal.signal(signal.SIGINT, interrupt)
        try:
            it.build()
            print(f"{len(it.members)} processes are at work; Ctrl-C ends the run", flush=True)
            it.until(begun + seconds, begun)
            it.chaos.seconds = time.monotonic() - begun
            it.finish()
            it.epilogue()
        finally:
            it.clean_up()
        print(text(it.board, it.chaos, seed, len(it.members)), flush=True)
        return 1 if it.chaos.problems else 0


def main() -> int:
    root = HERE.parent.parent
    native = Path(os.environ.get("SHMTF_NATIVE_BUILD") or root / "build" / "native")
    parser = argparse.ArgumentParser(prog="tools/dev soak", description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--seed", type=int, default=None, help="of the chaos and of what members choose (default: new)")
    parser.add_argument("--programs", type=Path, default=native / "programs", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    seed = int.from_bytes(os.urandom(3), "little") if arguments.seed is None else arguments.seed
    print(f"soak: {arguments.minutes:g} minutes, seed {seed}", flush=True)
    return run(arguments.programs, 60 * arguments.minutes, seed)


if __name__ == "__main__":
    sys.exit(main())
