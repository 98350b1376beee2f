# SPDX-License-Identifier: Apache-2.0
"""Is there any serial order at all?  An exhaustive search that believes no version, for short histories.

An operation is an interval and a function from a state to the next one, or to None where its answer would have been
another. A history is strictly serialisable if one moment can be chosen in each interval such that the operations,
done one after the other in the order of these moments, all give the answers they gave. (Papadimitriou 1979; for one
operation on one object this is linearisability, Herlihy and Wing 1990.)

The search is that of Wing and Gong ("Testing and verifying concurrent objects", 1993) with Lowe's two additions
("Testing for linearizability", 2017): an operation takes effect no earlier than it must, namely before some operation
ends ("just in time"), and of two searches that have come to the same state with the same operations done one is
dropped. A pure read that fits is done at once: it changes nothing for the others. What its process did not survive
took effect before that death or never.

Unlike a search for cycles among versions (Adya 1999; Kingsbury and Alvaro's Elle, 2020) it needs no theory of who
wrote what before whom, so it shares no assumption with replay.c, which takes the store's own versions as the order.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Mapping
from dataclasses import dataclass

State = Hashable
Step = Callable[[State], "State | None"]


@dataclass(frozen=True)
class Operation:
    begin: int
    end: int | None  # None: later than all others
    step: Step
    name: str = ""
    pure: bool = False  # changes no state
    maybe: bool = False  # or it never happened


def registers(reads: Mapping[str, object] = {}, writes: Mapping[str, object] = {}) -> Step:
    """A transaction over named registers, None at first: what it read, then what it wrote."""

    def step(state: State) -> State | None:
        values = dict(state)  # type: ignore[call-overload]
        if any(values.get(key) != value for key, value in reads.items()):
            return None
        return frozenset({**values, **writes}.items())

    return step


class Search:
    """Moments in their order; `front` holds every (operations under way that are done, state) that is possible."""

    def __init__(self, operations: Iterable[Operation], start: State) -> None:
        self.operations = list(operations)
        self.front: set[tuple[frozenset[int], State]] = {(frozenset(), start)}
        self.under_way: set[int] = set()
        self.visited = 0

    def moments(self) -> list[tuple[int, int, bool]]:
        begins = [(op.begin, i, False) for i, op in enumerate(self.operations)]
        ends = [(op.end, i, True) for i, op in enumerate(self.operations) if op.end is not None]
        return sorted([*begins, *ends])

    def read_what_fits(self, done: frozenset[int], state: State) -> frozenset[int]:
        fits = {
            i for i in self.under_way - done if self.operations[i].pure and self.operations[i].step(state) is not None
        }
        return done | fits

    def until_done(self, last: int) -> set[tuple[frozenset[int], State]]:
        """All ways to go on to where operation `last` is done."""
        found, stack = set(), [(self.read_what_fits(done, state), state) for done, state in self.front]
        seen = set(stack)
        while stack:
            done, state = stack.pop()
            self.visited += 1
            if last in done:
                found.add((done - {last}, state))
                continue
            for i in self.under_way - done:
                after = self.operations[i].step(state)
                if after is None:
                    continue
                way = (self.read_what_fits(done | {i}, after), after)
                if way not in seen:
                    seen.add(way)
                    stack.append(way)
        return found

    def first_impossible(self) -> Operation | None:
        """The operation at whose end no serial order is left; None: the history is strictly serialisable."""
        for _, i, ends in self.moments():
            if not ends:
                self.under_way.add(i)
                continue
            without = self.front if self.operations[i].maybe else set()
            self.front = without | self.until_done(i)
            self.under_way.discard(i)
            if not self.front:
                return self.operations[i]
        return None


def first_impossible(operations: Iterable[Operation], start: State = frozenset()) -> Operation | None:
    return Search(operations, start).first_impossible()
