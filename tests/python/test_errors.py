# SPDX-License-Identifier: Apache-2.0
"""The exceptions: trees, fields, messages, pickling."""

from __future__ import annotations

import errno
import pickle

import pytest

import shmtf

S = 10**9
TREE = {
    "TransformException": ("RuntimeError",),
    "LookupException": ("TransformException",),
    "ConnectivityException": ("TransformException",),
    "ExtrapolationException": ("TransformException",),
    "BackwardExtrapolationException": ("ExtrapolationException",),
    "ForwardExtrapolationException": ("ExtrapolationException",),
    "NoDataForExtrapolationException": ("ExtrapolationException",),
    "InvalidArgumentException": ("TransformException", "ValueError"),
    "CycleError": ("InvalidArgumentException",),
    "OldDataError": ("InvalidArgumentException",),
    "TimeoutException": ("TransformException", "TimeoutError"),
    "LookupTimeout": ("LookupException", "TimeoutException"),
    "ConnectivityTimeout": ("ConnectivityException", "TimeoutException"),
    "BackwardExtrapolationTimeout": ("BackwardExtrapolationException", "TimeoutException"),
    "ForwardExtrapolationTimeout": ("ForwardExtrapolationException", "TimeoutException"),
    "NoDataTimeout": ("NoDataForExtrapolationException", "TimeoutException"),
    "StoreError": ("RuntimeError",),
    "StoreExistsError": ("StoreError", "FileExistsError"),
    "StoreNotFoundError": ("StoreError", "FileNotFoundError"),
    "StoreNotReadyError": ("StoreNotFoundError",),
    "StorePermissionError": ("StoreError", "PermissionError"),
    "StoreVersionError": ("StoreError",),
    "StoreCorruptError": ("StoreError",),
    "StoreFullError": ("StoreError",),
    "ReadOnlyStoreError": ("StoreError",),
    "BusyError": ("StoreError",),
    "ConflictError": ("StoreError",),
    "SnapshotExpiredError": ("StoreError",),
    "ClosedError": ("StoreError",),
}


@pytest.mark.parametrize("name", TREE)
def test_bases(name: str) -> None:
    cls = getattr(shmtf, name)
    assert cls.__doc__
    for base in TREE[name]:
        assert issubclass(cls, getattr(shmtf, base, None) or getattr(__builtins__, base, None) or eval(base))
    assert issubclass(cls, shmtf.TransformException) != issubclass(cls, shmtf.StoreError)


def test_the_tree_is_complete() -> None:
    exceptions = {name for name in shmtf.__all__ if name.endswith(("Exception", "Error", "Timeout"))}
    assert exceptions == set(TREE)


@pytest.mark.parametrize("name", TREE)
def test_every_one_has_fields_a_message_and_pickles(name: str) -> None:
    cls = getattr(shmtf, name)
    fields = {
        "edge": ("map", "base"),
        "frame": "base",
        "target": "map",
        "source": "arm",
        "requested": 12 * S,
        "oldest": 13 * S,
        "newest": 14 * S,
        "holder": "planner",
        "holder_slot": 3,
        "holder_pid": 99,
        "waited": 0.5,
        "item": 2,
        "value": 1.5,
        "limit": 10,
        "needed": 11,
        "store": "robot",
        "what": "reason",
    }
    error = cls(**fields)
    for key, value in fields.items():
        assert getattr(error, key) == value
    assert len(str(error)) > 10
    copy = pickle.loads(pickle.dumps(error))
    assert type(copy) is cls
    for key, value in fields.items():
        assert getattr(copy, key) == value
    assert str(copy) == str(error)
    assert name in repr(error)
    bare = cls()
    assert str(bare)
    assert bare.edge is None
    assert str(pickle.loads(pickle.dumps(cls("own words")))) == str(cls("own words")) == "own words"


def test_builtin_handlers_catch_them() -> None:
    with pytest.raises(FileNotFoundError) as caught:
        shmtf.Store.attach("shmtf-test-none")
    assert caught.value.errno == errno.ENOENT
    assert shmtf.StoreExistsError().errno == errno.EEXIST
    assert shmtf.StorePermissionError(sys_errno=errno.EPERM).errno == errno.EPERM
    assert shmtf.LookupTimeout().errno == errno.ETIMEDOUT


def raised(call: object, *args: object, **kwargs: object) -> BaseException:
    with pytest.raises((shmtf.TransformException, shmtf.StoreError)) as caught:
        call(*args, **kwargs)
    return caught.value


