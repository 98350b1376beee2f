# SPDX-License-Identifier: Apache-2.0
"""The exceptions.

Two trees: `TransformException` for answers about transforms and for wrong arguments, `StoreError` for the store
itself.  Failure detail is data: every exception carries fields, which pickle, and makes its message from them when
somebody reads it.
"""

from __future__ import annotations

import difflib
import errno

from ._detail import Detail, quote, seconds, short

__all__ = [
    "BackwardExtrapolationException",
    "BackwardExtrapolationTimeout",
    "BusyError",
    "ClosedError",
    "ConflictError",
    "ConnectivityException",
    "ConnectivityTimeout",
    "CycleError",
    "ExtrapolationException",
    "ForwardExtrapolationException",
    "ForwardExtrapolationTimeout",
    "InvalidArgumentException",
    "LookupException",
    "LookupTimeout",
    "NoDataForExtrapolationException",
    "NoDataTimeout",
    "OldDataError",
    "ReadOnlyStoreError",
    "SnapshotExpiredError",
    "StoreCorruptError",
    "StoreError",
    "StoreExistsError",
    "StoreFullError",
    "StoreNotFoundError",
    "StoreNotReadyError",
    "StorePermissionError",
    "StoreVersionError",
    "TimeoutException",
    "TransformException",
]


# ---- answers about transforms ----


class TransformException(Detail):
    """No transform can be given, or the arguments are wrong."""


class LookupException(TransformException):
    """A frame does not exist.  Fields: frame, target, source."""

    _known: tuple[str, ...] = ()  # the frames that exist, for the suggestion

    def _sentence(self) -> str:
        where = f" in store {quote(self.store)}" if self.store else ""
        return f"frame {quote(self.frame)} does not exist{where}"

    def _advice(self) -> str | None:
        if self.hint or self.frame is None:
            return self.hint
        near = difflib.get_close_matches(self.frame, self._known, 1, 0.5)
        return f"did you mean {quote(near[0])}?" if near else "frames() lists those that do"


class ConnectivityException(TransformException):
    """Both frames exist, no path joins them.  Fields: target, source, roots."""

    _help = "a transform between the two trees is missing; all_frames_as_dot() draws them"

    def _sentence(self) -> str:
        text = f"no path joins {quote(self.target)} and {quote(self.source)}"
        if self.roots:
            text += f", their roots are {quote(self.roots[0])} and {quote(self.roots[1])}"
        return f"{text}: {self.what}" if self.what else text

    def _asked(self) -> str:
        return ""


class ExtrapolationException(TransformException):
    """The time lies outside the records of an edge.  Fields: edge, requested, oldest, newest (nanoseconds)."""

    def _place(self) -> str:
        if self.edge is not None:
            return f"edge {quote(self.edge[0])} -> {quote(self.edge[1])}"
        return f"frame {quote(self.frame)}"

    def _compare(self, text: str, available: int | None) -> str:
        if self.requested is None or available is None:
            return f"{self._place()}: {text}"
        gap = abs(self.requested - available)
        return (
            f"{self._place()}: asked for {seconds(self.requested)}, {text} {seconds(available)}, "
            f"{gap} ns {'earlier' if available < self.requested else 'later'}"
        )


class BackwardExtrapolationException(ExtrapolationException):
    """The time is before the oldest record of an edge."""

    _help = "keep more history (cache_time, history or declare_frame), or ask for a later time"

    def _sentence(self) -> str:
        return self._compare("its oldest record is at", self.oldest)


class ForwardExtrapolationException(ExtrapolationException):
    """The time is after the newest record of an edge."""

    _help = "pass timeout= to wait for it, time=None for the newest common time, or use lookup_latest_transform()"

    def _sentence(self) -> str:
        return self._compare("its newest record is at", self.newest)


class NoDataForExtrapolationException(ExtrapolationException):
    """The edge has one record only, at another time."""

    _help = "a second record is needed to interpolate, or write it as static"

    def _sentence(self) -> str:
        return self._compare("its only record is at", self.newest)


class InvalidArgumentException(TransformException, ValueError):
    """An argument is wrong; nothing was changed.  Fields: what, value, item, hint."""

    def _sentence(self) -> str:
        place = ""
        if self.edge is not None:
            place = f" (edge {quote(self.edge[0])} -> {quote(self.edge[1])})"
        elif self.frame is not None:
            place = f" (frame {quote(self.frame)})"
        value = "" if self.value is None else f": {short(self.value)}"
        limit = f" (at most {self.limit})" if self.limit else ""
        return f"invalid {self.what or 'argument'}{place}{value}{limit}"


