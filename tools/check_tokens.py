# SPDX-License-Identifier: Apache-2.0
"""Small files, small functions, a licence line in each source file, and no words that do not belong in one.

Limits: C files 400 lines, Python files 350, functions 80. Forbidden: paths of one machine, package indexes other than
the default, notes of unfinished work.
"""

import ast
import re
from pathlib import Path

from _source import code_only, finish, line_of, problem, project_files

FILE_LINES = {".c": 400, ".h": 400, ".cpp": 400, ".py": 350, ".pyi": 350}
FUNCTION_LINES = 80
SPDX = "SPDX-License-Identifier: Apache-2.0"
SOURCE_SUFFIXES = {*FILE_LINES, ".cmake", ".in", ".sh", ".toml", ".promela", ".pml", ".litmus"}
SOURCE_NAMES = {"CMakeLists.txt"}
BINARY = {".png", ".npz", ".npy", ".gz", ".bin", ".pdf", ".jpg"}

# Written so that no pattern finds itself here.
FORBIDDEN = [
    (re.compile(r"(?<![\w.~$}\"-])/(?:home|root|work|Users)(?:/|\b(?=[\s\"'`]))"), "a path of one machine"),
    (re.compile(r"\b(?:extra-index|index|find)-(?:url|links)\b"), "a package index"),
    (re.compile(r"https?://(?:\d+\.){3}\d+|https?://[\w.-]*(?:registry|mirror|proxy|artifactory)\b"), "a host"),
    (re.compile(r"\b(?:TO[D]O|FIX[M]E|X[X]X|HA[C]K)\b"), "a note of unfinished work"),
]


def check_words(path: Path, text: str) -> list[str]:
    return [
        problem(path, line_of(text, match.start()), f"{what}: {match[0].strip()}")
        for pattern, what in FORBIDDEN
        for match in pattern.finditer(text)
    ]


def check_licence(path: Path, text: str) -> list[str]:
    is_source = path.suffix in SOURCE_SUFFIXES or path.name in SOURCE_NAMES or text.startswith("#!")
    if not is_source or not text.strip() or SPDX in "".join(text.splitlines(keepends=True)[:3]):
        return []
    return [problem(path, 1, f"no {SPDX} in the first three lines")]


def c_functions(text: str) -> list[tuple[str, int, int]]:
    """Name, first and last line of each function body: a brace at depth 0 that follows a parameter list."""
    code = re.sub(r"^[ \t]*#(?:[^\n]*\\\n)*[^\n]*", lambda m: re.sub(r"[^\n]", " ", m[0]), code_only(text), flags=re.M)
    code = code.replace('extern "C"', "          ")
    functions = []
    depth, start, name = 0, 0, ""
    for match in re.finditer(r"[{}]", code):
        if match[0] == "{":
            if depth == 0:
                before = code[: match.start()]
                head = re.search(r"(\w+)\s*\((?:[^;{}])*\)[\w\s()]*$", before)
                name = head[1] if head else ""
                start = line_of(code, head.start()) if head else line_of(code, match.start())
                if re.search(r"extern\s*$", before):
                    continue
            depth += 1
        else:
            depth = max(0, depth - 1)
            if depth == 0 and name:
                functions.append((name, start, line_of(code, match.start())))
                name = ""
    return functions


def python_functions(text: str) -> list[tuple[str, int, int]]:
    kinds = (ast.FunctionDef, ast.AsyncFunctionDef)
    return [(n.name, n.lineno, n.end_lineno or n.lineno) for n in ast.walk(ast.parse(text)) if isinstance(n, kinds)]


def check_sizes(path: Path, text: str) -> list[str]:
    problems = []
    limit = FILE_LINES[path.suffix]
    n_lines = len(text.splitlines())
    if n_lines > limit and path.name != "shmtf.h":  # the public header is its own manual
        problems.append(problem(path, limit + 1, f"{n_lines} lines, at most {limit}"))
    functions = python_functions(text) if path.suffix in (".py", ".pyi") else c_functions(text)
    for name, first, last in functions:
        if last - first + 1 > FUNCTION_LINES:
            problems.append(problem(path, first, f"{name}: {last - first + 1} lines, at most {FUNCTION_LINES}"))
    return problems


def main() -> None:
    problems = []
    n_files = 0
    for path in project_files():
        if path.suffix in BINARY or path.name == "LICENSE":
            continue
        try:
            text = path.read_text()
        except UnicodeDecodeError:
            continue
        n_files += 1
        problems += check_words(path, text) + check_licence(path, text)
        try:
            problems += check_sizes(path, text) if path.suffix in FILE_LINES else []
        except SyntaxError as error:
            problems.append(problem(path, error.lineno or 1, f"does not parse: {error.msg}"))
    finish(__file__, problems, f"{n_files} files")


main()
