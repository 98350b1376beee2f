# SPDX-License-Identifier: Apache-2.0
"""The layers hold: API -> core -> segment, and nothing looks up.

Three checks: the include table below; the order of the core's sources in native/CMakeLists.txt, which stand bottom up
(a file includes and calls only what stands before it there); and the undefined symbols of each compiled core file,
which may be pure functions of bytes or numbers, or symbols of lower files, so that core can make no system call, no
allocation and read no clock.
"""

import ast
import os
import re
import subprocess
import tempfile
from pathlib import Path

from _source import NATIVE, ROOT, cmake_sources, finish, line_of, problem, project_files, without_comments

WORDS = {"atomic", "layout", "seqlock", "lock", "failpoint"}  # segment/ without its operating-system half
PURE = {"float.h", "inttypes.h", "limits.h", "math.h", "stdbool.h", "stddef.h", "stdint.h", "string.h"}
ANY = None

# layer: (layers whose headers it may include, system headers it may include)
TABLE: dict[str, tuple[set[str], set[str] | None]] = {
    "include": (set(), {"stdbool.h", "stddef.h", "stdint.h"}),
    "words": ({"words"}, PURE | {"stdatomic.h"}),
    "os": ({"os", "words"}, ANY),
    "core": ({"core", "words", "include"}, PURE),  # include: the value types, such as shmtf_pose
    "api": ({"api", "core", "os", "words", "include"}, ANY),
    "python": ({"python", "include"}, ANY),
}
BYTES = {"memchr", "memcmp", "memcpy", "memmove", "memset", "strcmp", "strlen"}
MATHS = {"acos", "asin", "atan2", "ceil", "copysign", "cos", "fabs", "floor", "fma", "fmax", "fmin", "fmod", "hypot"}
MATHS |= {"llrint", "lrint", "rint", "round", "sin", "sincos", "sqrt", "tan", "trunc"}
UPPER_PYTHON = {"bridges", "cli", "compat", "demo"}  # what the modules of shmtf/ itself never import at their top


def layer_of(path: Path) -> str:
    folder = path.relative_to(NATIVE).parts[0]
    if folder == "segment":
        return "words" if path.stem in WORDS else "os"
    return folder


def find_header(name: str, source: Path) -> Path | None:
    for base in (source.parent, NATIVE, NATIVE / "include"):
        if (base / name).is_file():
            return (base / name).resolve()
    return None


def check_includes(source: Path, ranks: dict[Path, int]) -> list[str]:
    problems = []
    layer = layer_of(source)
    allowed, system = TABLE[layer]
    text = without_comments(source.read_text())
    for match in re.finditer(r'^\s*#\s*include\s*([<"])([^>"]+)[>"]', text, re.MULTILINE):
        line, name = line_of(text, match.start(1)), match[2]
        header = find_header(name, source)
        if header is None:
            if match[1] == '"':
                problems.append(problem(source, line, f"no such header: {name}"))
            elif system is not ANY and name not in system:
                problems.append(problem(source, line, f"{layer} may not include <{name}>"))
        elif layer_of(header) not in allowed:
            problems.append(problem(source, line, f"{layer} may not include {layer_of(header)} ({name})"))
        elif ranks.get(header.with_suffix(""), -1) > ranks.get(source.with_suffix(""), len(ranks)):
            problems.append(problem(source, line, f"{name} comes after {source.name} in native/CMakeLists.txt"))
    return problems


def symbols(path: Path, *flags: str) -> set[str]:
    listing = subprocess.run(["nm", *flags, str(path)], capture_output=True, text=True, check=True).stdout
    return {line.split()[-1] for line in listing.splitlines() if line.strip()}


def check_symbols(sources: list[Path]) -> list[str]:
    problems = []
    compiler = os.environ.get("CC", "cc").split()
    flags = ["-std=c11", "-O2", "-fno-stack-protector", "-fno-tree-loop-distribute-patterns"]
    flags += [f"-I{NATIVE}", f"-I{NATIVE / 'include'}"]
    with tempfile.TemporaryDirectory() as directory:
        objects = [Path(directory) / f"{i}.o" for i in range(len(sources))]
        jobs = [
            subprocess.Popen([*compiler, *flags, "-c", str(source), "-o", str(target)])
            for source, target in zip(sources, objects, strict=True)
        ]
        failed = [job for job in jobs if job.wait()]
        if failed:
            return ["native/CMakeLists.txt:1: a core file does not compile"]
        known = BYTES | MATHS
        for source, target in zip(sources, objects, strict=True):
            for symbol in sorted(symbols(target, "-u") - known):
                problems.append(problem(source, 1, f"needs {symbol}, which no lower file defines"))
            known |= symbols(target, "--defined-only", "-g")
    return problems


def check_python(path: Path) -> list[str]:
    problems = []
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and any(name.name == "*" for name in node.names):
            problems.append(problem(path, node.lineno, "import * hides where a name comes from"))
        if isinstance(node, ast.Import) and any(n.name in ("ctypes", "cffi", "mmap") for n in node.names):
            problems.append(problem(path, node.lineno, "the segment is reached through _core alone"))
    if path.parent == ROOT / "shmtf":
        for statement in ast.parse(path.read_text()).body:
            if isinstance(statement, ast.ImportFrom) and statement.level:
                module = statement.module or statement.names[0].name
                if module.split(".")[0] in UPPER_PYTHON:
                    problems.append(problem(path, statement.lineno, f"shmtf/ may not import {module} at its top"))
    return problems


def main() -> None:
    order = cmake_sources("SEGMENT", "CORE", "API", "PYTHON")
    ranks = {source.with_suffix(""): rank for rank, source in enumerate(cmake_sources("CORE"))}
    files = [p for p in project_files() if NATIVE in p.parents and p.suffix in (".c", ".h")]
    problems = [p for source in files for p in check_includes(source, ranks)]
    problems += [problem(p, 1, "not in native/CMakeLists.txt") for p in files if p.suffix == ".c" and p not in order]
    pure = [s for s in cmake_sources("SEGMENT", "CORE") if layer_of(s) in ("words", "core")]
    problems += check_symbols(pure)
    modules = [p for p in project_files() if p.suffix == ".py" and ROOT / "shmtf" in p.parents]
    problems += [p for module in modules for p in check_python(module)]
    finish(__file__, problems, f"{len(files)} C files, {len(pure)} object files, {len(modules)} Python modules")


main()
