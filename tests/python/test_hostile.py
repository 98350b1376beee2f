# SPDX-License-Identifier: Apache-2.0
"""Every public function with arguments that no caller should pass.

Each call ends with a value or a typed exception, never a crash or a SystemError; where an exception was raised the
store is what it was, and works. hypothesis draws from the values of `hostile.py`; what acts in the middle of a call,
closes the store there or collects garbage, is tried in every argument of every call. Tier: test.
"""

from __future__ import annotations

import contextlib
import gc
import inspect
import threading
import weakref
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import shmtf
from shmtf import Store, Transform, _core

from .hostile import Acts, Planted, Text, hostile_values
from .hostile_calls import CALLS, World, fits, good_argument

LABELS = sorted(hostile_values(), key=lambda label: int(label.split(":")[0]))
# What a wrong argument may lead to: the package's own exceptions, Python's for wrong types and numbers, the caller's.
Own = (shmtf.TransformException, shmtf.StoreError)
ALLOWED = (*Own, TypeError, ValueError, OverflowError, Planted)
NOT_GUARDED = {  # plain Python about its arguments, which says what is missing of them
    "Transform.from_scipy": AttributeError,
    "Transform.is_close": AttributeError,
    "shmtf.snapshot.Snapshot": AttributeError,
    "Transform.to_scipy": ModuleNotFoundError,
}
WRITES = (
    "set_transform",
    "set_transforms",
    "remove_frame",
    "clear",
    "declare_frame",
    "_declare_frame",
    "_check",
    "create",
)


@pytest.fixture(scope="module")
def world() -> Iterator[World]:
    made = World()
    yield made
    made.close()


def outcome(world: World, name: str, args: list[Any], kwargs: dict[str, Any]) -> BaseException | None:
    """The exception of a call, which must be an allowed one.  Then, and after a read, the store is what it was."""
    get, _ = CALLS[name]
    before = world.content()
    raised: BaseException | None = None
    try:
        value = get(world)(*args, **kwargs)
        if isinstance(value, (_core.Store, _core.Snapshot)):
            value.close()
    except (*ALLOWED, NOT_GUARDED.get(name, Planted)) as error:
        raised = error
        assert type(error).__name__ != "SystemError"
        if isinstance(error, Own):
            with contextlib.suppress(Planted):  # by the value it shows
                assert str(error)
    finally:
        world.end()
    if raised is not None or name.rpartition(".")[2] not in WRITES:
        assert world.content() == before, f"{name} changed the store, and said {raised!r}"
    return raised


def arguments(world: World, name: str, hostile: dict[str, Any]) -> tuple[list[Any], dict[str, Any]]:
    """Good arguments but for the hostile ones, each given as its parameter allows."""
    args: list[Any] = []
    kwargs: dict[str, Any] = {}
    for parameter in CALLS[name][1]:
        value = hostile[parameter.name] if parameter.name in hostile else good_argument(parameter.name, world)
        if parameter.kind is inspect.Parameter.KEYWORD_ONLY:
            kwargs[parameter.name] = value
        elif parameter.kind is inspect.Parameter.VAR_POSITIONAL:
            args += ["map", value if parameter.name in hostile else "b", "a"]
        else:
            args.append(value)
    return args, kwargs


def still_works(world: World) -> None:
    if world.witness.frames() != ["map", "a", "b", "c"]:
        world.fill()
    version = world.witness.version
    assert world.witness.set_transform(Transform("map", "a", 9, (version, 0, 0))) == version + 1
    assert world.witness.lookup_latest_transform("map", "c").translation[0] == version + 9


