# SPDX-License-Identifier: Apache-2.0
"""A demonstration with many processes: `python -m shmtf.demo`.

Sensors and planners are processes of their own that share one store.  Planners check every answer they get against
mathematics that shares no code with the store.

    poses        poses as plain tuples: the independent mathematics
    world        what moves, and who reports it: the interface of the two that follow
    simulation   a mobile manipulator that is a pure function of time
    recordings   real recordings, played again
    bvh          reads the recorded person
    checker      compares the store's answers with a world
    sensors      one process per sensor
    planners     one process per planner
    processes    starting, killing, stopping, and leaving none behind
    stage        the play itself
    board        what it looks like
"""
