# SPDX-License-Identifier: Apache-2.0
"""`shmtf bench`, `shmtf-bench`: the benchmarks of shmtf.bench."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module

from ._common import CliError


def run(prog: str, argv: Sequence[str]) -> int:
    package = __name__.split(".", maxsplit=1)[0]
    try:
        bench = import_module(f"{package}.bench")
    except ModuleNotFoundError as error:
        raise CliError(f"the benchmarks cannot be loaded: {error}") from error
    return int(bench.main(list(argv)) or 0)
