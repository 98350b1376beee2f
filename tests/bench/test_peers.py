# SPDX-License-Identifier: Apache-2.0
"""The libraries beside ours answer what ours answers, and their absence is said and harmless."""

from __future__ import annotations

import json
import math
import os
import random
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import shmtf
from shmtf import _bench, _core, bench
from shmtf.bench import _peers
from shmtf.bench._python_protocols import PYTHON_PROTOCOLS, PythonProtocol

TOLERANCE = 1e-9
PERIOD_NS = 10_000_000
TOLD = {"frames": 60, "history": 8, "read_len": 16, "write_len": 16, "opposite": False}
ORACLE = """
import json, sys
import genpy, tf2_py
from geometry_msgs.msg import TransformStamped
told = json.load(sys.stdin)
core = tf2_py.BufferCore(genpy.Duration(1000))
for parent, child, stamp, t, r in told["records"]:
    m = TransformStamped()
    m.header.frame_id, m.child_frame_id, m.header.stamp = parent, child, genpy.Time(*divmod(stamp, 10**9))
    m.transform.translation.x, m.transform.translation.y, m.transform.translation.z = t
    q = m.transform.rotation
    q.x, q.y, q.z, q.w = r
    core.set_transform(m, "test")
found = []
for target, source, stamp in told["asked"]:
    m = core.lookup_transform_core(target, source, genpy.Time(*divmod(stamp, 10**9))).transform
    t, q = m.translation, m.rotation
    found.append([[t.x, t.y, t.z], [q.x, q.y, q.z, q.w]])
json.dump(found, sys.stdout)
"""


@pytest.fixture
def library() -> str:
    found = _peers.tf2_library()
    if found is None:
        pytest.skip("tf2 in C++ was not there when this was built")
    return found


@pytest.fixture
def interpreter() -> str:
    found = _peers.tf2_python()
    if found is None:
        pytest.skip("no python3.11 here imports tf2_py")
    return found


def micro(tmp_path: Path, *args: str) -> dict[str, Any]:
    path = tmp_path / "micro.json"
    short = ["--rounds", "2", "--round-ms", "1", "--frames", "40", "--history", "8", "--json", str(path)]
    assert bench.main(["micro", *short, *args]) == 0
    return json.loads(path.read_text())  # type: ignore[no-any-return]


# ---- answers ----


def snake(n_frames: int, n_records: int) -> list[tuple[str, str, int, list[float], list[float]]]:
    records = []
    for k in range(n_records):
        for child in range(1, n_frames):
            stamp = 10**12 + k * PERIOD_NS + 7919000 * child % PERIOD_NS
            half = 0.25 * math.sin(3.1e-9 * (stamp % 10**11) + 0.7 * child)
            rotation = [s * math.sin(half) / math.sqrt(3) for s in (1, -1, 1)] + [math.cos(half)]
            names = f"link_{child - 1:05}", f"link_{child:05}"
            records.append((*names, stamp, [0.1, 0.01 * math.sin(child + k), 0.0], rotation))
    return records


def assert_same(transform: shmtf.Transform, translation: list[float], rotation: list[float]) -> None:
    assert np.allclose(transform.translation, translation, rtol=0, atol=TOLERANCE)
    sign = 1 if np.dot(transform.rotation, rotation) > 0 else -1
    assert np.allclose(transform.rotation, sign * np.array(rotation), rtol=0, atol=TOLERANCE)


def test_tf2_py_answers_as_we_do(interpreter: str, store: shmtf.Store) -> None:
    """At any time, in both directions, over any number of edges."""
    records, choose = snake(20, 12), random.Random(1)
    for record in records:
        store.set_transform(shmtf.Transform(*record))
    asked = []
    for _ in range(200):
        low, high = sorted(choose.sample(range(20), 2))
        names = [f"link_{low:05}", f"link_{high:05}"]
        choose.shuffle(names)
        asked.append((*names, 10**12 + choose.randrange(PERIOD_NS, 10 * PERIOD_NS)))
    told = json.dumps({"records": records, "asked": asked})
    done = subprocess.run(
        [interpreter, "-c", ORACLE], input=told, capture_output=True, text=True, timeout=120, check=True
    )
    for (target, source, stamp), (translation, rotation) in zip(asked, json.loads(done.stdout), strict=True):
        assert_same(store.lookup_transform(target, source, stamp), translation, rotation)


