# SPDX-License-Identifier: Apache-2.0
"""`shmtf-dump` of a store that is being written."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
from collections.abc import Callable
from typing import Any

import pytest

import shmtf

from .conftest import Holder, script

Run = Callable[..., subprocess.CompletedProcess[str]]
FRAMES = {"map", "odom", "base", "laser", "rig", *(f"arm{i}" for i in range(1, 7))}
PARENTS = {
    "odom": "map", "base": "odom", "laser": "base", "rig": "base", "arm1": "base",
    **{f"arm{i + 1}": f"arm{i}" for i in range(1, 6)},
}  # fmt: skip


def dumped(command: Run, *words: str) -> Any:
    return json.loads(command("shmtf-dump", *words, "--json").stdout)


# ---- json ----


def test_json_is_complete(command: Run, live: shmtf.Store) -> None:
    before = live.version
    data = dumped(command, live.name)
    assert data["name"] == live.name
    assert before <= data["commits"] <= live.version
    assert data["store"]["max_frames"] == 64
    assert data["store"]["cache_time"] == 10.0
    assert data["store"]["size_bytes"] == os.stat(f"/dev/shm/{live.name}").st_size
    assert data["unread"] == []
    frames = {frame["name"]: frame for frame in data["frames"]}
    assert {name: frame["parent"] for name, frame in frames.items() if frame["parent"]} == PARENTS
    assert set(frames) == FRAMES
    kinds = {name: frame["kind"] for name, frame in frames.items()}
    assert [name for name, kind in kinds.items() if kind == "root"] == ["map"]
    assert {name for name, kind in kinds.items() if kind == "static"} == {"laser", "rig"}
    for name, frame in frames.items():
        info = live.frame_info(name)
        assert frame["capacity"] == info.capacity
        assert frame["generation"] == info.generation
        assert frame["authority"] == info.authority
        assert frame["n_written"] <= info.n_written
        if frame["kind"] == "dynamic":
            assert frame["oldest"] <= frame["newest"] <= info.newest
            assert frame["translation"][2] == 0.5
            assert frame["rotation"] == [0, 0, 0, 1]
    assert frames["laser"] == {**frames["laser"], "newest": None, "rate": None, "age": None, "n_records": 1}


def test_json_of_a_store_at_rest_is_exact(command: Run, store: shmtf.Store) -> None:
    q = (0.1, -0.2, 0.3, 0.4)
    norm = sum(v * v for v in q) ** 0.5
    q = tuple(v / norm for v in q)
    for k in range(5):
        store.set_transform(shmtf.Transform("map", "base", 10**18 + k, (1 / 3, k, -1e-9), q))
    data = dumped(command, store.name, "--records", "3")
    frame = next(f for f in data["frames"] if f["name"] == "base")
    T = store.lookup_latest_transform("map", "base")
    assert frame["translation"] == list(T.translation)
    assert frame["rotation"] == pytest.approx(T.rotation, abs=1e-15)
    assert [r["stamp"] for r in frame["records"]] == [10**18 + 4, 10**18 + 3, 10**18 + 2]
    assert [r["translation"][1] for r in frame["records"]] == [4, 3, 2]
    assert [r["version"] for r in frame["records"]] == [5, 4, 3]
    assert (frame["oldest"], frame["newest"]) == (10**18, 10**18 + 4)
    assert (data["one_commit"], data["commits"]) == (True, 5)
    assert json.loads(json.dumps(data)) == data


def test_a_busy_store_never_fails(command: Run, live: shmtf.Store) -> None:
    commits = 0
    for form in ("--json", "--tree", "--yaml", "--dot", "--records=200") * 4:
        out = command("shmtf-dump", live.name, form).stdout
        assert "arm6" in out
        if form == "--json":
            commits, last = json.loads(out)["commits"], commits
            assert commits > last


def test_json_of_one_commit_does_not_mix(command: Run, live: shmtf.Store) -> None:
    together = ("base", "arm1", "arm2", "arm3", "arm4", "arm5", "arm6")  # written in one commit each time
    for _ in range(5):
        data = dumped(command, live.name)
        if data["one_commit"]:
            assert len({f["version"] for f in data["frames"] if f["name"] in together}) == 1
            assert len({f["translation"][0] for f in data["frames"] if f["name"] in together}) == 1


# ---- text ----


def test_tree(command: Run, live: shmtf.Store) -> None:
    lines = command("shmtf-dump", live.name).stdout.splitlines()
    assert lines[0].startswith(f'store "{live.name}"')
    assert "11 of 64 frames" in lines[0]
    assert "writers: 1 alive" in lines[0]
    at = {name: i for i, line in enumerate(lines) for name in FRAMES if re.search(rf"(^|─ ){name} ", line)}
    assert set(at) == FRAMES
    for child, parent in PARENTS.items():
        assert at[parent] < at[child]
        assert lines[at[parent]].index(parent) < lines[at[child]].index(child)
    assert re.search(r"base +dynamic +\d+(\.\d)? Hz +[\d.]+ \w+ +\d+/\d+ +odometry$", lines[at["base"]])
    assert re.search(r"laser +static +mounts$", lines[at["laser"]])
    assert re.search(r"map +root$", lines[at["map"]])
    assert not any("\x1b" in line for line in lines)  # no styles in files and pipes
    assert re.search(r"^odometry +0 +\d+ +alive", lines[-1])


def test_yaml(command: Run, live: shmtf.Store) -> None:
    out = command("shmtf-dump", live.name, "--yaml").stdout
    assert {m[1]: m[2] for m in re.finditer(r'^"(\w+)":\n  parent: "(\w+)"$', out, re.M)} == PARENTS
    assert (
        len(re.findall(r"^  (?:broadcaster|rate|most_recent_transform|oldest_transform|buffer_length): ", out, re.M))
        == 50
    )
    yaml = pytest.importorskip("yaml", reason="PyYAML is not installed; the structure was checked")
    assert yaml.safe_load(out)["base"]["broadcaster"] == "odometry"


def test_dot(command: Run, live: shmtf.Store) -> None:
    out = command("shmtf-dump", live.name, "--dot").stdout
    assert out.startswith("digraph G {\n") and out.endswith("}\n")
    assert {m[2]: m[1] for m in re.finditer(r'^"(\w+)" -> "(\w+)"\[label="Broadcaster: \w+\\n', out, re.M)} == PARENTS


def test_records(command: Run, live: shmtf.Store) -> None:
    out = command("shmtf-dump", live.name, "--records", "3").stdout
    blocks = {block.split()[0]: block.splitlines()[2:] for block in out.split("\n\n")[1:]}
    assert set(blocks) == FRAMES - {"map"}
    assert {name: len(lines) for name, lines in blocks.items()} == {
        n: 1 if n in ("laser", "rig") else 3 for n in blocks
    }
    stamps = [float(line.split()[0]) for line in blocks["base"]]
    assert stamps == sorted(stamps, reverse=True)
    one = command("shmtf-dump", live.name, "--records", "2", "--frame", "arm3").stdout
    assert "arm3 in arm2" in one and "arm4" not in one


def test_names_that_are_no_words(command: Run, store: shmtf.Store) -> None:
    evil = 'a\x1b[31m"\\\n\t: {b}'
    store.set_transform(shmtf.Transform("ロボット", evil))
    for form in ("--tree", "--yaml", "--records=1"):
        assert "\x1b" not in command("shmtf-dump", store.name, form).stdout
    assert {f["name"] for f in dumped(command, store.name)["frames"]} == {"ロボット", evil}
    assert "\x1b" not in command("shmtf-dump", store.name, "--frame", evil).stdout


def test_an_empty_store(command: Run, store: shmtf.Store) -> None:
    assert "no frames yet" in command("shmtf-dump", store.name).stdout
    assert dumped(command, store.name)["frames"] == []
    assert command("shmtf-dump", store.name, "--yaml").stdout.strip() == "{}"


# ---- one frame ----


def test_frame(command: Run, live: shmtf.Store) -> None:
    out = command("shmtf-dump", live.name, "--frame", "laser").stdout
    fields = dict(m.groups() for m in re.finditer(r"^(\w[\w ]*?) {2,}(.+)$", out, re.M))
    assert fields["parent"] == "base"
    assert fields["kind"] == "static"
    assert fields["writer flag"].startswith("free")
    assert fields["newest tag"].split()[:2] == ["commit", str(live.frame_info("laser").version)]
    assert re.match(r"commit [\d,]+ is the store's last +0x", fields["commit word"])
    assert fields["head"].startswith("1 records ever written")
    assert fields["generation"].startswith("1 ")
    assert fields["ring capacity"].startswith("2 records")


def test_frame_that_does_not_exist(command: Run, live: shmtf.Store) -> None:
    done = command("shmtf-dump", live.name, "--frame", "arm7", code=1)
    assert 'frame "arm7" does not exist' in done.stderr
    assert len(done.stderr.splitlines()) == 1


def test_a_stopped_and_then_a_dead_holder(command: Run, holder: Holder) -> None:
    frame = holder.held_frame()
    pid = holder.process.pid

    def flag() -> str:
        out = command("shmtf-dump", holder.store.name, "--frame", frame).stdout
        return next(line for line in out.splitlines() if line.startswith("writer flag"))

    def data() -> Any:
        return dumped(command, holder.store.name, "--frame", frame)["frames"][0]["flag"]

    assert f'held by "big batch" (slot 0, process {pid}, alive, stopped), transaction ' in flag()
    expected = {"slot": 0, "name": "big batch", "pid": pid, "alive": True, "process": "stopped"}
    assert data() == {**expected, "transaction": data()["transaction"]}
    tree = command("shmtf-dump", holder.store.name).stdout
    assert f'held by "big batch" (slot 0, process {pid}, alive, stopped)' in tree
    holder.kill()
    assert f'held by "big batch" (slot 0, process {pid}, dead), transaction ' in flag()
    assert data()["alive"] is False
    assert "writers: 0 alive, 1 dead" in command("shmtf-dump", holder.store.name).stdout


# ---- which store ----


def test_store_from_the_environment(command: Run, live: shmtf.Store) -> None:
    assert "arm6" in command("shmtf-dump", env={"SHMTF_STORE": live.name}).stdout


# ---- watching ----


def watch(*words: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [script("shmtf-dump"), *words, "--watch", "--interval", "0.05"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd="/",
    )


def test_watch_json_lines(live: shmtf.Store) -> None:
    process = watch(live.name, "--json")
    assert process.stdout is not None
    pages = [json.loads(process.stdout.readline()) for _ in range(3)]
    assert pages[0]["commits"] < pages[1]["commits"] < pages[2]["commits"]
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate()
    assert (process.returncode, errors) == (0, "")


def test_it_maps_read_only(live: shmtf.Store) -> None:
    process = watch(live.name, "--json")
    assert process.stdout is not None
    process.stdout.readline()
    with open(f"/proc/{process.pid}/maps", encoding="utf-8") as lines:
        maps = [line.split()[1] for line in lines if line.rstrip().endswith(f"/{live.name}")]
    process.kill()
    process.communicate()
    assert maps and set(maps) == {"r--s"}


def test_broken_pipe(live: shmtf.Store) -> None:
    process = watch(live.name)
    assert process.stdout is not None and process.stderr is not None
    process.stdout.readline()
    process.stdout.close()
    assert process.stderr.read() == ""
    assert process.wait() == 0
    process.stderr.close()
