# SPDX-License-Identifier: Apache-2.0
"""`shmtf echo TARGET SOURCE`: print the pose of SOURCE in TARGET."""

from __future__ import annotations

import argparse
import itertools
import math
import sys
import time
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

from ._common import CliError, attach, default_store, printable, span, stamp

if TYPE_CHECKING:
    from ..store import Store
    from ..transform import Transform


def _parser(prog: str) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog=prog,
        allow_abbrev=False,
        description="Print the pose of frame SOURCE in frame TARGET: p_target = T * p_source.",
    )
    parser.add_argument("names", metavar="TARGET SOURCE", nargs="*", help="in this order, or as options:")
    parser.add_argument("--target", help="frame to express it in")
    parser.add_argument("--source", help="frame whose pose it is")
    parser.add_argument("--store", metavar="NAME", help="default: $SHMTF_STORE, or the only one")
    parser.add_argument("--rate", metavar="HZ", type=float, help="again and again, HZ times a second")
    parser.add_argument(
        "--time",
        choices=("latest", "common"),
        default="latest",
        help="latest: newest record of every edge (default); common: the newest time that all edges have",
    )
    parser.add_argument("-n", metavar="N", type=int, help="so many times (default: once; with --rate without end)")
    parser.add_argument("--timeout", metavar="S", type=float, default=0.0, help="wait so long for it to be possible")
    return parser


def run(prog: str, argv: Sequence[str]) -> int:
    parser = _parser(prog)
    args = parser.parse_args(argv)
    names = [*args.names]
    target = args.target if args.target is not None else names.pop(0) if names else None
    source = args.source if args.source is not None else names.pop(0) if names else None
    if target is None or source is None or names:
        parser.error("give TARGET and SOURCE, once each")
    if args.rate is not None and not 0 < args.rate <= 1000:
        parser.error("--rate is more than 0, at most 1000")
    if args.n is not None and args.n < 1:
        parser.error("-n is 1 or more")
    with attach(default_store(args.store)) as store:
        print(_sentence(target, source, store.name, args.time), flush=True)
        try:
            return _repeat(store, target, source, args)
        except KeyboardInterrupt:
            return 0 if args.rate else 130


def _sentence(target: str, source: str, store: str, which: str) -> str:
    how = "newest record of every edge" if which == "latest" else "newest time that all edges have"
    return f'pose of "{printable(source)}" in "{printable(target)}"   (store "{printable(store)}", {how})'


def _repeat(store: Store, target: str, source: str, args: argparse.Namespace) -> int:
    from .. import TransformException

    count = args.n or (None if args.rate else 1)
    period = 1 / (args.rate or 1.0)
    due = time.monotonic()
    failed = ""
    for i in itertools.count(1):
        try:
            if args.time == "latest":
                T = store.lookup_latest_transform(target, source, args.timeout)
            else:
                T = store.lookup_transform(target, source, None, args.timeout)
            print("\n" + "\n".join(_lines(T)), flush=True)
            failed = ""
        except TransformException as error:
            message = printable(str(error))
            if count == i:
                raise CliError(message) from None
            if message != failed:  # it may come; said once
                print(message, file=sys.stderr, flush=True)
            failed = message
        if count == i:
            break
        due = max(due + period, time.monotonic())
        time.sleep(max(0.0, due - time.monotonic()))
    return 0


def _lines(T: Transform) -> list[str]:
    from .. import now

    rpy = [float(v) for v in T.rpy]
    degrees = [math.degrees(v) for v in rpy]
    return [
        f"  stamp        {_times(T, now())}",
        f"  translation  {_numbers('xyz', T.translation)}  m",
        f"  quaternion   {_numbers('xyzw', T.rotation)}",
        f"  rpy          {_numbers(('roll', 'pitch', 'yaw'), rpy)}  rad",
        f"               {_numbers(('roll', 'pitch', 'yaw'), degrees, '9.3f')}  deg",
    ]


def _times(T: Transform, now_ns: int) -> str:
    if T.stamp is None:
        return "none: every edge is static"
    text = f"{stamp(T.stamp)}  {span((now_ns - T.stamp) / 1e9)} old"
    if T.stamp_range is not None and T.stamp_range[0] != T.stamp_range[1]:
        text += f"; the newest edge is {span((now_ns - T.stamp_range[1]) / 1e9)} old"
    return text


def _numbers(labels: Sequence[str], values: Iterable[float], form: str = "9.6f") -> str:
    return "  ".join(f"{label} {float(value) + 0.0:{form}}" for label, value in zip(labels, values, strict=True))
