# SPDX-License-Identifier: Apache-2.0
"""What a call from Python costs.  The standard library of Python 3.8 is enough: peers run it in their interpreter."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

BATCH = 500  # calls between two looks at the clock

# One loop per number of arguments: a call with a star would be measured too.  By this thread's processor time: what
# other processes do meanwhile does not count, except to the caches.


def _time_1(call: Callable[..., Any], arguments: list[tuple[Any, ...]]) -> int:
    start = time.thread_time_ns()
    for (a,) in arguments:
        call(a)
    return time.thread_time_ns() - start


def _time_2(call: Callable[..., Any], arguments: list[tuple[Any, ...]]) -> int:
    start = time.thread_time_ns()
    for a, b in arguments:
        call(a, b)
    return time.thread_time_ns() - start


def _time_3(call: Callable[..., Any], arguments: list[tuple[Any, ...]]) -> int:
    start = time.thread_time_ns()
    for a, b, c in arguments:
        call(a, b, c)
    return time.thread_time_ns() - start


_TIME = {1: _time_1, 2: _time_2, 3: _time_3}


def _time_loop(arguments: list[tuple[Any, ...]]) -> int:
    start = time.thread_time_ns()
    for _ in arguments:
        pass
    return time.thread_time_ns() - start


def ns_per_call(call: Callable[..., Any], make: Callable[[int], list[tuple[Any, ...]]], round_ns: float) -> float:
    """The loop around the call subtracted.  make(n): the arguments of n calls, not timed."""
    total = calls = 0
    call(*make(1)[0])
    while total < round_ns:
        arguments = make(BATCH)
        total += _TIME[len(arguments[0])](call, arguments) - _time_loop(arguments)
        calls += BATCH
    return total / calls
