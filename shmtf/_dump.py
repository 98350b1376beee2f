# SPDX-License-Identifier: Apache-2.0
"""The tree as text, with the keys and labels of tf2's tools."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .snapshot import FrameInfo


def _yaml_quote(text: str) -> str:
    """A double-quoted YAML scalar, whatever the name."""

    def escape(c: str) -> str:
        if c in '"\\':
            return "\\" + c
        if c.isprintable():
            return c
        code = ord(c)
        return f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}" if code < 0x10000 else f"\\U{code:08x}"

    return '"' + "".join(map(escape, text)) + '"'


def _dot_quote(text: str) -> str:
    """Inside a double-quoted DOT string: control characters are shown, not sent to a terminal."""
    shown = "".join(c if c.isprintable() else f"\\x{ord(c):02x}" for c in text)
    return shown.replace("\\", "\\\\").replace('"', '\\"')


def _seconds(ns: int | None) -> str:
    ns = ns or 0
    return f"{'-' if ns < 0 else ''}{abs(ns) // 10**9}.{abs(ns) % 10**9:09d}"


def _span(info: FrameInfo) -> float:
    if info.oldest is None or info.newest is None:
        return 0.0
    return (info.newest - info.oldest) / 10**9


def as_yaml(infos: Iterable[FrameInfo]) -> str:
    lines = []
    for info in infos:
        if info.parent is None:
            continue
        lines += [
            f"{_yaml_quote(info.name)}:",
            f"  parent: {_yaml_quote(info.parent)}",
            f"  broadcaster: {_yaml_quote(info.authority)}",
            f"  rate: {info.rate or 0.0:.3f}",
            f"  most_recent_transform: {_seconds(info.newest)}",
            f"  oldest_transform: {_seconds(info.oldest)}",
            f"  buffer_length: {_span(info):.3f}",
        ]
    return "\n".join(lines) + "\n" if lines else "{}\n"


def as_dot(infos: Iterable[FrameInfo]) -> str:
    lines = ["digraph G {"]
    for info in infos:
        name = _dot_quote(info.name)
        if info.parent is None:
            lines.append(f'"{name}";')
            continue
        label = [f"Broadcaster: {_dot_quote(info.authority)}"]
        if info.is_static:
            label.append("Static")
        else:
            label.append(f"Average rate: {info.rate or 0.0:.3f} Hz")
            label.append(f"Most recent transform: {_seconds(info.newest)}")
            label.append(f"Buffer length: {_span(info):.3f} sec")
        text = "\\n".join(label)
        lines.append(f'"{_dot_quote(info.parent)}" -> "{name}"[label="{text}\\n"];')
    lines.append("}")
    return "\n".join(lines) + "\n"
