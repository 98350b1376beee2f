# SPDX-License-Identifier: Apache-2.0
"""native/LAYOUT.md is what the compiler says; `--write` makes it so.

The table comes from shmtf_layout_fields(), which the compiler fills with offsetof and sizeof. Also checked: fields are
whole 64-bit words and do not overlap, so no compiler chooses any padding; what no field covers is shown as unused.
"""

import os
import subprocess
import sys
import tempfile
from itertools import groupby
from pathlib import Path

from _source import NATIVE, ROOT, finish, problem

LAYOUT = NATIVE / "LAYOUT.md"
LAYOUT_SOURCE = NATIVE / "segment" / "layout.c"
WORD = 8
HEADER = """\
<!-- SPDX-License-Identifier: Apache-2.0 -->
# Layout of a segment

Generated from the compiler-filled field table in `segment/layout.c`: edit that, then run
`python tools/check_layout.py --write`. Offsets and sizes are bytes from the start of the record, little-endian; the
rule says who may write the field and under which lock, and who may read it raw.
"""

Field = tuple[str, str, int, int, str]  # record, field, offset, size, rule


def read_fields() -> list[Field]:
    compiler = os.environ.get("CC", "cc").split()
    flags = ["-std=c11", f"-I{NATIVE}", f"-I{NATIVE / 'include'}"]
    sources = [str(ROOT / "tools" / "print_layout.c"), str(LAYOUT_SOURCE)]
    with tempfile.TemporaryDirectory() as directory:
        program = str(Path(directory) / "print_layout")
        subprocess.run([*compiler, *flags, *sources, "-o", program], check=True)
        printed = subprocess.run([program], capture_output=True, text=True, check=True).stdout
    fields = []
    for line in printed.splitlines():
        record, field, offset, size, rule = line.split("\t", 4)
        fields.append((record, field, int(offset), int(size), rule))
    return fields


def render(fields: list[Field]) -> str:
    parts = [HEADER]
    for record, group in groupby(fields, key=lambda f: f[0]):
        parts.append(f"\n## {record}\n\n| offset | size | field | rule |\n|---:|---:|---|---|\n")
        end = 0
        for _, field, offset, size, rule in group:
            if offset > end:
                parts.append(f"| {end} | {offset - end} | *unused* | |\n")
            parts.append(f"| {offset} | {size} | `{field}` | {rule} |\n")
            end = offset + size
    return "".join(parts)


def check_words(fields: list[Field]) -> list[str]:
    problems = []
    for record, group in groupby(fields, key=lambda f: f[0]):
        end = 0
        for _, field, offset, size, _ in group:
            if offset < end:
                problems.append(problem(LAYOUT_SOURCE, 1, f"{record}.{field} at {offset} overlaps what ends at {end}"))
            if offset % WORD or size % WORD:
                problems.append(problem(LAYOUT_SOURCE, 1, f"{record}.{field} ({offset}, {size}) is not whole words"))
            end = offset + size
    return problems


def main() -> None:
    fields = read_fields()
    text = render(fields)
    problems = check_words(fields)
    if "--write" in sys.argv[1:]:
        LAYOUT.write_text(text)
    elif not LAYOUT.exists():
        problems.append(problem(LAYOUT, 1, "missing; run python tools/check_layout.py --write"))
    else:
        have, want = LAYOUT.read_text().splitlines(), text.splitlines()
        if have != want:
            pairs = zip(have + [""] * len(want), want + [""] * len(have), strict=False)
            line, expected = next((i, w) for i, (h, w) in enumerate(pairs, 1) if h != w)
            problems.append(problem(LAYOUT, line, f"stale, the compiler says: {expected}"))
    finish(__file__, problems, f"{len(fields)} fields of {len({f[0] for f in fields})} records")


main()
