# SPDX-License-Identifier: Apache-2.0
"""Times: int nanoseconds, and what other libraries use for them."""

from __future__ import annotations

import math
from typing import Any

from . import _core, _failures  # noqa: F401  _failures: what the core raises
from .errors import InvalidArgumentException

__all__ = ["from_seconds", "now", "to_seconds"]

now = _core.now


def from_seconds(seconds: float) -> int:
    """Seconds (any real number) as int nanoseconds, exact to the nearest nanosecond.

    A float of seconds since 1970 has a resolution of 238 ns; keep int nanoseconds where you can.
    Raises InvalidArgumentException if it is not finite or beyond int64 nanoseconds.
    """
    if isinstance(seconds, bool) or not hasattr(seconds, "__floor__"):
        raise TypeError(f"seconds must be a number, not {seconds!r}")
    if isinstance(seconds, float) and not math.isfinite(seconds):
        raise InvalidArgumentException(what="seconds", value=seconds, hint="a finite number")
    whole = math.floor(seconds)
    ns = whole * 10**9 + round((seconds - whole) * 10**9)
    if not -(2**63) <= ns < 2**63:
        raise InvalidArgumentException(what="seconds", value=seconds, hint="a time is int64 nanoseconds")
    return ns


def to_seconds(time: Any) -> float:
    """A time, int nanoseconds or another accepted type, as the nearest float of seconds."""
    return _core.stamp_ns(time) / 10**9


def _from_datetime64(time: Any, what: str) -> int:
    import numpy as np

    # beyond int64 nanoseconds numpy wraps around silently
    if np.isnat(time) or not -(2**63) <= int(time.astype("datetime64[s]").astype("int64")) * 10**9 < 2**63:
        raise InvalidArgumentException(what=what, value=str(time), hint="a time is int64 nanoseconds")
    return int(time.astype("datetime64[ns]").astype("int64"))


def _convert(time: Any, what: str) -> int:
    """Nanoseconds of a time that is not an int: rclpy, rospy, builtin_interfaces, numpy.datetime64."""
    if type(time).__name__ == "datetime64":
        return _from_datetime64(time, what)
    if hasattr(time, "nanoseconds"):
        return int(time.nanoseconds)
    if hasattr(time, "to_nsec"):
        return int(time.to_nsec())
    if hasattr(time, "sec") and hasattr(time, "nanosec"):
        return int(time.sec) * 10**9 + int(time.nanosec)
    advice = " (shmtf.from_seconds converts seconds)" if hasattr(time, "__float__") else ""
    raise TypeError(
        f"{what} must be int nanoseconds, an rclpy, rospy or builtin_interfaces time or a numpy.datetime64, "
        f"not {type(time).__name__}{advice}"
    )


_core.set_stamp_converter(_convert)
