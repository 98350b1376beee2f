# SPDX-License-Identifier: Apache-2.0
"""`shmtf check`: exit code 0 fine, 1 dead writers' flags, 2 corrupt or not to be looked at."""

from __future__ import annotations

import json
import os
import signal
import struct
import subprocess
from collections.abc import Callable

import shmtf

from .conftest import Holder, script, until_version

Run = Callable[..., subprocess.CompletedProcess[str]]


def test_fine_while_written(command: Run, live: shmtf.Store) -> None:
    assert "every word is possible" in command("shmtf", "check", live.name).stdout
    assert json.loads(command("shmtf", "check", live.name, "--json").stdout)["corrupt"] is False


def test_a_stopped_writer_is_fine(command: Run, holder: Holder) -> None:
    out = command("shmtf", "check", holder.store.name).stdout
    assert f'of which stopped: "big batch" (process {holder.process.pid})' in out
    command("shmtf", "check", holder.store.name, "--repair")  # finishes what is decided, and robs it of nothing
    holder.process.send_signal(signal.SIGCONT)
    until_version(holder.store, holder.store.version + 5, holder.process)


def test_dead_flags_and_their_repair(command: Run, holder: Holder) -> None:
    before = {name: holder.store.frame_info(name) for name in holder.store.frames()}
    holder.kill()
    report = json.loads(command("shmtf", "check", holder.store.name, "--json", code=1).stdout)
    assert report["locks_dead"] == report["locks_held"] > 0
    assert "flag of a dead writer" in command("shmtf", "check", holder.store.name, code=1).stdout
    assert f"{report['locks_dead']} writer flags" in command("shmtf", "check", holder.store.name, "--repair").stdout
    command("shmtf", "check", holder.store.name)
    assert holder.store._check()["locks_held"] == 0
    for name, info in before.items():  # finished or undone, never half
        assert holder.store.frame_info(name).version == info.version
    holder.store.set_transform(shmtf.Transform("map", "part0"))


def test_a_copy_that_differs(command: Run, store: shmtf.Store) -> None:
    """The newest record stands twice; whoever reads it beside the lock and in the ring must read the same."""
    x = 1234.5
    store.set_transform(shmtf.Transform("map", "base", 1, translation=(x, 0, 0)))
    with open(f"/dev/shm/{store.name}", "r+b") as file:
        at = file.read().index(struct.pack("<d", x))  # frames stand before the arena
        file.seek(at)
        file.write(struct.pack("<d", x + 1))
    assert "copy of the newest record of frame" in command("shmtf", "check", store.name, code=2).stdout


def test_corrupt(command: Run, store: shmtf.Store) -> None:
    store.set_transform(shmtf.Transform("map", "base"))
    with open(f"/dev/shm/{store.name}", "r+b") as file:  # all but the header page
        file.seek(4096)
        file.write(b"\xa5" * 65536)
    done = command("shmtf", "check", store.name, code=2)
    assert "corrupt" in done.stdout
    command("shmtf", "check", store.name, "--repair", code=2)
    for words in (["shmtf-dump"], ["shmtf", "check"]):  # whatever it says, it does not crash
        run = subprocess.run(
            [script(words[0]), *words[1:], store.name], check=False, capture_output=True, text=True, cwd="/"
        )
        assert run.returncode in (0, 1, 2)
        assert "Traceback" not in run.stderr


def test_no_store_and_not_a_store(command: Run, new_name: Callable[[], str]) -> None:
    assert "there is no store" in command("shmtf", "check", new_name(), code=2).stderr
    name = new_name()
    with open(f"/dev/shm/{name}", "wb") as file:
        file.write(os.urandom(8192))
    done = command("shmtf", "check", name, code=2)
    assert len(done.stderr.splitlines()) == 1
