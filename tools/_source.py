# SPDX-License-Identifier: Apache-2.0
"""What the check_*.py scripts share: which files there are, C text without its comments, how a problem is reported."""

import re
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
NATIVE = ROOT / "native"

_COMMENT = r"//[^\n]*|/\*.*?\*/"
_STRING = r'"(?:\\.|[^"\\\n])*"' + r"|'(?:\\.|[^'\\\n])*'"
_TOKENS = re.compile(f"(?P<comment>{_COMMENT})|(?P<string>{_STRING})", re.DOTALL)


def project_files() -> list[Path]:
    """Every file of the project that git tracks or would track; all of them where there is no git."""
    command = ["git", "-C", str(ROOT), "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    try:
        listed = subprocess.run(command, capture_output=True, check=True).stdout.decode().split("\0")
        paths = {ROOT / name for name in listed if name}
    except (OSError, subprocess.CalledProcessError):
        skipped = {".git", ".venv", "build", "dist", "__pycache__"}
        paths = {p for p in ROOT.rglob("*") if not skipped & set(p.relative_to(ROOT).parts)}
    return sorted(p for p in paths if p.is_file())


def _blank(text: str) -> str:
    return re.sub(r"[^\n]", " ", text)


def without_comments(text: str) -> str:
    """C text with comments blanked; every character keeps its place."""
    return _TOKENS.sub(lambda m: _blank(m[0]) if m["comment"] else m[0], text)


def code_only(text: str) -> str:
    """C text with comments and literals blanked."""
    return _TOKENS.sub(lambda m: _blank(m[0]), text)


def comments_only(text: str) -> str:
    """The comments of C text, in their places."""
    kept = [" " if c != "\n" else c for c in text]
    for match in _TOKENS.finditer(text):
        if match["comment"]:
            kept[match.start() : match.end()] = match[0]
    return "".join(kept)


def line_of(text: str, position: int) -> int:
    return text.count("\n", 0, position) + 1


def problem(path: Path, line: int, message: str) -> str:
    return f"{path.relative_to(ROOT)}:{line}: {message}"


def cmake_sources(*names: str) -> list[Path]:
    """The files of `set(SHMTF_<NAME>_SOURCES ...)` in native/CMakeLists.txt, in order."""
    text = (NATIVE / "CMakeLists.txt").read_text()
    found: list[Path] = []
    for name in names:
        match = re.search(rf"set\(SHMTF_{name}_SOURCES\b([^)]*)\)", text)
        if match is None:
            sys.exit(f"native/CMakeLists.txt:1: no list SHMTF_{name}_SOURCES")
        found += [NATIVE / word for word in match[1].split()]
    return found


def finish(script: str, problems: Iterable[str], summary: str) -> None:
    """Print the problems and exit with 1, or print one line that says what was looked at."""
    lines = list(problems)
    for line in lines:
        print(line)
    name = Path(script).stem
    if lines:
        sys.exit(f"{name}: {len(lines)} problem{'s' if len(lines) > 1 else ''}")
    print(f"{name}: {summary}")
