# SPDX-License-Identifier: Apache-2.0
"""The demonstration as a user starts it; and that it fails when an answer is wrong, and leaves nothing behind."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import subprocess
import sys
import termios
from collections.abc import Callable, Iterator
from pathlib import Path

import psutil
import pytest

import shmtf

DATA = Path(os.environ.get("SHMTF_DATA") or Path(__file__).resolve().parents[2] / ".." / "shared" / "data")
needs_data = pytest.mark.skipif(
    not (DATA / "boreas").is_dir(), reason="the recordings are not here; SHMTF_DATA names their folder"
)

Start = Callable[..., subprocess.Popen[str]]


@pytest.fixture
def start(store_name: str) -> Iterator[Start]:
    """Starts the demonstration on `store_name`."""
    running: list[subprocess.Popen[str]] = []

    def popen(*arguments: str) -> subprocess.Popen[str]:
        words = [sys.executable, "-m", "shmtf.demo", "--plain", "--name", store_name, *arguments]
        running.append(subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd="/"))
        return running[-1]

    yield popen
    for process in running:
        process.kill()
        process.communicate()


def finish(process: subprocess.Popen[str]) -> tuple[int, str, str]:
    out, errors = process.communicate()
    assert "Traceback" not in errors, errors
    return process.returncode, out, errors


def read_until(process: subprocess.Popen[str], pattern: str) -> str:
    assert process.stdout is not None
    for line in process.stdout:
        if re.search(pattern, line):
            return line
    pytest.fail(f"it ended without {pattern!r}: {process.stderr.read() if process.stderr else ''}")


def children(store_name: str) -> list[psutil.Process]:
    found = []
    for process in psutil.process_iter(["cmdline"]):
        words = process.info["cmdline"] or []
        if store_name in words and "--with-parent" in words:
            found.append(process)
    return found


def gone(processes: list[psutil.Process]) -> None:
    """Wait until none of them is left; a watchdog ends a test that waits in vain."""
    psutil.wait_procs(processes)


def right(out: str) -> None:
    """What a summary says if all went well."""
    assert "every answer was checked against the truth: none wrong, none failed" in out
    rows = [m.groups() for m in re.finditer(r"^  (\w+) +(read-only|read-write) +([\d,]+) +(\d+) +(\d+) ", out, re.M)]
    assert {row[1] for row in rows} == {"read-only", "read-write"}
    assert len(rows) == 3
    for _, _, lookups, wrong, errors in rows:
        assert int(lookups.replace(",", "")) > 0
        assert (wrong, errors) == ("0", "0")


def test_simulation(start: Start, store_name: str) -> None:
    code, out, errors = finish(start("--duration", "4"))
    assert (code, errors) == (0, ""), out + errors
    right(out)
    assert f"shmtf-dump {store_name}" in out.split("waiting")[0]
    assert re.search(r"^at 2\.\d s: SIGKILL to camera, SIGSTOP to arm", out, re.M)
    assert re.search(r"^at 2\.\d s: SIGCONT to arm, camera started anew", out, re.M)
    assert store_name not in shmtf.list_stores()
    assert not children(store_name)


@needs_data
def test_recordings(start: Start, store_name: str) -> None:
    code, out, errors = finish(start("--duration", "4", "--speed", "1.5", "--data", str(DATA)))
    assert (code, errors) == (0, ""), out + errors
    right(out)
    assert "SIGKILL to car_lidar, SIGSTOP to person" in out
    assert not children(store_name)


def test_keep(start: Start, store_name: str) -> None:
    code, out, errors = finish(start("--duration", "2", "--planners", "1", "--keep"))
    assert code == 0, out + errors
    assert out.rstrip().endswith(f"shmtf-dump {store_name}")
    with shmtf.Store.attach(store_name, readonly=True) as store:
        assert store.frame_info("tool").is_static
        store.lookup_latest_transform("map", "tool")


def test_a_wrong_answer_is_the_exit_code(start: Start, store_name: str) -> None:
    """Somebody else writes a pose that the robot never had."""
    process = start("--duration", "2")
    read_until(process, r"lookups/s")
    with shmtf.Store.attach(store_name, authority="rogue") as store:
        stamp = store.frame_info("odom").newest
        store.set_transform(shmtf.Transform("map", "odom", (stamp or 0) + 1, (0.0, 0.0, 1e-6)))
    code, out, errors = finish(process)
    assert code == 1
    assert "wrong: " in out
    assert re.search(r"^shmtf\.demo: \w+: [1-9]\d* wrong answers", errors, re.M)


def test_interrupt_leaves_nothing(start: Start, store_name: str) -> None:
    process = start("--duration", "60")
    read_until(process, r"lookups/s")
    cast = children(store_name)
    assert len(cast) == 8
    process.send_signal(signal.SIGINT)
    code, _, errors = finish(process)
    assert (code, errors.strip()) == (130, "interrupted")
    gone(cast)
    assert store_name not in shmtf.list_stores()


def test_a_killed_parent_leaves_nothing(start: Start, store_name: str) -> None:
    """Not even the sensor that is stopped at that moment."""
    process = start("--duration", "10")
    read_until(process, r"SIGSTOP to arm")
    cast = children(store_name)
    assert any(child.status() == psutil.STATUS_STOPPED for child in cast)
    process.kill()
    process.wait()
    gone(cast)
    assert store_name not in shmtf.list_stores()


def test_a_sensor_that_dies_unasked(start: Start, store_name: str) -> None:
    process = start("--duration", "60")
    read_until(process, r"lookups/s")
    cast = children(store_name)
    next(child for child in cast if "odometry" in child.cmdline()).kill()
    code, _, errors = finish(process)
    assert (code, errors.strip()) == (1, "shmtf.demo: odometry ended with SIGKILL")
    gone(cast)


@pytest.mark.parametrize("arguments", [("--duration", "1"), ("--planners", "0"), ("--speed", "0")])
def test_wrong_use(start: Start, arguments: tuple[str, ...]) -> None:
    code, _, errors = finish(start(*arguments))
    assert code == 2
    assert "error:" in errors


def test_no_recordings_there(start: Start, store_name: str, tmp_path: Path) -> None:
    code, _, errors = finish(start("--data", str(tmp_path)))
    assert code == 1
    assert "has none of boreas, robot_arm and cmu_mocap" in errors
    assert store_name not in shmtf.list_stores()


def test_the_store_fits_a_small_machine(start: Start, store_name: str) -> None:
    process = start("--duration", "60", "--planners", "1")
    read_until(process, r"lookups/s")
    assert shmtf.store_info(store_name).size_bytes < 64 << 20


def test_live_table(store_name: str, open_terminal: Callable[[], tuple[int, int]]) -> None:
    """On a terminal: a table that is drawn again in its place; 'q' ends it, and the summary stays."""
    master, slave = open_terminal()
    termios.tcsetwinsize(slave, (50, 100))
    words = [sys.executable, "-m", "shmtf.demo", "--name", store_name, "--duration", "60", "--planners", "1"]
    process = subprocess.Popen(
        words, stdin=slave, stdout=slave, stderr=slave, cwd="/", env={**os.environ, "TERM": "xterm"}, process_group=0
    )
    os.close(slave)
    seen = b""
    try:
        while not re.search(rb"grasp +read-write +[1-9]", seen):
            seen += os.read(master, 65536)
        os.write(master, b"q")
        with contextlib.suppress(OSError):  # how Linux says that the other side is closed
            while chunk := os.read(master, 65536):
                seen += chunk
        assert process.wait() == 0
    finally:
        process.kill()
        process.wait()
        os.close(master)
    page, _, after = seen.rpartition(b"\x1b[?1049l")
    assert page.count(b"SENSORS") > 1
    assert b"none wrong, none failed" in after
    assert store_name not in shmtf.list_stores()
