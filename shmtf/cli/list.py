# SPDX-License-Identifier: Apache-2.0
"""`shmtf list`: the stores of this machine that this user may read."""

from __future__ import annotations

import argparse
import json
import os
import stat
from collections.abc import Sequence
from typing import Any

from ._common import Style, printable, size, span, table

_MAX_HOLDERS = 3  # named in the table; the rest is counted


def run(prog: str, argv: Sequence[str]) -> int:
    parser = argparse.ArgumentParser(
        prog=prog, allow_abbrev=False, description="List the stores of this machine, and who maps them."
    )
    parser.add_argument("--json", action="store_true", help="for programs")
    args = parser.parse_args(argv)
    stores = _stores()
    if args.json:
        print(json.dumps(stores, indent=2))
        return 0
    style = Style()
    rows = [[style.dim(t) for t in ("store", "size", "frames", "commits", "mode", "made", "mapped by")]]
    rows += [_row(store) for store in stores]
    print("\n".join(table(rows, "<>>><><")) if stores else "no stores")
    return 0


def _stores() -> list[dict[str, Any]]:
    from .. import Store, StoreError, list_stores, now
    from ._holders import DIRECTORY, holders

    names = list_stores()
    holding = holders(names)
    found = []
    for name in names:
        try:
            status = os.stat(os.path.join(DIRECTORY, name))
            with Store.attach(name, readonly=True) as store:
                info = store._info()
                frames = len(store.frames())
                writers = {w["pid"]: w["name"] for w in store._writers() if w["alive"]}
        except (StoreError, OSError):  # removed meanwhile
            continue
        found.append({
            "name": name,
            "size_bytes": info["size_bytes"],
            "frames": frames,
            "max_frames": info["max_frames"],
            "commits": info["version"],
            "mode": stat.S_IMODE(status.st_mode),
            "uid": status.st_uid,
            "created": info["created"],
            "age": (now() - info["created"]) / 1e9,
            "holders": [{"pid": pid, "name": writers.get(pid, process)} for pid, process in holding[name]],
        })  # fmt: skip
    return found


def _row(store: dict[str, Any]) -> list[str]:
    who = [f"{printable(h['name'])} ({h['pid']})" for h in store["holders"]]
    if len(who) > _MAX_HOLDERS:
        who = [*who[: _MAX_HOLDERS - 1], f"and {len(who) - _MAX_HOLDERS + 1} more"]
    return [
        printable(store["name"]),
        size(store["size_bytes"]),
        f"{store['frames']}/{store['max_frames']}",
        f"{store['commits']:,}",
        f"{store['mode']:04o}",
        span(store["age"]) + " ago",
        ", ".join(who) or "nobody",
    ]
