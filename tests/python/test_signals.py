# SPDX-License-Identifier: Apache-2.0
"""Signals while waiting: Ctrl-C ends every wait, a handler that returns ends none."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from shmtf import Store

WAITS = {
    "lookup": "store.lookup_transform('map', 'none', timeout=None)",
    "latest": "store.lookup_latest_transform('map', 'none', timeout=1000)",
    "can": "store.can_transform('map', 'none', timeout=None)",
    "change": "store.wait_for_change()",
    "change of": "store.wait_for_change('none', timeout=1000)",
    "attach": "shmtf.Store.attach(store.name + '-none', timeout=None)",
}


@pytest.mark.parametrize("readonly", [False, True])
@pytest.mark.parametrize("wait", WAITS)
def test_ctrl_c_ends_every_wait(store: Store, interrupt: Callable, wait: str, readonly: bool) -> None:
    code = f"""
        import os, signal, sys, threading, time, shmtf
        signal.signal(signal.SIGINT, signal.default_int_handler)
        store = shmtf.Store.attach({store.name!r}, readonly={readonly})
        print("ready", flush=True)
        try:
            {WAITS[wait]}
        except KeyboardInterrupt:
            store.frames()
            print("interrupted")
    """
    interrupt(code)


def test_a_signal_handler_that_returns_does_not_end_a_wait(store: Store, run_python: Callable) -> None:
    run_python(
        """
        import signal, sys, shmtf
        store = shmtf.Store.attach(sys.argv[1])
        ticks = []
        def tick(*_):
            ticks.append(1)
            if len(ticks) == 20:
                store.set_transform(shmtf.Transform("map", "base", 1))
        signal.signal(signal.SIGALRM, tick)
        signal.setitimer(signal.ITIMER_REAL, 0.005, 0.005)
        assert store.lookup_transform("map", "base", timeout=None).stamp == 1
        assert len(ticks) >= 20
        try:
            store.wait_for_change("base", timeout=0.1)
        except shmtf.TimeoutException as error:
            assert error.waited >= 0.1, error.waited
        signal.setitimer(signal.ITIMER_REAL, 0)
        """,
        store.name,
    )


def test_an_exception_of_a_signal_handler_ends_a_wait(store: Store, run_python: Callable) -> None:
    run_python(
        """
        import signal, sys, shmtf
        store = shmtf.Store.attach(sys.argv[1])
        def ring(*_):
            raise KeyError("rung")
        signal.signal(signal.SIGALRM, ring)
        signal.setitimer(signal.ITIMER_REAL, 0.01)
        try:
            store.lookup_transform("map", "base", timeout=None)
        except KeyError as error:
            assert error.args == ("rung",)
        store.set_transform(shmtf.Transform("map", "base", 1))
        """,
        store.name,
    )


def test_ctrl_c_ends_the_wait_for_a_busy_frame(store: Store, interrupt: Callable, held: object) -> None:
    interrupt(f"""
        import signal, shmtf
        signal.signal(signal.SIGINT, signal.default_int_handler)
        store = shmtf.Store.attach({store.name!r})
        print("ready", flush=True)
        try:
            store.set_transform(shmtf.Transform("map", "held", 2**40), timeout=None)
        except KeyboardInterrupt:
            store.frames()
            print("interrupted")
    """)
