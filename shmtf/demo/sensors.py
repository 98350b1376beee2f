# SPDX-License-Identifier: Apache-2.0
"""`python -m shmtf.demo.sensors KIND --store NAME`: one sensor, writing all its edges in one commit per report."""

from __future__ import annotations

import time
from collections.abc import Sequence

import shmtf

from . import child
from .world import Track

_LATE = 50_000_000  # further behind (stopped, or starved), a sensor goes on with the present


def main(argv: Sequence[str] | None = None) -> None:
    """Report for ever."""
    parser = child.parser("sensors")
    parser.add_argument("kind")
    args = parser.parse_args(argv)
    child.begin(args)
    world = child.world(args)
    if args.kind not in world.tracks:
        parser.error(f"KIND is one of {', '.join(world.tracks)}")
    track = world.tracks[args.kind]
    with shmtf.Store.attach(args.store, timeout=10.0, authority=track.name) as store:
        for _, frame in track.edges:
            store.declare_frame(frame, rate=1.2 * track.rate)
        write(store, track)


def write(store: shmtf.Store, track: Track) -> None:
    """Every report when it is due."""
    stamp = track.latest_stamp(shmtf.now())
    while True:
        poses = track.poses(stamp)
        store.set_transforms(
            shmtf.Transform(parent, frame, stamp, pose[:3], pose[3:])
            for (parent, frame), pose in zip(track.edges, poses, strict=True)
        )
        stamp = track.next_stamp(stamp)
        if stamp < shmtf.now() - _LATE:
            stamp = max(stamp, track.latest_stamp(shmtf.now()))
        while (left := stamp - shmtf.now()) > 0:
            time.sleep(left / 1e9)


if __name__ == "__main__":
    main()
