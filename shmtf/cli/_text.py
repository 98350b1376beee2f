# SPDX-License-Identifier: Apache-2.0
"""A report as text for people: the tree, one frame, records."""

from __future__ import annotations

from collections.abc import Iterator

from ._common import Style, crop, printable, rate, size, span, stamp, table, width
from ._report import Flag, Frame, Report, Writer

_MAX_DEAD = 8  # writers that are listed by name; the rest is counted
_LEAST_TREE = 24  # columns
_MAX_NAMES = 4  # frames, likewise


def counted(n: int, what: str) -> str:
    """1 frame, 2 frames."""
    return f"{n:,} {what}{'' if n == 1 else 's'}"


def header(report: Report, style: Style) -> list[str]:
    info = report.store
    alive = sum(w.alive for w in report.writers)
    dead = len(report.writers) - alive
    n_frames = len(report.frames) + len(report.unread)
    cache = "records never expire" if info["cache_time_ns"] is None else f"cache {span(info['cache_time_ns'] / 1e9)}"
    title = f'store "{printable(report.name)}"'
    first = "   ".join([
        style.bold(title),
        size(info["size_bytes"]),
        counted(report.commit, "commit"),
        f"{n_frames:,} of {info['max_frames']:,} frames",
        f"writers: {alive} alive" + (f", {dead} dead" if dead else ""),
    ])  # fmt: skip
    kept = info["n_chunks"] - info["n_chunks_free"]
    second = "   ".join([
        f"made {span((report.now - info['created']) / 1e9)} ago",
        cache,
        f"history {info['history']:,} records",
        f"memory for rings {kept / max(1, info['n_chunks']):.0%} used",
        f"format {info['format']}",
    ])  # fmt: skip
    return [first, style.dim(second), ""]


# ---- tree ----


def _walk(report: Report) -> Iterator[tuple[str, Frame]]:
    """Every frame once, with the lines that lead to it, parents first."""
    children: dict[str | None, list[Frame]] = {}
    names = {frame.info.name for frame in report.frames}
    for frame in report.frames:
        parent = frame.info.parent if frame.info.parent in names else None
        children.setdefault(parent, []).append(frame)
    seen: set[str] = set()
    for root in children.get(None, []) + report.frames:  # the latter: loops, which only a mixed reading can show
        stack = [("", "", root)]
        while stack:
            indent, branch, frame = stack.pop()
            if frame.info.name in seen:
                continue
            seen.add(frame.info.name)
            yield indent + branch, frame
            below = indent + {"": "", "├─ ": "│  ", "└─ ": "   "}[branch]
            ours = children.get(frame.info.name, [])
            stack += reversed([(below, "└─ " if child is ours[-1] else "├─ ", child) for child in ours])


def flag_words(flag: Flag) -> str:
    """Who holds a frame, in a few words."""
    if flag.owner is None:
        return "free"
    return (
        f'"{printable(flag.owner.name)}" (slot {flag.owner.slot}, process {flag.owner.pid}, {writer_state(flag.owner)})'
    )


def writer_state(writer: Writer) -> str:
    if not writer.alive:
        return "dead"
    return "alive, stopped" if writer.process == "stopped" else "alive"


def tree(report: Report, style: Style, columns: int, rates: dict[str, float] | None = None) -> list[str]:
    """rates: records per second as seen by a watcher, instead of those of the kept records."""
    rows = [[style.dim(t) for t in ("frame", "kind", "rate", "age", "records", "last writer")]]
    notes = _stuck(report, style)
    for guide, frame in _walk(report):
        info = frame.info
        place, who = style.dim(guide) + printable(info.name), printable(info.authority) if info.n_records else ""
        if frame.kind == "dynamic":
            hz = info.rate if rates is None else rates.get(info.name)
            kept = f"{info.n_records:,}/{info.capacity:,}"
            rows.append([place, frame.kind, rate(hz), span(info.age), kept, who])
        else:
            rows.append([place, frame.kind, "", "", "", who])
    others = sum(2 + max(width(row[i]) for row in rows) for i in range(1, 6))
    for row in rows:
        row[0] = crop(row[0], max(_LEAST_TREE, columns - others))
    lines = header(report, style) + table(rows, "<<>>><")
    if not report.frames:
        lines.append("no frames yet")
    if report.unread:
        notes.append(f"changing too fast to be read: {', '.join(map(printable, report.unread))}")
    if not report.one_commit:
        notes.append("the tree changes too fast to be read at one commit: frames are of neighbouring commits")
    return lines + (["", *notes] if notes else []) + [""] + writers(report, style)


def _stuck(report: Report, style: Style) -> list[str]:
    """Frames whose holder is dead or stopped, a line per holder."""
    held: dict[Writer, list[str]] = {}
    for frame in report.frames:
        if frame.flag.owner is not None and frame.flag.stuck:
            held.setdefault(frame.flag.owner, []).append(printable(frame.info.name))
    lines = []
    for owner, names in held.items():
        some = ", ".join(names[:_MAX_NAMES]) + (
            f" and {len(names) - _MAX_NAMES} more" if len(names) > _MAX_NAMES else ""
        )
        hint = "other writers of it wait, readers do not" if owner.alive else "the next writer clears it"
        lines.append(style.bad(f"held by {flag_words(Flag(owner))}: {some}; {hint}"))
    return lines


