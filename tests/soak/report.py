# SPDX-License-Identifier: Apache-2.0
"""What the long run says at its end."""

from __future__ import annotations

from dataclasses import dataclass, field

import board as boards
from board import COUNTERS, OPS, Board, quantile_ns


@dataclass
class Chaos:
    """What was done to the members."""

    seconds: float = 0.0
    kills: int = 0
    killed_while_stopped: int = 0
    stops: int = 0
    bursts: int = 0
    lives_beside: int = 0
    problems: list[str] = field(default_factory=list)
    memory: list[str] = field(default_factory=list)
    left: list[str] = field(default_factory=list)  #: what was looked at in the end, and found in order


def duration(ns: int | None) -> str:
    if ns is None:
        return "none"
    for unit, size in (("s", 10**9), ("ms", 10**6), ("us", 10**3)):
        if ns >= size:
            return f"{ns / size:.2f} {unit}"
    return f"{ns} ns"


def add(rows: list[list[int]]) -> list[int]:
    return [sum(column) for column in zip(*rows, strict=True)]


def text(board: Board, chaos: Chaos, seed: int, members: int) -> str:
    ops = add([cell.ops for cell in board.cells])
    counters = dict(zip(COUNTERS, add([cell.counters for cell in board.cells]), strict=True))
    reads, writes = add([cell.reads for cell in board.cells]), add([cell.writes for cell in board.cells])
    worst = [max(column) for column in zip(*(cell.worst for cell in board.cells), strict=True)]
    lines = [f"{chaos.seconds:.1f} s, {members} processes at a time, seed {seed}", "", "operations"]
    lines += [f"  {n:>14,}  {name}" for name, n in zip(OPS, ops, strict=True)]
    lines += [f"  {sum(ops):>14,}  all together", "", "what was done to them"]
    lines += [
        f"  {chaos.kills:>14,}  SIGKILL, of which {chaos.killed_while_stopped:,} while stopped",
        f"  {chaos.stops:>14,}  SIGSTOP and SIGCONT",
        f"  {chaos.bursts:>14,}  bursts, in which most were killed or stopped at once",
        f"  {chaos.lives_beside:>14,}  lives of the store beside: made, written, unlinked",
        "",
        "what the stores counted, as far as the killed could still say it",
    ]
    lines += [f"  {counters[name]:>14,}  {name.replace('_', ' ')}" for name in COUNTERS]
    lines += [
        "",
        "times, of calls whose own process was not stopped; they include waiting for a processor",
        f"  a read: p50 {duration(quantile_ns(reads, 0.5))}, p99.9 {duration(quantile_ns(reads, 0.999))}, "
        f"worst {duration(worst[0])}; the worst in processor time {duration(worst[1])}",
        f"  a write: p50 {duration(quantile_ns(writes, 0.5))}, p99.9 {duration(quantile_ns(writes, 0.999))}, "
        f"worst {duration(worst[2])}; they also wait for frames of stopped writers",
        f"  snapshots whose records were overwritten before all was read: {ops[boards.EXPIRED]:,}",
        "",
        "memory of readers that were never killed",
        *(f"  {line}" for line in chaos.memory or ["too short a run to tell"]),
        "",
        "in the end",
        *(f"  {line}" for line in chaos.left),
        "",
    ]
    lines += [f"VIOLATION: {problem}" for problem in chaos.problems]
    lines.append(f"{len(chaos.problems)} violations, seed {seed}" if chaos.problems else "no violation")
    return "\n".join(lines)
