# SPDX-License-Identifier: Apache-2.0
"""`shmtf-bench scale`: every size has its rows, and lookups write nothing.  No test asserts a time."""

from __future__ import annotations

import json
from typing import Any

import pytest

from shmtf import _bench, bench

ROWS = {"first", "latest handle", "latest name", "any time handle", "write 1", "write depth"}
SMALL = ["--frames", "17,100", "--depth", "1,300", "--history", "4,64", "--rounds", "2", "--round-ms", "1"]


@pytest.fixture(scope="module")
def cases(tmp_path_factory: pytest.TempPathFactory) -> list[dict[str, Any]]:
    path = tmp_path_factory.mktemp("scale") / "scale.json"
    assert bench.main(["scale", *SMALL, "--processes", "1,2", "--lines", "1,8", "--json", str(path)]) == 0
    result = json.loads(path.read_text())
    assert result["kind"] == "scale" and result["parameters"]["rounds"] == 2
    return result["cases"]  # type: ignore[no-any-return]


def test_sizes(cases: list[dict[str, Any]]) -> None:
    sizes = [(c["frames"], c["history"], c["depth"]) for c in cases if c["sweep"] in ("frames", "depth", "history")]
    assert sizes == [(17, 16, 16), (100, 16, 16), (10000, 16, 1), (10000, 16, 300), (1000, 4, 16), (1000, 64, 16)]
    for case in cases:
        if "rows" in case:
            assert case["rows"].keys() == ROWS and case["skipped"] is None
            assert all(0 < row["ns"]["min"] <= row["ns"]["max"] for row in case["rows"].values())


def test_processes(cases: list[dict[str, Any]]) -> None:
    found = [c for c in cases if c["sweep"] == "processes"]
    assert [c["processes"] for c in found] == [1, 2]
    assert all(c["reads_per_s"]["min"] > 0 and c["writes_per_s"]["min"] > 0 for c in found)


def test_lookups_write_no_line_and_commits_do(cases: list[dict[str, Any]]) -> None:
    lookups, one, eight = (c for c in cases if c["sweep"] == "lines")
    assert lookups["frames"] is None and lookups["lines"] == {"median": 0, "min": 0, "max": 0}
    assert (one["frames"], eight["frames"]) == (1, 8)
    # commit word, writer's state; per frame: lock, copied pose, head, the record's head and body (bench/README.md)
    assert one["lines"]["median"] == 2 + 5
    assert eight["lines"]["median"] == 2 + 5 * 8


@pytest.mark.parametrize(("frames", "history", "depth"), [(16, 16, 16), (100, 3, 16), (100, 16, 0)])
def test_impossible_sizes(frames: int, history: int, depth: int) -> None:
    with pytest.raises(ValueError, match="at least"):
        _bench.scale(frames, history, depth, 1, 1000, -1)


def test_too_large_for_shared_memory() -> None:
    assert _bench.scale(1_000_000, 3000, 16, 1, 1000, -1) is None