def writers(report: Report, style: Style) -> list[str]:
    alive = [w for w in report.writers if w.alive]
    dead = sorted((w for w in report.writers if not w.alive), key=lambda w: -w.started)
    if not report.writers:
        return [style.dim("no writer yet")]
    rows = [[style.dim(t) for t in ("writer", "slot", "process", "state", "writing for")]]
    for w in alive + dead[:_MAX_DEAD]:
        state = writer_state(w)
        since = span((report.now - w.started) / 1e9) if w.alive else ""
        rows.append([
            printable(w.name),
            str(w.slot),
            str(w.pid),
            state if state == "alive" else style.bad(state) if w.alive else style.dim(state),
            since,
        ])  # fmt: skip
    more = [style.dim(f"and {len(dead) - _MAX_DEAD} more dead")] if len(dead) > _MAX_DEAD else []
    return table(rows, "<>><>") + more


# ---- one frame ----


def _word_rows(report: Report, frame: Frame, style: Style) -> list[list[str]]:
    """What the frame's words mean, and the words as they stand."""
    info, words = frame.info, frame.words
    flag = f"held by {flag_words(frame.flag)}, transaction {frame.flag.transaction:,}" if frame.flag.owner else "free"
    tag = f"commit {info.version:,}" if info.n_records else "no record"
    if info.n_records and words and words["newest_tag"] != info.version:
        tag += " (a later one is on its way, or came meanwhile)"
    rows = [
        ("writer flag", style.bad(flag) if frame.flag.stuck else flag, "lock"),
        ("newest tag", tag, "newest_tag"),
        ("commit word", f"commit {report.commit:,} is the store's last", "commit"),
        ("head", f"{info.n_written:,} records ever written", "head"),
        ("pending", "the head if the holder commits" if words.get("locked") else "nothing", "pending"),
    ]
    return [[style.dim(a), b, style.dim(f"{words[word]:#018x}") if words else ""] for a, b, word in rows]


def frame_page(report: Report, style: Style) -> list[str]:
    frame = report.frames[0] if report.frames else None
    if frame is None:
        return [f"changing too fast to be read: {', '.join(map(printable, report.unread))}"]
    info = frame.info
    rows = [
        ["parent", printable(info.parent) if info.parent is not None else "none: a root"],
        ["kind", frame.kind],
        ["generation", f"{info.generation} (lives of this frame's id)"],
        ["ring capacity", f"{info.capacity:,} records, {info.n_records:,} of them readable now"],
    ]
    if info.newest is not None and info.oldest is not None:
        rate_text = f" at {rate(info.rate)}" if info.rate is not None else ""
        rows += [
            ["stamps", f"{stamp(info.oldest)} .. {stamp(info.newest)}"],
            ["", f"{span((info.newest - info.oldest) / 1e9)}{rate_text}; the newest is {span(info.age)} old"],
        ]
    if info.arrival is not None:
        rows.append(["last writer", f'"{printable(info.authority)}", {span((report.now - info.arrival) / 1e9)} ago'])
    if frame.records:
        newest = frame.records[0]
        for label, axes in (("translation", "xyz"), ("rotation", "xyzw")):
            rows.append([label, "  ".join(f"{a} {v:+.6f}" for a, v in zip(axes, newest[label], strict=True))])
    title = f'frame "{printable(info.name)}" of store "{printable(report.name)}"'
    about = table(([style.dim(a), b] for a, b in rows), "<<")
    return [style.bold(title), "", *table(_word_rows(report, frame, style), "<<<"), "", *about]


# ---- records ----


def records_page(report: Report, style: Style) -> list[str]:
    lines = header(report, style)
    for frame in report.frames:
        info = frame.info
        if not frame.records:
            continue
        where = f"in {printable(info.parent)}" if info.parent is not None else "without a parent"
        note = f"   {frame.kind}, {info.n_records:,} of {info.capacity:,} records"
        lines.append(style.bold(printable(info.name)) + f" {where}" + style.dim(note))
        rows = [[style.dim(t) for t in ("stamp", "age", "x", "y", "z", "qx", "qy", "qz", "qw", "commit", "writer")]]
        for r in frame.records:
            age = "" if r["is_static"] else span((report.now - r["stamp"]) / 1e9)
            numbers = [f"{v:.4f}" for v in (*r["translation"], *r["rotation"])]
            rows.append([stamp(r["stamp"]), age, *numbers, str(r["version"]), printable(r["authority"])])
        lines += ["  " + line for line in table(rows, ">>>>>>>>>><", " ")] + [""]
    return lines[:-1] if lines[-1] == "" else lines
