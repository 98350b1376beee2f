# SPDX-License-Identifier: Apache-2.0
"""A recorded history as operations on a tree, for linear.py.

Of each frame only the newest record is kept, so lookups at a time and listings of records are left out; nothing knows
here of versions, handles or rings. A state is a tuple with one Frame per name; names are numbers, as in the log.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import NamedTuple

import log
from linear import Operation, State, Step


class Frame(NamedTuple):
    life: int = 0  # times born
    alive: bool = False
    static: bool = False
    stamp: int | None = None  # None: a root
    x: float = 0.0
    parent: int = 0
    parent_life: int = 0


Tree = tuple[Frame, ...]
NOTHING: Tree = (Frame(),) * log.N_NAMES


def parent_of(tree: Tree, name: int) -> int | None:
    frame = tree[name]
    if frame.stamp is None:
        return None
    parent = tree[frame.parent]
    return frame.parent if parent.alive and parent.life == frame.parent_life else None


def way_up(tree: Tree, name: int) -> list[int] | None:
    """The frame and all above it; None: a cycle."""
    way = [name]
    while (up := parent_of(tree, way[-1])) is not None:
        if up in way:
            return None
        way.append(up)
    return way


def put(tree: list[Frame], item: log.Item) -> None:
    old, parent = tree[item.child], tree[item.parent]
    static = bool(item.flags & log.STATIC)
    if not static and not old.static and old.stamp is not None and item.stamp < old.stamp:
        return  # late: not the newest
    tree[item.child] = Frame(old.life, True, static, item.stamp, item.x, item.parent, parent.life)


def written(tree: Tree, entry: log.Entry) -> Tree | None:
    """None: it would make a cycle."""
    after = list(tree)
    for item in entry.items:
        for name in (item.child, item.parent):
            if not after[name].alive:
                after[name] = Frame(after[name].life + 1, True)
    for item in entry.items:
        put(after, item)
    done = tuple(after)
    return None if any(way_up(done, item.child) is None for item in entry.items) else done


def set_step(entry: log.Entry) -> Step:
    if entry.status == log.CYCLE:
        return lambda tree: tree if written(tree, entry) is None else None  # type: ignore[arg-type]
    return lambda tree: written(tree, entry)  # type: ignore[arg-type]


def transfer_step(entry: log.Entry) -> Step:
    def step(tree: State) -> State | None:
        after = list(tree)  # type: ignore[call-overload]
        for item in entry.items:
            frame = after[item.child]
            if not frame.alive or frame.stamp is None or frame.x != item.seen_x:
                return None
            after[item.child] = frame._replace(stamp=item.stamp, x=item.x)
        return tuple(after)

    return step


def remove_step(entry: log.Entry) -> Step:
    def step(tree: Tree) -> Tree | None:
        frame = tree[entry.target]
        if entry.status == log.LOOKUP:
            return None if frame.alive else tree
        gone = Frame(frame.life)
        return (*tree[: entry.target], gone, *tree[entry.target + 1 :]) if frame.alive else None

    return step  # type: ignore[return-value]


def clear_step(entry: log.Entry) -> Step:
    keep = bool(entry.flags & log.KEEP_STATIC)

    def step(tree: Tree) -> Tree:
        return tuple(f if f.static and keep else Frame(f.life, f.alive) for f in tree)

    return step  # type: ignore[return-value]


def lookup_is_right(tree: Tree, entry: log.Entry) -> bool:
    if not tree[entry.target].alive or not tree[entry.source].alive:
        return entry.status == log.LOOKUP
    up, down = way_up(tree, entry.source), way_up(tree, entry.target)
    assert up is not None and down is not None, "a state with a cycle"
    meeting = next((name for name in up if name in down), None)
    if meeting is None or entry.status != log.OK:
        return meeting is None and entry.status == log.CONNECTIVITY
    path = up[: up.index(meeting)], down[: down.index(meeting)]
    x = sum(tree[n].x for n in path[0]) - sum(tree[n].x for n in path[1])
    return len(entry.items) == len(path[0]) + len(path[1]) and entry.x == x


def frame_is_right(tree: Tree, entry: log.Entry) -> bool:
    alive = tree[entry.source].alive
    if not alive or entry.status != log.OK:
        return not alive and entry.status == log.LOOKUP
    return entry.kind == log.EXISTS or bool(entry.items[0].child_handle) == (parent_of(tree, entry.source) is not None)


def frames_are_right(tree: Tree, entry: log.Entry) -> bool:
    return len(entry.items) == sum(frame.alive for frame in tree)


RIGHT: dict[int, Callable[[Tree, log.Entry], bool]] = {
    log.LATEST: lookup_is_right,
    log.EXISTS: frame_is_right,
    log.PARENT: frame_is_right,
    log.FRAMES: frames_are_right,
}


def read_step(entries: list[log.Entry]) -> Step:
    return lambda tree: tree if all(RIGHT[e.kind](tree, e) for e in entries) else None  # type: ignore[arg-type]


WRITES = {log.SET: set_step, log.TRANSFER: transfer_step, log.REMOVE: remove_step, log.CLEAR: clear_step}
SAYS_NOTHING = {log.BUSY, log.CONFLICT, log.EXPIRED, log.OLD_DATA}  # the last is about a whole history


def operations(entries: Iterable[log.Entry]) -> list[Operation]:
    """What the entries say, reads of one snapshot as one operation at the moment it was taken."""
    made: list[tuple[log.Entry, list[log.Entry]]] = []
    for entry in entries:
        if entry.kind in WRITES or entry.kind == log.SNAPSHOT:
            made.append((entry, []))
        elif entry.kind not in RIGHT or entry.status in SAYS_NOTHING:
            continue
        elif entry.flags & log.IN_SNAPSHOT:
            assert made[-1][0].kind == log.SNAPSHOT or made[-1][1], "a snapshot comes before what is read in it"
            made[-1][1].append(entry)
        else:
            made.append((entry, [entry]))
    return [operation(entry, reads) for entry, reads in made if entry.status not in SAYS_NOTHING]


def operation(entry: log.Entry, reads: list[log.Entry]) -> Operation:
    name = f"process {entry.process}, order {entry.begin} to {entry.end}, kind {entry.kind}, status {entry.status}"
    write = entry.kind in WRITES
    pure = not write or entry.status not in {log.OK, log.PENDING}
    step = WRITES[entry.kind](entry) if write else read_step(reads)
    if entry.status == log.PENDING:
        return Operation(entry.begin, entry.time or None, step, name, maybe=True)
    return Operation(entry.begin, entry.end, step, name, pure)
