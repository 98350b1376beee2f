# SPDX-License-Identifier: Apache-2.0
"""The line that says how much is done: bars within bars, only where somebody watches."""

from __future__ import annotations

import io

import pytest

from shmtf.bench import _report


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_a_bar_within_a_step(monkeypatch: pytest.MonkeyPatch) -> None:
    screen = Terminal()
    monkeypatch.setattr("sys.stderr", screen)
    with _report.Bar(4) as outer:
        outer.begin("first")
        outer.begin("second", weight=3)
        with _report.Bar(2) as inner:
            inner.begin("half of it")
            inner.begin("the rest")
    shares = [line.split("]")[1].split()[0] for line in screen.getvalue().split("\r") if "]" in line]
    assert shares == ["0", "25", "25", "62"]
    assert screen.getvalue().endswith("\r\033[K")


def test_nothing_where_nobody_watches(capsys: pytest.CaptureFixture[str]) -> None:
    with _report.Bar(2) as bar:
        bar.begin("first")
        _report.progress("more")
    assert capsys.readouterr().err == ""


def test_distribution() -> None:
    found = _report.distribution(range(1, 1001))
    assert found == {"count": 1000, "mean": 500.5, "p50": 501, "p99": 991, "p99_9": 1000, "max": 1000}
    assert _report.distribution([]) is None
