# SPDX-License-Identifier: Apache-2.0
"""Argument types of the command lines."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import Any


def positive(kind: type[int] | type[float], most: float | None = None) -> Callable[[str], Any]:
    """A number above 0."""

    def convert(text: str) -> Any:
        value = kind(text)
        if not value > 0 or (most is not None and value > most):
            raise argparse.ArgumentTypeError(f"{text}: more than 0" + (f", at most {most}" if most is not None else ""))
        return value

    convert.__name__ = "number"  # argparse says "invalid number value"
    return convert


def not_negative(kind: type[int] | type[float]) -> Callable[[str], Any]:
    def convert(text: str) -> Any:
        value = kind(text)
        if not value >= 0:
            raise argparse.ArgumentTypeError(f"{text}: 0 or more")
        return value

    convert.__name__ = "number"
    return convert


def ratio(text: str) -> float:
    value = float(text)
    if not 0 <= value <= 1:
        raise argparse.ArgumentTypeError(f"{text}: between 0 and 1")
    return value


def counts(least: int) -> Callable[[str], list[int]]:
    """Numbers with commas between them."""

    def convert(text: str) -> list[int]:
        values = [int(word) for word in text.split(",")]
        if any(value < least for value in values):
            raise argparse.ArgumentTypeError(f"{text}: each at least {least}")
        return values

    convert.__name__ = "list of numbers"
    return convert


def words(allowed: Callable[[], list[str]]) -> Callable[[str], list[str]]:
    """Some of a list of words, with commas between them; the list is made when it is needed."""

    def convert(text: str) -> list[str]:
        chosen = text.split(",")
        for word in chosen:
            if word not in allowed():
                raise argparse.ArgumentTypeError(f"{word!r} is not one of: {', '.join(allowed())}")
        return list(dict.fromkeys(chosen))

    convert.__name__ = "list of words"
    return convert
