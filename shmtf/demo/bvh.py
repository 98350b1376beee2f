# SPDX-License-Identifier: Apache-2.0
"""Reads Biovision Hierarchy files: a skeleton and its motion."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from .poses import Pose, about, pose, quaternion_product


@dataclass(frozen=True)
class Joint:
    """A joint: where it sits in its parent, and the channels that move it."""

    name: str
    parent: str | None
    offset: tuple[float, float, float]
    channels: tuple[str, ...]


@dataclass(frozen=True)
class Motion:
    """Joints, parents first, and their channel values by frame; file units and degrees."""

    joints: tuple[Joint, ...]
    frame_ns: int
    frames: tuple[tuple[float, ...], ...]

    def poses(self, frame: int, scale: float) -> tuple[Pose, ...]:
        """T_parent_joint of every joint; lengths are multiplied by `scale`."""
        values = iter(self.frames[frame])
        out = []
        for joint in self.joints:
            position = dict(zip("XYZ", joint.offset, strict=True))
            rotation = (0.0, 0.0, 0.0, 1.0)
            for channel in joint.channels:
                value = next(values)
                if channel.endswith("position"):
                    position[channel[0]] += value
                else:  # in the order listed, each about the axes that the ones before have turned
                    rotation = quaternion_product(rotation, about(channel[0].lower(), math.radians(value)))
            out.append(pose(position["X"] * scale, position["Y"] * scale, position["Z"] * scale, rotation))
        return tuple(out)


def read(path: Path) -> Motion:
    """The motion in a file.  Raises ValueError with the place where it stops being BVH."""
    words = path.read_text(encoding="ascii").split()
    try:
        at = words.index("MOTION")
        joints = _joints(words[:at])
        if words[at + 1] != "Frames:" or words[at + 3 : at + 5] != ["Frame", "Time:"]:
            raise ValueError("no 'Frames:' and 'Frame Time:' after MOTION")
        n_frames, seconds = int(words[at + 2]), float(words[at + 5])
        values = tuple(map(float, words[at + 6 :]))
    except (ValueError, IndexError) as error:
        raise ValueError(f"{path.name} is not BVH: {error}") from None
    width = sum(len(joint.channels) for joint in joints)
    if len(values) != n_frames * width:
        raise ValueError(f"{path.name}: {len(values)} numbers, not {n_frames} frames of {width}")
    frames = tuple(values[i * width : (i + 1) * width] for i in range(n_frames))
    return Motion(tuple(joints), round(seconds * 10**9), frames)


def _joints(words: list[str]) -> list[Joint]:
    joints: list[Joint] = []
    above: list[str | None] = []  # the names of the open braces; None: an end site
    name: str | None = None
    i = 1 if words[:1] == ["HIERARCHY"] else 0
    while i < len(words):
        word = words[i]
        if word in ("ROOT", "JOINT"):
            name, i = words[i + 1], i + 2
        elif word == "End" and words[i + 1] == "Site":
            name, i = None, i + 2
        elif word == "{":
            above.append(name)
            i += 1
        elif word == "}":
            above.pop()
            i += 1
        elif word == "OFFSET":
            x, y, z = map(float, words[i + 1 : i + 4])
            if name is not None:
                joints.append(Joint(name, above[-2] if len(above) > 1 else None, (x, y, z), ()))
            i += 4
        elif word == "CHANNELS":
            n = int(words[i + 1])
            last = joints.pop()
            joints.append(Joint(last.name, last.parent, last.offset, tuple(words[i + 2 : i + 2 + n])))
            i += 2 + n
        else:
            raise ValueError(f"unexpected {word!r}")
    return joints
