# SPDX-License-Identifier: Apache-2.0
"""Many processes at once: nobody sees a mixture, fails or is starved; priority comes first; no wake-up is lost.

Tier: test.  The programs of tests/soak print what they measured; nothing here asserts a time.  By hand, with larger
numbers: build/native/programs/NAME STORE ..., then shmtf rm STORE.
"""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from itertools import count
from pathlib import Path

import pytest

import shmtf

SECONDS = float(os.environ.get("SHMTF_STRESS_SECONDS", "3"))
SOAK = Path(__file__).resolve().parents[1] / "soak" / "soak.py"
WATCHDOG_S = 240
IDENTITY = (0.0, 0.0, 0.0, 1.0)
Run = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture
def crowd(run: Run, store_name: str) -> Callable[..., str]:
    """Runs a program of a crowd to its good end, and returns what it printed."""

    def start(name: str, *args: object) -> str:
        done = run(name, store_name, *args)
        assert done.returncode == 0, done.stdout + done.stderr
        print(done.stdout)
        return done.stdout

    return start


@pytest.mark.parametrize(("processes", "updates"), [(2, 4000), (8, 1000), (32, 200)])
def test_readers_see_no_mixture(processes: int, updates: int, crowd: Callable[..., str]) -> None:
    """Half of them write 16 frames with one stamp per update, the other half read the chain of these frames."""
    crowd("mixture", processes, updates)


# ---- progress ----


@pytest.mark.parametrize(("writers", "readers"), [(8, 0), (4, 4)])
def test_nobody_is_starved(writers: int, readers: int, crowd: Callable[..., str]) -> None:
    """16 of 100 frames a write, from both directions: it ends when everybody got through 3,000 times."""
    crowd("fairness", writers, readers, 3000)


@pytest.mark.parametrize(("frames", "commits"), [(64, 500), (1000, 50)])
def test_large_writes_are_not_starved(frames: int, commits: int, crowd: Callable[..., str]) -> None:
    """Four writers of single frames write into what the large write wants, without a pause."""
    crowd("giants", frames, 4, commits)


def test_long_reads_finish(crowd: Callable[..., str]) -> None:
    """10,000 edges of one commit beside three saturating writers: every lookup answers, with nothing half-done."""
    crowd("longread", 10000, 3, 200)


# ---- priority ----


def test_priority_lets_fewer_pass(crowd: Callable[..., str]) -> None:
    """Commits of others between the call and its commit: with priority less than half as many."""
    said = crowd("priority", 4, 300)
    ordinary, first = (float(n) for n in re.findall(r"others: (\S+) commits of others before each", said))
    assert 2 * first < ordinary


@pytest.mark.parametrize("attempts", [2, 9])
def test_priority_comes_first(attempts: int, crowd: Callable[..., str]) -> None:
    """Two wait for a frame, the second with priority: it commits first, whether the other is in its polite phase (2) or
    waits for the lock itself (9).  Without priority it is every second; a few are left to the scheduler."""
    said = crowd("queue", 60, attempts, 1)
    assert int(said.split()[0]) >= 48, said


@pytest.mark.parametrize("priority", [0, 1])
def test_a_dead_wish_holds_up_nobody(priority: int, crowd: Callable[..., str]) -> None:
    """Who waits is killed: the others get through, and the wish is gone in the end."""
    crowd("queue", 25, 2, priority, "dead")


# ---- waits ----


def test_ping_pong(crowd: Callable[..., str]) -> None:
    """40,000 wake-ups between two processes; a third that waits for the same frames is killed a hundred times."""
    crowd("pingpong", 20000, 200)


def asleep(*command: object) -> subprocess.Popen[str]:
    """A process that has said that it waits, and sleeps."""
    process = subprocess.Popen([*map(str, command)], stdout=subprocess.PIPE, text=True)
    assert process.stdout
    assert process.stdout.readline() == "waiting\n"
    while Path(f"/proc/{process.pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "S":
        pass
    return process


def test_a_writer_killed_between_its_commit_and_the_wake(
    run: Run, program: Callable[[str], Path], store: shmtf.Store
) -> None:
    """At every access after the commit: the waiter sees it all the same, since it looks by itself now and then."""
    store.set_transform(shmtf.Transform("root", "a", 1))
    for k in count():
        before = store.version
        waiter = asleep(program("await"), store.name, "a", before)
        done = run("waker", store.name, "a", k + 2, k)
        out, _ = waiter.communicate(timeout=WATCHDOG_S)
        assert int(out) == before + 1, k
        if done.returncode == 0:
            break
        assert done.returncode == -signal.SIGKILL, done.stderr
    assert k > 10


# ---- the long run, shortly ----


def soak(program: Callable[[str], Path], minutes: float) -> list[str]:
    programs = program("soak_member").parent
    return [sys.executable, str(SOAK), "--minutes", str(minutes), "--programs", str(programs)]


@pytest.mark.stress
def test_the_long_run(program: Callable[[str], Path]) -> None:
    """Writers, readers and waiters of all kinds, killed and stopped at random: tools/dev soak."""
    command = soak(program, 4 * SECONDS / 60)
    done = subprocess.run(command, check=False, capture_output=True, text=True, timeout=WATCHDOG_S)
    assert done.returncode == 0, done.stdout + done.stderr
    print(done.stdout)


@pytest.fixture
def running(program: Callable[[str], Path]) -> Iterator[subprocess.Popen[str]]:
    """A long run whose crew is at work."""
    process = subprocess.Popen(soak(program, 10), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        assert process.stdout
        for line in process.stdout:
            if "at work" in line:
                break
        yield process
    finally:
        process.kill()
        process.communicate()
        for name in (f"shmtf-soak-{process.pid}{end}" for end in ("", "-second", "-beside")):
            if os.path.exists(f"/dev/shm/{name}"):
                shmtf.Store.unlink(name)


def test_ctrl_c_ends_the_long_run_with_a_report(running: subprocess.Popen[str]) -> None:
    running.send_signal(signal.SIGINT)
    out, err = running.communicate(timeout=WATCHDOG_S)
    assert running.returncode == 0, out + err
    assert "operations" in out
    assert out.endswith("no violation\n")


def test_the_long_run_sees_a_wrong_value(running: subprocess.Popen[str]) -> None:
    """Somebody else writes what no member would: the run ends at once, and says what was seen."""
    with shmtf.Store.attach(f"shmtf-soak-{running.pid}") as store:
        store.set_transform(shmtf.Transform("root", "g0", 1 << 40, (1, 2, 3), IDENTITY), timeout=60.0)
    out, err = running.communicate(timeout=WATCHDOG_S)
    assert running.returncode == 1, out + err
    assert "VIOLATION" in out
    assert re.search(r"\d+ violations, seed \d+\n$", out)