def test_tf2_in_c_is_a_protocol(library: str) -> None:
    name = _bench.load(library)
    what, threads, common_time = _bench.protocols()[name]
    assert name == "tf2" and threads and common_time and "mutex" in what
    assert _bench.load(library) == name


# ---- Python protocols ----


@pytest.fixture(params=["shmtf", "numpy-lock"])
def client(request: pytest.FixtureRequest) -> Any:
    kind = PYTHON_PROTOCOLS[request.param]
    place = kind.create(f"shmtf-bench-{os.getpid()}-test", TOLD)
    try:
        made = kind(place, TOLD)
    finally:
        kind.remove(place)
    yield made
    made.close()


def test_python_protocol_reads_what_it_wrote(client: PythonProtocol) -> None:
    client.write(5, 10**15)
    client.write(13, 2 * 10**15)
    stamps = client.stamps(client.read(4))
    assert len(stamps) == TOLD["read_len"] and max(stamps[:1]) < 10**15  # frame 5 is older than both updates
    assert stamps[1:9] == [10**15] * 8 and stamps[9:] == [2 * 10**15] * 7
    assert client.stamps(client.read(13)) == [2 * 10**15] * 16
    assert client.retries() == (0, 0)


def test_python_protocol_leaves_no_name(client: PythonProtocol) -> None:
    assert client.stamps(client.read(0))
    assert not [name for name in os.listdir("/dev/shm") if f"shmtf-bench-{os.getpid()}-test" in name]


@pytest.mark.parametrize("read_len", [1, 2, 3, 7, 16])
def test_numpy_lock_multiplies_the_chain(read_len: int) -> None:
    told, kind = {**TOLD, "read_len": read_len}, PYTHON_PROTOCOLS["numpy-lock"]
    place = kind.create(f"shmtf-bench-{os.getpid()}-test", told)
    made: Any = kind(place, told)
    kind.remove(place)
    made.write(3, 1)
    made.write(19, 1)
    expected = np.eye(4)
    for frame in range(10, 10 + read_len):
        expected = expected @ made._poses[frame]
    assert not np.allclose(expected, np.eye(4))
    assert np.allclose(made.read(9)[0], expected, rtol=0, atol=TOLERANCE)
    made.close()


def test_tf2_python_is_a_protocol_in_its_interpreter(interpreter: str, tmp_path: Path) -> None:
    """It imports neither shmtf nor numpy there."""
    code = """
import sys
from shmtf.bench._python_protocols import Tf2Python
told = {"frames": 60, "history": 8, "read_len": 16, "write_len": 16, "opposite": False}
client = Tf2Python(Tf2Python.create("x", told), told)
stamp = client.stamps(client.read(5))[0] + 10**9
client.write(5, stamp)
answer = client.read(5)
assert client.stamps(answer) == [stamp] * 16, (client.stamps(answer), stamp)
r = answer.transform.rotation
assert abs(r.x**2 + r.y**2 + r.z**2 + r.w**2 - 1) < 1e-9 and "numpy" not in sys.modules
"""
    start = _peers.command(interpreter, "-")[2].split("sys.exit(")[0]
    folders = _peers.command(interpreter, "-")[4]
    done = subprocess.run(
        [interpreter, "-c", start + code, "-", folders],
        check=False,
        capture_output=True,
        text=True,
        timeout=120,
        cwd=tmp_path,
    )
    assert done.returncode == 0, done.stderr


# ---- rows of ycsb ----


def ycsb(tmp_path: Path, *args: str) -> list[dict[str, Any]]:
    path = tmp_path / "ycsb.json"
    short = ["--frames", "200", "--duration", "0.5", "--warm-up", "0.05", "--rounds", "1", "--check-every", "1"]
    assert bench.main(["ycsb", *short, "--processes", "2", "--json", str(path), *args]) == 0
    return json.loads(path.read_text())["cases"]  # type: ignore[no-any-return]


def assert_at_common_time(case: dict[str, Any]) -> None:
    """One stamp stands for all edges, so a mixture cannot be seen."""
    assert case["checked_reads"] > 0 and case["mixed_reads"] is None
    assert case["span_ns"]["max"] == 0 < case["age_oldest_ns"]["p50"]


def assert_worked(case: dict[str, Any]) -> None:
    assert case["failures"] == 0
    assert case["reads_per_s"]["median"] > 0 and case["writes_per_s"]["median"] > 0


