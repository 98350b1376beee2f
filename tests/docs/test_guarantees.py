# SPDX-License-Identifier: Apache-2.0
"""Each promise of GUARANTEES.md names what holds it, and that exists."""

import re
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
ROWS = [line.strip("|").split("|") for line in (ROOT / "GUARANTEES.md").read_text().splitlines() if line[:1] == "|"]
PROMISES = [(row[0].strip(), row[1]) for row in ROWS if not re.match(r"-+$|promise$", row[0].strip())]


def missing(reference: str) -> str | None:
    """Why the reference does not hold, or None."""
    if command := re.fullmatch(r"tools/dev (\w+)", reference):
        usage = subprocess.run([ROOT / "tools" / "dev"], check=True, capture_output=True, text=True).stdout
        return None if re.search(rf"^  {command[1]} ", usage, re.MULTILINE) else "no such command"
    path, _, function = reference.partition("::")
    if not path.startswith("tests/") or not (ROOT / path).is_file():
        return "no such test"
    if function and not re.search(rf"^(?:def|(?:static )?\w+) {function}\(", (ROOT / path).read_text(), re.MULTILINE):
        return "no such function in it"
    return None


@pytest.mark.parametrize(("promise", "held_by"), PROMISES, ids=[promise[:50] for promise, _ in PROMISES])
def test_every_promise_is_held_by_tests_that_exist(promise: str, held_by: str) -> None:
    references = re.findall(r"`([^`]+)`", held_by)
    assert references, promise
    assert {r: why for r in references if (why := missing(r))} == {}


def test_a_promise_without_its_test_is_noticed() -> None:
    assert missing("tests/docs/test_guarantees.py::test_that_is_not") == "no such function in it"
    assert missing("tests/docs/test_that_is_not.py") == "no such test"
    assert missing("tools/dev dance") == "no such command"


def test_the_page_is_read() -> None:
    assert len(PROMISES) > 25
