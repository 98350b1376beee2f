# SPDX-License-Identifier: Apache-2.0
"""Every ordering edge has a name, two ends in the code, and a paragraph in native/MEMORY_MODEL.md.

An end is a comment `[E3 release]`, `[E3 acquire]` or, for an edge between two full fences, `[E3 seq_cst]` at both
sites. `pairs with [E3 acquire] in ring.c` is a reference, and the end it names must be in that file. In
MEMORY_MODEL.md an edge is defined by a heading or a table row that begins with its name. A row of its second table,
`| E3 | `record.c` ... |`, names the edge's scenarios in tests/model/weak, which exist and speak of the edge. No file
but native/segment/atomic.h spells an atomic.
"""

import re
from collections import defaultdict
from pathlib import Path

from _source import NATIVE, code_only, comments_only, finish, line_of, problem, project_files

MODEL = NATIVE / "MEMORY_MODEL.md"
ATOMIC_HEADER = NATIVE / "segment" / "atomic.h"
NAMED = r"\[(E\d+)\s+(release|acquire|seq_cst)\b[^\]]*\]"
END = re.compile(NAMED)
REFERENCE = re.compile(r"pairs\s+with\s*(?:\*\s*)?" + NAMED + r"(?:\s*in\s+([\w/]+\.[ch]))?")
DEFINITION = re.compile(r"^(?:#+\s*|\|\s*)\**(E\d+)\b", re.MULTILINE)
SCENARIO_ROW = re.compile(r"^\|\s*(E\d+)\s*\|(.*)$", re.MULTILINE)
SCENARIOS = NATIVE.parent / "tests" / "model" / "weak"
SPELLED = re.compile(r"\b(?:_Atomic|atomic_\w+|__atomic\w*|__sync\w*|memory_order\w*|volatile)\b|<stdatomic\.h>")

Ends = dict[str, dict[str, list[tuple[Path, int]]]]  # edge -> side -> places


def collect(files: list[Path]) -> tuple[Ends, list[tuple[Path, int, str, str, str | None]]]:
    ends: Ends = defaultdict(lambda: defaultdict(list))
    references = []
    for path in files:
        text = comments_only(path.read_text())
        for match in REFERENCE.finditer(text):
            references.append((path, line_of(text, match.start()), match[1], match[2], match[3]))
        text = REFERENCE.sub(lambda m: re.sub(r"[^\n]", " ", m[0]), text)
        for match in END.finditer(text):
            ends[match[1]][match[2]].append((path, line_of(text, match.start())))
    return ends, references


def check_ends(ends: Ends, defined: dict[str, int]) -> list[str]:
    problems = []
    for edge, sides in sorted(ends.items()):
        path, line = next(place for places in sides.values() for place in places)
        if edge not in defined:
            problems.append(problem(path, line, f"{edge} is not in MEMORY_MODEL.md"))
        if "seq_cst" in sides:
            if len(sides["seq_cst"]) < 2 and len(sides) < 2:
                problems.append(problem(path, line, f"{edge} has one [{edge} seq_cst] end, two belong to it"))
            continue
        for side in ("release", "acquire"):
            if side not in sides:
                problems.append(problem(path, line, f"{edge} has no [{edge} {side}] end in the code"))
    for edge, line in sorted(defined.items()):
        if edge not in ends:
            problems.append(problem(MODEL, line, f"{edge} has no end in the code"))
    return problems


def check_scenarios(text: str, defined: dict[str, int]) -> list[str]:
    problems = []
    named: dict[str, list[str]] = defaultdict(list)
    for match in SCENARIO_ROW.finditer(text):
        named[match[1]] += re.findall(r"`([\w-]+\.(?:c|litmus))`", match[2])
    for edge, line in sorted(defined.items()):
        if not named[edge]:
            problems.append(problem(MODEL, line, f"{edge} has no scenario in tests/model/weak"))
        for name in named[edge]:
            path = SCENARIOS / name
            if not path.exists() or not re.search(rf"\b{edge}\b", path.read_text()):
                problems.append(problem(MODEL, line, f"{edge}: tests/model/weak/{name} is not there, or not about it"))
    return problems


def check_spelling(path: Path) -> list[str]:
    if path == ATOMIC_HEADER:
        return []
    text = code_only(path.read_text())
    return [
        problem(path, line_of(text, match.start()), f"{match[0]} is spelled in segment/atomic.h alone")
        for match in SPELLED.finditer(text)
    ]


def main() -> None:
    files = [p for p in project_files() if NATIVE in p.parents and p.suffix in (".c", ".h")]
    ends, references = collect(files)
    defined: dict[str, int] = {}
    problems = []
    if MODEL.exists():
        text = MODEL.read_text()
        for match in DEFINITION.finditer(text):
            defined.setdefault(match[1], line_of(text, match.start()))
        for match in re.finditer(r"\bE\d+\b", text):
            if match[0] not in defined:
                problems.append(problem(MODEL, line_of(text, match.start()), f"{match[0]} is used, not defined"))
        problems += check_scenarios(text, defined)
    else:
        problems.append(problem(MODEL, 1, "missing"))
    problems += check_ends(ends, defined)
    for path, line, edge, side, name in references:
        places = ends.get(edge, {}).get(side, [])
        if not any(name is None or str(place).endswith("/" + name) for place, _ in places):
            where = f" in {name}" if name else ""
            problems.append(problem(path, line, f"pairs with [{edge} {side}]{where}, which is not there"))
    problems += [p for path in files for p in check_spelling(path)]
    finish(__file__, problems, f"{len(ends)} edges, {sum(len(v) for s in ends.values() for v in s.values())} ends")


main()