def test_ycsb_with_tf2_in_c(library: str, tmp_path: Path) -> None:
    ours, theirs = ycsb(tmp_path, "--protocol", "shmtf,tf2")
    assert_worked(ours)
    assert_worked(theirs)
    assert_at_common_time(theirs)


def test_ycsb_in_python(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for case in ycsb(tmp_path, "--engine", "python", "--protocol", "shmtf,numpy-lock"):
        assert_worked(case)
        assert case["checked_reads"] > 0 and case["mixed_reads"] == 0
    assert "numpy-lock: no names" in capsys.readouterr().out


def test_ycsb_with_tf2_in_python(interpreter: str, tmp_path: Path) -> None:
    (case,) = ycsb(tmp_path, "--engine", "python", "--protocol", "tf2-python")
    assert_worked(case)
    assert_at_common_time(case)


def test_ycsb_lists_what_there_is(capsys: pytest.CaptureFixture[str]) -> None:
    assert bench.main(["ycsb", "--list", "--engine", "python"]) == 0
    text = capsys.readouterr().out
    assert "numpy-lock" in text and ("tf2-python" in text) == (_peers.tf2_python() is not None)


# ---- rows of micro ----


def test_micro_has_tf2_beside(
    library: str, interpreter: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (config,) = micro(tmp_path)["configurations"]
    assert config["without_tf2"] is None
    rows = {(row["engine"], row["name"]): row for row in config["rows"]}
    theirs = [row for row in config["rows"] if row["peer"]]
    assert {row["peer"] for row in theirs} == {"tf2", "tf2_py"}
    assert len(config["comparisons"]) == len(theirs)
    for c in config["comparisons"]:
        mine, peer = rows[c["engine"], c["row"]], rows[c["engine"], c["peer_row"]]
        assert mine["peer"] is None and mine["floor"] == peer["floor"]
        assert c["times"] == pytest.approx(peer["ns"]["median"] / mine["ns"]["median"])
    text = capsys.readouterr().out
    assert "tf2 / shmtf" in text and "no update of several frames at once" in text


def test_micro_without_peers(tmp_path: Path) -> None:
    result = micro(tmp_path, "--no-peers")
    assert result["notes"] == []
    assert all(row["peer"] is None for row in result["configurations"][0]["rows"])


def test_micro_where_there_is_no_tf2(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def nothing(minor: int = 11) -> None:
        return None

    monkeypatch.setattr(_peers, "tf2_library", nothing)
    monkeypatch.setattr(_peers, "tf2_python", nothing)
    monkeypatch.setattr("shmtf.bench._python_rows.tf2_python", nothing)
    result = micro(tmp_path)
    assert all(row["peer"] is None for row in result["configurations"][0]["rows"])
    text = capsys.readouterr().out
    assert "libtf2-dev" in text and "python3-tf2" in text and "no update of several frames" not in text


def test_micro_goes_on_where_tf2_py_breaks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its interpreter, here ours, passes for one that has it."""
    monkeypatch.setattr("shmtf.bench._python_rows.tf2_python", lambda minor: sys.executable)
    (config,) = micro(tmp_path, "--engine", "python")["configurations"]
    assert "tf2_py" in config["without_tf2_py"] or "genpy" in config["without_tf2_py"]
    assert {row["peer"] for row in config["rows"]} == {None}
    assert "without tf2_py: the peer's process ended" in capsys.readouterr().out


# ---- what is no peer ----


def not_a_library(tmp_path: Path) -> Path:
    path = tmp_path / "peer.so"
    path.write_text("not a library")
    return path


@pytest.mark.parametrize("make", [lambda tmp: tmp / "absent.so", not_a_library, lambda tmp: Path(_core.__file__)])
def test_loading_a_wrong_file(tmp_path: Path, make: Callable[[Path], Path]) -> None:
    path = make(tmp_path)
    with pytest.raises(OSError, match=path.name):
        _bench.load(str(path))
    rows, why = _bench.micro(40, 8, 16, 1, 1000, -1, str(path)) or ([], "")
    assert rows and path.name in why


def test_a_peer_process_that_ends_says_why() -> None:
    helper = _peers.Helper(sys.executable, "_peer_tf2", {"frames": "none"})
    try:
        with pytest.raises(bench.BenchError, match=r"the peer's process ended: \w+Error"):
            helper.answer()
    finally:
        helper.close()