class CycleError(InvalidArgumentException):
    """The new parent is a descendant of the frame.  Fields: edge, item."""

    _help = "the tree would have a loop; chain() shows how the two are joined"

    def _sentence(self) -> str:
        if self.edge is None:
            return f"the path from frame {quote(self.frame)} has a loop"
        parent, child = map(quote, self.edge)
        return f"{parent} cannot be the parent of {child}, it is a descendant of it"


class OldDataError(InvalidArgumentException):
    """The record is more than cache_time behind its frame's newest.  Fields: edge, requested, newest, item."""

    _help = "nothing of the batch was written; after a jump of time, clear()"

    def _sentence(self) -> str:
        place = quote(self.edge[1] if self.edge else self.frame)
        if self.requested is None or self.newest is None:
            return f"the record of frame {place} is older than cache_time"
        return (
            f"the record of frame {place} at {seconds(self.requested)} is older than cache_time: it is "
            f"{self.newest - self.requested} ns behind the newest, at {seconds(self.newest)}"
        )


class TimeoutException(TransformException, TimeoutError):
    """A wait ended without its event.  Fields: waited; of wait_for_change also version, the next `since`."""

    _code = errno.ETIMEDOUT

    def _sentence(self) -> str:
        return self.what or "no change"


class LookupTimeout(LookupException, TimeoutException):
    """The frame still did not exist when the timeout passed."""


class ConnectivityTimeout(ConnectivityException, TimeoutException):
    """There still was no path when the timeout passed."""


class ForwardExtrapolationTimeout(ForwardExtrapolationException, TimeoutException):
    """The data still had not come when the timeout passed."""

    _help = "the writer of that edge is late or gone: frame_info() shows its authority and age"


class BackwardExtrapolationTimeout(BackwardExtrapolationException, TimeoutException):
    """The data still had not come when the timeout passed."""


class NoDataTimeout(NoDataForExtrapolationException, TimeoutException):
    """The second record still had not come when the timeout passed."""


# ---- answers about the store ----


class StoreError(Detail):
    """The store cannot do it.  Fields: store, what, syserrno."""

    def _sentence(self) -> str:
        where = f"store {quote(self.store)}: " if self.store else ""
        return where + (self.what or type(self).__doc__ or "").split("  ")[0].rstrip(".")


class StoreExistsError(StoreError, FileExistsError):
    """The name is taken."""

    _code = errno.EEXIST
    _help = "attach() to it, pass exist_ok=True, or unlink() it"


class StoreNotFoundError(StoreError, FileNotFoundError):
    """There is no store of that name."""

    _code = errno.ENOENT
    _help = "shmtf.list_stores() lists those that exist; attach(timeout=...) waits for one"


class StoreNotReadyError(StoreNotFoundError):
    """Its creator is still making it."""

    _help = "attach(timeout=...) waits for it"


class StorePermissionError(StoreError, PermissionError):
    """The permission bits of the store refuse it."""

    _code = errno.EACCES
    _help = "it was created with another mode or by another user; readonly=True needs only read permission"


class StoreVersionError(StoreError):
    """It is no store, or one of another version of the format."""


class StoreCorruptError(StoreError):
    """A word in the segment is impossible."""

    _help = "make the store anew"


class StoreFullError(StoreError):
    """A capacity is exhausted.  Fields: what, limit, needed."""

    _help = "create the store with a larger capacity"

    def _sentence(self) -> str:
        text = super()._sentence()
        if self.needed:
            text += f", {self.needed} needed"
        if self.limit:
            text += f", {self.limit} there"
        return text


class ReadOnlyStoreError(StoreError):
    """The store is mapped for reading only."""

    _help = "attach it without readonly=True to write"


class BusyError(StoreError):
    """Another live writer holds a frame.  Fields: frame, holder, holder_slot, holder_pid, waited."""

    _help = "a holder that stays is stopped (a debugger?) and keeps its frames; other frames go on"

    def _sentence(self) -> str:
        frame = self.edge[1] if self.edge else self.frame
        who = f"{quote(self.holder or '?')} (process {self.holder_pid}, writer slot {self.holder_slot})"
        return f"frame {quote(frame)} is held by {who}, seen for {self.waited or 0:.3f} s"


class ConflictError(StoreError):
    """What a transaction read has changed."""


class SnapshotExpiredError(StoreError):
    """The records of that commit were overwritten."""

    _help = "take a new snapshot()"


class ClosedError(StoreError):
    """The store or snapshot is closed."""