def test_lookup_names_the_frame_and_the_nearest(store: shmtf.Store) -> None:
    store.set_transform(shmtf.Transform("map", "laser", 1))
    error = raised(store.lookup_transform, "map", "lasr")
    assert isinstance(error, shmtf.LookupException)
    assert (error.frame, error.target, error.source, error.store) == ("lasr", "map", "lasr", store.name)
    for part in ('"lasr"', 'did you mean "laser"?', store.name):
        assert part in str(error)
    assert 'did you mean "laser"?' in str(pickle.loads(pickle.dumps(error)))
    assert "did you mean" not in str(raised(store.lookup_transform, "map", "qqqq"))


def test_connectivity_names_the_roots(store: shmtf.Store) -> None:
    store.set_transforms([shmtf.Transform("map", "base", 1), shmtf.Transform("odom", "wheel", 1)])
    error = raised(store.lookup_transform, "base", "wheel")
    assert isinstance(error, shmtf.ConnectivityException)
    assert (error.target, error.source, error.roots) == ("base", "wheel", ("map", "odom"))
    for part in ('"base"', '"wheel"', '"map"', '"odom"'):
        assert part in str(error)


def test_extrapolation_names_the_edge_and_the_times(store: shmtf.Store) -> None:
    for k in (1, 2):
        store.set_transforms([shmtf.Transform("map", "base", k * S), shmtf.Transform("base", "arm", k * S + 5)])
    late = raised(store.lookup_transform, "map", "arm", 2 * S + 3)
    assert isinstance(late, shmtf.ForwardExtrapolationException)
    assert (late.edge, late.requested, late.oldest, late.newest) == (("map", "base"), 2 * S + 3, S, 2 * S)
    for part in ('"map" -> "base"', "2.000000003 s", "2.000000000 s", "3 ns earlier", '"arm"', "timeout="):
        assert part in str(late)
    early = raised(store.lookup_transform, "map", "arm", S + 3)
    assert isinstance(early, shmtf.BackwardExtrapolationException)
    assert (early.edge, early.requested, early.oldest) == (("base", "arm"), S + 3, S + 5)
    for part in ('"base" -> "arm"', "1.000000003 s", "1.000000005 s", "2 ns later", "history"):
        assert part in str(early)
    store.set_transform(shmtf.Transform("arm", "tip", -S))
    single = raised(store.lookup_transform, "arm", "tip", 0)
    assert isinstance(single, shmtf.NoDataForExtrapolationException)
    assert "-1.000000000 s" in str(single)


def test_a_timeout_is_both(store: shmtf.Store) -> None:
    store.set_transforms([shmtf.Transform("map", "base", 1), shmtf.Transform("odom", "wheel", 1)])
    store.set_transforms([shmtf.Transform("map", "base", 5), shmtf.Transform("odom", "wheel", 5)])
    store.set_transform(shmtf.Transform("map", "lone", 5))
    for cls, arguments in {
        shmtf.LookupTimeout: ("map", "none", None),
        shmtf.ConnectivityTimeout: ("map", "wheel", None),
        shmtf.ForwardExtrapolationTimeout: ("map", "base", 6),
        shmtf.BackwardExtrapolationTimeout: ("map", "base", 0),
        shmtf.NoDataTimeout: ("map", "lone", 0),
    }.items():
        without = raised(store.lookup_transform, *arguments)
        error = raised(store.lookup_transform, *arguments, timeout=0.01)
        assert type(error) is cls
        assert isinstance(error, (shmtf.TimeoutException, type(without)))
        assert error.waited >= 0.01
        assert not isinstance(without, shmtf.TimeoutException)
        assert pickle.loads(pickle.dumps(error)).edge == error.edge


def test_explain_returns_what_lookup_raises(store: shmtf.Store) -> None:
    store.set_transform(shmtf.Transform("map", "base", 1))
    assert store.explain("map", "base") is None
    assert store.explain("map", "base", 1) is None
    error = store.explain("map", "base", 2)
    assert type(error) is shmtf.NoDataForExtrapolationException
    assert error.__traceback__ is None
    assert type(store.explain("map", "x")) is shmtf.LookupException


def test_values_that_do_not_pickle() -> None:
    error = pickle.loads(pickle.dumps(shmtf.InvalidArgumentException(what="x", value=lambda: 1)))
    assert "lambda" in error.value
