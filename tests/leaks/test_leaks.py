# SPDX-License-Identifier: Apache-2.0
"""Every function of the binding, called many times, on success and on each way to fail: nothing may be left behind.

What is counted grows by at least one a call if one small thing is forgotten in each: Python's blocks, the C library's
bytes, pages of address space, mappings, descriptors, threads, and references to what the call was given and to what is
shared by all. Noise is told from a leak by repeating (psutil's habit): a leak grows every time. Which functions there
are is asked of the module, so a new one without a test fails here. Tier: test.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import inspect
import os
import pickle
import sys
import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest

import shmtf
from shmtf import Store, Transform, _core

from ..python.hostile import Planted, Raises
from ..python.hostile_calls import CALLS, World, good_argument

CALLS_A_ROUND = 40
ROUNDS = 6
ALLOWED = (
    *(shmtf.TransformException, shmtf.StoreError, TypeError, ValueError, OverflowError, Planted, AttributeError),
    ModuleNotFoundError,
)
BAD: dict[str, Callable[[], Any]] = {
    "an object": object,
    "raises": Raises,
    "nobody": lambda: "nobody",
    "a number too large": lambda: 10**400,
    "no number": lambda: float("nan"),
    "a bad name": lambda: "\ud800",
    "a list of one": lambda: ["map"],
}
SLOW = {"shmtf.store_info"}  # it asks every process of the machine; what it calls of the binding is called below
MAKES_STORES = ("Store.create", "Store.attach", "Store._open", "shmtf._core.Store", "shmtf._core.format_fd")


class _Mallinfo(ctypes.Structure):
    _fields_ = [
        (name, ctypes.c_size_t)
        for name in [
            "arena",
            "ordblks",
            "smblks",
            "hblks",
            "hblkhd",
            "usmblks",
            "fsmblks",
            "uordblks",
            "fordblks",
            "keep",
        ]
    ]


def _c_heap() -> int:
    """Bytes that malloc has given out."""
    mallinfo2 = getattr(ctypes.CDLL(None), "mallinfo2", None)
    if mallinfo2 is None:  # an older C library
        return 0
    mallinfo2.restype = _Mallinfo
    info = mallinfo2()
    return int(info.uordblks + info.hblkhd)


SHARED = (
    None,
    True,
    False,
    0,
    (),
    "",
    Transform,
    Store,
    shmtf.Snapshot,
    _core,
    _core.Store,
    _core.Transform,
    float,
    dict,
)


def usage(kept: tuple[object, ...]) -> dict[str, int]:
    gc.collect()
    with open("/proc/self/maps") as maps:
        n_maps = sum("/" in line for line in maps)
    with open("/proc/self/statm") as statm:
        pages = int(statm.read().split()[0])
    references = sum(sys.getrefcount(thing) for thing in (*SHARED, *kept))
    return {
        "blocks": sys.getallocatedblocks(),
        "bytes": _c_heap(),
        "pages": pages,
        "mappings": n_maps,
        "descriptors": len(os.listdir("/proc/self/fd")),
        "threads": threading.active_count(),
        "references": references,
    }


SMALLEST = {"bytes": 16}  # a call that forgets something forgets at least this; of the others one


def leaks(call: Callable[[], object], kept: tuple[object, ...] = ()) -> dict[str, int]:
    """What grew with the calls in every round."""
    for _ in range(8):
        call()
    suspects: dict[str, int] = {}
    for round_ in range(ROUNDS):
        n = CALLS_A_ROUND * (1 + round_)
        before = usage(kept)
        for _ in range(n):
            call()
        after = usage(kept)
        grown = {k: after[k] - before[k] for k in after if after[k] - before[k] >= 0.75 * n * SMALLEST.get(k, 1)}
        suspects = {k: v for k, v in grown.items() if not round_ or k in suspects}
        if not suspects:
            return {}
    return suspects


@pytest.fixture(scope="module")
def world() -> Iterator[World]:
    made = World()
    gc.collect()
    gc.freeze()  # what is there by now need not be looked through each time
    yield made
    gc.unfreeze()
    made.close()


def calling(world: World, name: str, bad: dict[str, Any]) -> Callable[[], object]:
    """One call with good arguments but for `bad`; what it raises is dropped."""
    get, parameters = CALLS[name]
    fresh = name in MAKES_STORES or name.rpartition(".")[2] in ("close", "__exit__", "__enter__", "unlink")
    fixed = name.rpartition(".")[2].startswith("set_") and name.startswith("shmtf._core.")

    def call() -> None:
        if fresh:
            world.begin()
        args: list[Any] = []
        kwargs: dict[str, Any] = {}
        for p in parameters:
            value = bad[p.name] if p.name in bad else good_argument(p.name, world)
            if p.kind is inspect.Parameter.KEYWORD_ONLY:
                kwargs[p.name] = value
            else:
                args.append(value)
        with contextlib.suppress(*ALLOWED):
            made = get(world)(*args, **kwargs)
            if isinstance(made, (_core.Store, _core.Snapshot)) and made is not world.victim:
                made.close()
        if fresh or fixed:
            world.end()
        while world.files:
            os.close(world.files.pop())

    return call


def _assert_none(found: dict[str, int], what: str) -> None:
    assert not found, f"{what} leaves behind, over {CALLS_A_ROUND * ROUNDS} calls: {found}"


@pytest.mark.parametrize("name", sorted(set(CALLS) - SLOW))
def test_call(world: World, name: str) -> None:
    world.begin()
    _assert_none(leaks(calling(world, name, {})), name)
    for parameter in CALLS[name][1]:
        for what, make in BAD.items():
            if parameter.name == "timeout" and what == "a number too large":
                continue  # for ever
            value = make()
            found = leaks(calling(world, name, {parameter.name: value}), (value,))
            _assert_none(found, f"{name} with {what} for {parameter.name}")
    world.begin()
    world.victim.close()
    if name not in MAKES_STORES:
        _assert_none(leaks(calling(world, name, {})), f"{name} of a closed store")
    world.end()


def _getters() -> Iterator[tuple[str, type, str]]:
    for cls in (_core.Reader, _core.Transform, Transform, Store, shmtf.Snapshot):
        for name, kind in vars(cls).items():
            if inspect.isgetsetdescriptor(kind) or isinstance(kind, property):
                yield f"{cls.__name__}.{name}", cls, name


@pytest.mark.parametrize(("what", "cls", "name"), [pytest.param(*g, id=g[0]) for g in _getters()])
def test_getter(world: World, what: str, cls: type, name: str) -> None:
    world.begin()
    found = world.victim.lookup_transform("map", "b")
    owners = {"Transform": [found, Transform("a", "b"), found.inv()]}
    for owner in owners.get(cls.__name__, [world.victim, world.victim.snapshot()]):
        if isinstance(owner, cls) or cls is _core.Reader:
            _assert_none(leaks(lambda owner=owner: getattr(owner, name, None), (owner,)), what)
    world.victim.close()
    closed = world.victim

    def ask() -> None:
        with contextlib.suppress(shmtf.ClosedError):
            getattr(closed, name, None)

    _assert_none(leaks(ask, (closed,)), f"{what} of a closed store")
    world.end()


def test_lives(world: World) -> None:
    """Objects that come and go in one piece: stores, transforms that outlive them, pickles, buffers, long paths."""
    batch = [Transform(f"f{k}", f"f{k + 1}", 5) for k in range(55)]

    def live() -> None:
        with Store.attach(world.name) as store, store.snapshot() as snapshot:
            store.set_transforms(batch)
            kept = [
                store.lookup_transform("f0", "f55"),
                snapshot.explain("map", "nobody"),
                store.lookup_transform("map", "b"),
            ]
            names = [str(k) + "map"[:0] + "map" for k in range(3)]
            kept += [store.explain(name, "a") for name in names]
            memoryview(kept[2]).release()
            pickle.loads(pickle.dumps(kept[2]))
            store.remove_frame("f55")
        assert kept[0].edges

    world.begin()
    _assert_none(leaks(live), "the life of a store")
    world.end()
    world.fill()


def test_every_function_of_the_binding_is_called() -> None:
    called = {name.rpartition(".")[2] for name in CALLS}
    getters = {name for _, _, name in _getters()}
    for owner in (_core, _core.Reader, _core.Store, _core.Snapshot, _core.Transform):
        for name, thing in vars(owner).items():
            is_method = inspect.isroutine(thing) and not name.startswith("__")
            assert not is_method or name in called, f"{owner.__name__}.{name} has no leak test"
            assert not inspect.isgetsetdescriptor(thing) or name in getters, f"{owner.__name__}.{name} has no leak test"
            assert not inspect.isclass(thing) or name in called or name == "Reader", f"{name} has no leak test"


@pytest.mark.parametrize("what", ["blocks", "bytes", "mappings", "descriptors", "references"])
def test_a_leak_is_found(what: str) -> None:
    """One small thing a call, of each kind."""
    kept: list[Any] = []
    libc = ctypes.CDLL(None)
    libc.malloc.restype = ctypes.c_void_p
    thing = object()
    with open("/proc/self/exe", "rb") as file:
        import mmap

        forget: dict[str, Callable[[], object]] = {
            "blocks": lambda: kept.append(object()),
            "bytes": lambda: libc.malloc(1),
            "mappings": lambda: kept.append(mmap.mmap(file.fileno(), 4096, prot=mmap.PROT_READ)),
            "descriptors": lambda: kept.append(os.dup(file.fileno())),
            "references": lambda: ctypes.pythonapi.Py_IncRef(ctypes.py_object(thing)),
        }
        found = leaks(forget[what], (thing,))
    for item in kept:
        if isinstance(item, int):
            os.close(item)
    assert what in found