@pytest.mark.parametrize("name", sorted(CALLS))
def test_good_arguments(world: World, name: str) -> None:
    """What the other tests vary works by itself, or they would test the first check of each function only."""
    world.begin()
    args, kwargs = arguments(world, name, {})
    if name.endswith("declare_frame"):
        args[0] = "new"
        kwargs.pop("rate", None)
    if name == "Transform.from_scipy":
        spatial = pytest.importorskip("scipy.spatial.transform")
        args[3] = spatial.Rotation.identity()
    if name == "Transform.to_scipy":
        pytest.importorskip("scipy.spatial.transform")
    error = outcome(world, name, args, kwargs)
    refuses = {
        "shmtf._core.Store": shmtf.StoreVersionError,
        "Store._open": shmtf.StoreNotFoundError,
    }  # the file, the name
    refuses |= dict.fromkeys(("Store.attach", "Store.unlink", "shmtf.store_info"), shmtf.StoreNotFoundError)
    refuses |= {"Transform.__matmul__": shmtf.InvalidArgumentException, "Snapshot.__reduce__": TypeError}
    assert type(error) is refuses.get(name, type(None)), repr(error)
    still_works(world)


@pytest.mark.parametrize("name", sorted(CALLS))
@settings(max_examples=12, deadline=None, database=None, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_hostile_arguments(world: World, name: str, data: st.DataObject) -> None:
    parameters = [p.name for p in CALLS[name][1]]
    values = hostile_values()
    hostile: dict[str, Any] = {}
    for parameter in data.draw(st.sets(st.sampled_from(parameters), min_size=1)) if parameters else ():
        value = values[data.draw(st.sampled_from(LABELS), label=parameter)]
        if fits(parameter, value):
            hostile[parameter] = value
    world.begin()
    args, kwargs = arguments(world, name, hostile)
    abuse = data.draw(st.sampled_from(["no", "no", "no", "fewer", "more", "unknown", "twice"]), label="abuse")
    if abuse == "fewer" and args and not any(p in ("timeout", "type") for p in parameters):
        args.pop()
    elif abuse == "more":
        args.append(None)
    elif abuse == "unknown":
        kwargs["nobody knows"] = 1
    elif abuse == "twice" and parameters:
        kwargs[parameters[0]] = args[0] if args else None
    outcome(world, name, args, kwargs)
    still_works(world)


def acting(parameter: str, act: Callable[[], object], world: World) -> Any:
    return Acts(act, good_argument(parameter, world))


@pytest.mark.parametrize("name", sorted(CALLS))
@pytest.mark.parametrize("act", ["closes", "closes twice and opens", "collects", "recurses"])
def test_arguments_that_act(world: World, name: str, act: str) -> None:
    """In the middle of the call, from whatever asks the argument for its value."""
    for parameter in [p.name for p in CALLS[name][1]]:
        world.begin()
        victim = world.victim
        depth = 0

        def reopen(victim: Store = victim) -> None:
            victim.close()
            Store.attach(world.name).close()
            victim.close()

        def recurse(victim: Store = victim, parameter: str = parameter) -> None:
            nonlocal depth
            depth += 1
            if depth < 3 and not victim.closed:
                victim.lookup_transform("map", "b")
                victim.can_transform("map", "b", acting("time", recurse, world))

        acts = {
            "closes": victim.close,
            "closes twice and opens": reopen,
            "collects": lambda: gc.collect(1),
            "recurses": recurse,
        }
        args, kwargs = arguments(world, name, {parameter: acting(parameter, acts[act], world)})
        outcome(world, name, args, kwargs)
        still_works(world)


@pytest.mark.parametrize("place", range(0, 300, 13))
def test_a_name_that_closes_the_store_when_it_is_forgotten(world: World, place: int) -> None:
    """The store remembers strings it was asked with; what one of them does when it goes must find the store whole."""
    gone = 0

    class Last(Text):
        def __del__(self) -> None:
            nonlocal gone
            gone += 1
            if gone == place:
                victim.close()

    world.begin()
    victim = world.victim
    try:
        for k in range(12):
            batch = [Transform(Last("map"), Last("a"), 10 + k), Transform(Last("a"), Last("b"), 10 + k)]
            victim.set_transforms([t for t in batch for _ in range(2)])
            victim.lookup_latest_transform(Last("map"), Last("b"))
    except shmtf.ClosedError:
        pass
    finally:
        world.end()
    still_works(world)


def test_no_argument_is_asked_after_another_was_refused(world: World) -> None:
    class Asked:
        def __bool__(self) -> bool:
            return False

    world.begin()
    victim = world.victim

    def closes() -> Iterator[Transform]:
        victim.close()
        yield Transform("map", "a", 1)

    with pytest.raises(TypeError):
        victim.set_transforms(None, static=Asked())  # type: ignore[arg-type]
    with pytest.raises(shmtf.ClosedError):
        victim.set_transforms(closes(), static=Asked())  # type: ignore[arg-type]
    world.end()


def test_closed_by_another_thread_while_calls_wait(world: World) -> None:
    world.begin()
    victim, ended = world.victim, []

    def wait(call: Callable[[], object]) -> None:
        with pytest.raises(shmtf.ClosedError):
            call()
        ended.append(call)

    calls: list[Callable[[], object]] = [
        lambda: victim.lookup_transform("map", "nobody", timeout=None),
        lambda: victim.lookup_latest_transform("nobody", "map", timeout=None),
        lambda: victim.can_transform("map", "b", 10**9, timeout=None),
        lambda: victim.wait_for_change(timeout=None),
        lambda: victim.wait_for_change(["nobody"], timeout=None),
    ]
    threads = [threading.Thread(target=wait, args=(call,), daemon=True) for call in calls]
    for thread in threads:
        thread.start()
    while victim.counters()["waits"] < len(calls):
        pass
    victim.close()
    for thread in threads:
        thread.join(60)
    assert len(ended) == len(calls)
    world.end()
    still_works(world)


def test_objects_that_were_never_made(world: World) -> None:
    """No way around the constructors leads to an object without a store."""
    for cls in (_core.Reader, _core.Store, _core.Snapshot, Store, shmtf.Snapshot, _core.Transform, Transform):
        for make in (
            lambda c=cls: object.__new__(c),
            lambda c=cls: type("Sub", (c,), {})(),
            lambda c=cls: _core.Store.__new__(c),
            lambda c=cls: _core.Snapshot.__new__(c, 5),
            lambda c=cls: _core.Transform.__new__(c),
            lambda c=cls: c.__reduce_ex__(object.__new__(c), 2),
        ):
            with pytest.raises((TypeError, *Own)):
                make()


def test_what_outlives_its_store(world: World) -> None:
    """Transforms, snapshots and errors of a store that is closed and gone."""
    world.begin()
    found, snapshot = world.victim.lookup_transform("map", "b"), world.victim.snapshot()
    error = world.victim.explain("map", "nobody")
    gone = weakref.ref(world.victim)
    world.victim.close()
    world.victim = world.witness.__class__.attach(world.name)
    gc.collect()
    assert gone() is None or error is not None  # the exception names the store, it does not keep it
    assert found.edges == (("a", "b", 9), ("map", "a", 9))
    assert str(error)
    with pytest.raises(shmtf.ClosedError):
        snapshot.frames()
    world.end()


def test_everything_is_exercised() -> None:
    """A public name is called by the tests above, or is data."""
    functions = {name.rpartition(".")[2] for name in CALLS}
    data = {"__version__", "FrameInfo", "Holder", "StoreInfo"}
    for name in set(shmtf.__all__) - data:
        thing = getattr(shmtf, name)
        is_error = inspect.isclass(thing) and issubclass(thing, BaseException)
        assert is_error or name in functions or any(call.startswith(f"{name}.") for call in CALLS), name
    for cls in (Store, shmtf.Snapshot, Transform, _core.Store, _core.Snapshot, _core.Reader, _core.Transform):
        for name in vars(cls):
            if callable(getattr(cls, name)) and not (name.startswith("__") and name.endswith("__")):
                assert name in functions, f"{cls.__name__}.{name}"
    for name, thing in vars(_core).items():
        assert not inspect.isbuiltin(thing) or f"shmtf._core.{name}" in CALLS, name
