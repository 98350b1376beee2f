# SPDX-License-Identifier: Apache-2.0
"""The Transform: what it accepts, what it calculates."""

from __future__ import annotations

import copy
import math
import pickle
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

import shmtf
from shmtf import Transform

SQRT_HALF = math.sqrt(0.5)
coordinate = st.floats(-1e3, 1e3)
quaternion = hnp.arrays(np.float64, 4, elements=st.floats(-1, 1)).filter(lambda q: np.linalg.norm(q) > 0.1)
pose = st.tuples(st.tuples(coordinate, coordinate, coordinate), quaternion.map(lambda q: q / np.linalg.norm(q)))


def make(p: tuple, parent: str = "a", child: str = "b", stamp: int | None = 5) -> Transform:
    return Transform(parent, child, stamp, *p)


def same_rotation(q: np.ndarray, r: np.ndarray, tolerance: float = 1e-9) -> bool:
    return min(np.abs(q - r).max(), np.abs(q + r).max()) <= tolerance


# ---- what it holds ----


def test_fields_and_defaults() -> None:
    t = Transform("map", "base")
    assert (t.parent, t.child, t.stamp, t.stamp_range, t.edges, t.version) == ("map", "base", None, None, (), None)
    assert t.translation.tolist() == [0, 0, 0]
    assert t.rotation.tolist() == [0, 0, 0, 1]
    assert t.rotation_wxyz.tolist() == [1, 0, 0, 0]
    assert not t.used_fallback
    u = Transform(parent="map", child="base", stamp=7, translation=[1, 2, 3], rotation=np.array([0, 0, 1.0, 0]))
    assert (u.stamp, u.stamp_range) == (7, (7, 7))
    assert u.translation.tolist() == [1, 2, 3]
    assert u.rotation.tolist() == [0, 0, 1, 0]


@pytest.mark.parametrize("name", ["translation", "rotation", "rotation_wxyz", "matrix", "rpy"])
def test_arrays_are_read_only_float64(name: str) -> None:
    array = getattr(Transform("a", "b", 1, (1, 2, 3)), name)
    assert array.dtype == np.float64
    with pytest.raises(ValueError, match="read-only"):
        array[0] = 1
    with pytest.raises(ValueError, match=r"WRITEABLE|writeable"):
        array.flags.writeable = True


def test_arrays_outlive_the_transform_without_a_copy() -> None:
    t = Transform("a", "b", 1, (1, 2, 3))
    assert np.shares_memory(t.translation, t.translation)
    array = t.translation
    del t
    assert array.tolist() == [1, 2, 3]


def test_buffer_is_seven_doubles() -> None:
    view = memoryview(Transform("a", "b", 1, (1, 2, 3)))
    assert (view.format, view.shape, view.readonly, view.tolist()) == ("d", (7,), True, [1, 2, 3, 0, 0, 0, 1])


@pytest.mark.parametrize("name", ["parent", "stamp", "translation", "edges", "anything"])
def test_immutable(name: str) -> None:
    with pytest.raises(AttributeError):
        setattr(Transform("a", "b"), name, None)


def test_value_semantics() -> None:
    t = Transform("a", "b", 1, (1, 2, 3), (0, 0, SQRT_HALF, SQRT_HALF))
    assert t == Transform("a", "b", 1, (1, 2, 3), (0, 0, SQRT_HALF, SQRT_HALF))
    assert hash(t) == hash(Transform("a", "b", 1, (1.0, 2.0, 3.0), (0, 0, SQRT_HALF, SQRT_HALF)))
    assert Transform("a", "b", 1, (0.0, 0, 0)) == Transform("a", "b", 1, (-0.0, 0, 0))
    for other in (
        Transform("x", "b", 1, (1, 2, 3), (0, 0, SQRT_HALF, SQRT_HALF)),
        Transform("a", "x", 1, (1, 2, 3), (0, 0, SQRT_HALF, SQRT_HALF)),
        Transform("a", "b", None, (1, 2, 3), (0, 0, SQRT_HALF, SQRT_HALF)),
        Transform("a", "b", 1, (1, 2, 4), (0, 0, SQRT_HALF, SQRT_HALF)),
        Transform("a", "b", 1, (1, 2, 3)),
        "no transform",
    ):
        assert t != other
    assert repr(t).startswith("Transform('a', 'b', stamp=1, translation=(1.0, 2.0, 3.0)")
    assert eval(repr(t)) == t


def test_pickle_and_copy() -> None:
    t = Transform("a", "b", 1, (1, 2, 3), (0, 0, SQRT_HALF, SQRT_HALF))
    for protocol in range(2, pickle.HIGHEST_PROTOCOL + 1):
        u = pickle.loads(pickle.dumps(t, protocol))
        assert u == t
        assert u.stamp_range == (1, 1)
    assert copy.copy(t) is t
    assert copy.deepcopy([t])[0] is t
    itself = t @ t.inv()
    assert pickle.loads(pickle.dumps(itself)) == itself


def test_subclass_with_fields_works() -> None:
    class Tagged(Transform):
        pass

    t = Tagged("a", "b", 1, (1, 2, 3))
    t.tag = "x"
    assert t.tag == "x"
    assert type(t.inv()) is Tagged
    assert t.inv().child == "a"


# ---- what it refuses ----


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("", "at least one character"),
        ("/map", "no leading '/'"),
        ("x" * 128, "127 bytes"),
        ("x" * 10_000, "127 bytes"),
        ("ä" * 64, "127 bytes"),
        ("a\0b", "NUL"),
        ("\ud800", "surrogate"),
    ],
)
@pytest.mark.parametrize("which", ["parent", "child"])
def test_bad_names(name: str, says: str, which: str) -> None:
    names = {"parent": "p", "child": "c", which: name}
    with pytest.raises(shmtf.InvalidArgumentException, match=says) as caught:
        Transform(**names)
    assert caught.value.what == which
    assert caught.value.value == name
    assert len(str(caught.value)) < 300
    assert isinstance(caught.value, ValueError)


@pytest.mark.parametrize("name", [None, 1, b"map", ["map"]])
def test_names_that_are_no_str(name: object) -> None:
    with pytest.raises(TypeError, match="parent must be a str"):
        Transform(name, "b")
    with pytest.raises(TypeError, match="child must be a str"):
        Transform("a", name)


def test_longest_names() -> None:
    assert Transform("x" * 127, "ä" * 63).child == "ä" * 63
    assert Transform("NO_PARENT", "a/b c\n☃").child == "a/b c\n☃"


def test_frame_is_not_its_own_parent() -> None:
    with pytest.raises(shmtf.InvalidArgumentException, match="own parent"):
        Transform("a", "".join(["a"]))


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("index", range(7))
def test_numbers_that_are_not_finite(bad: float, index: int) -> None:
    values = [0.0, 0, 0, 0, 0, 0, 1]
    values[index] = bad
    with pytest.raises(shmtf.InvalidArgumentException, match="finite") as caught:
        Transform("a", "b", 0, values[:3], values[3:])
    assert caught.value.what == ["translation x", "translation y", "translation z"][index] if index < 3 else True
    assert caught.value.value == bad or (math.isnan(bad) and math.isnan(caught.value.value))


@pytest.mark.parametrize(
    "q",
    [(0, 0, 0, 0), (0, 0, 0, 0.5), (0, 0, 0, 2), (0, 0, 0.2, 1), (0, 0, 0, 1e-150), (0, 0, 0, 1e200), (0, 0, 0, 0.994)],
)
def test_quaternions_that_are_no_rotation(q: tuple) -> None:
    with pytest.raises(shmtf.InvalidArgumentException, match="unit quaternion x y z w") as caught:
        Transform("a", "b", 0, (0, 0, 0), q)
    assert caught.value.value == pytest.approx(math.hypot(*q))


def test_quaternions_are_kept_normalised_with_positive_w() -> None:
    assert Transform("a", "b", 0, (0, 0, 0), (0, 0, 0, 1.004)).rotation.tolist() == [0, 0, 0, 1]
    assert Transform("a", "b", 0, (0, 0, 0), (0, 0, 0.6, -0.8)).rotation.tolist() == [0, 0, -0.6, 0.8]
    assert str(Transform("a", "b", 0, (0, 0, 0), (0, 0, 0, -1)).rotation.tolist()) == "[0.0, 0.0, 0.0, 1.0]"


@given(pose)
def test_normalising_again_changes_nothing(p: tuple) -> None:
    t = make(p)
    assert make((t.translation, t.rotation)) == t


@pytest.mark.parametrize(
    "bad", [(1, 2), (1, 2, 3, 4), (), [[1, 2, 3]], "abc", b"abc", 5, None, {1: 2}, ("a", "b", "c")]
)
def test_translations_of_another_shape(bad: object) -> None:
    with pytest.raises((ValueError, TypeError)):
        Transform("a", "b", 0, bad)


def test_sequences_of_every_kind() -> None:
    for v in ([1, 2, 3], (1, 2, 3), np.array([1, 2, 3]), np.array([1, 2, 3], "f4"), np.arange(6.0)[1:4], range(1, 4)):
        assert Transform("a", "b", 0, v).translation.tolist() == [1, 2, 3]
    assert Transform("a", "b", 0, np.arange(6.0)[::2]).translation.tolist() == [0, 2, 4]
    assert Transform("a", "b", 0, np.arange(3.0)[::-1]).translation.tolist() == [2, 1, 0]
    assert Transform("a", "b", 0, iter([1, 2, 3])).translation.tolist() == [1, 2, 3]
    with pytest.raises(ValueError, match="shape"):
        Transform("a", "b", 0, np.zeros((3, 1)))


# ---- stamps ----


class Index:
    def __index__(self) -> int:
        return 42


@pytest.mark.parametrize(
    ("time", "ns"),
    [
        (0, 0),
        (-5, -5),
        (2**63 - 1, 2**63 - 1),
        (-(2**63), -(2**63)),
        (Index(), 42),
        (np.int64(7), 7),
        (np.uint32(7), 7),
        (SimpleNamespace(nanoseconds=9), 9),
        (SimpleNamespace(to_nsec=lambda: 10), 10),
        (SimpleNamespace(sec=3, nanosec=4), 3_000_000_004),
        (np.datetime64("1970-01-01T00:00:01"), 10**9),
        (np.datetime64(123, "ns"), 123),
        (np.datetime64("2262-01-01"), 9214646400 * 10**9),
    ],
)
def test_stamps_of_other_libraries(time: object, ns: int) -> None:
    assert Transform("a", "b", time).stamp == ns
    assert shmtf.to_seconds(time) == ns / 10**9


@pytest.mark.parametrize("time", [0.0, 1.5, math.nan, np.float64(1), np.float32(1)])
def test_float_stamps_point_to_from_seconds(time: float) -> None:
    with pytest.raises(TypeError, match=r"shmtf\.from_seconds"):
        Transform("a", "b", time)


@pytest.mark.parametrize("time", [True, False, "1", b"1", [1], object(), np.bool_(True), 1j])
def test_stamps_that_are_no_time(time: object) -> None:
    with pytest.raises(TypeError, match="stamp"):
        Transform("a", "b", time)


@pytest.mark.parametrize(
    "time", [2**63, -(2**63) - 1, np.datetime64("NaT", "ns"), np.datetime64("3000-01-01"), np.uint64(2**63)]
)
def test_stamps_beyond_int64(time: object) -> None:
    with pytest.raises(shmtf.InvalidArgumentException, match="int64 nanoseconds"):
        Transform("a", "b", time)


def test_seconds() -> None:
    assert shmtf.from_seconds(1.5) == 1_500_000_000
    assert shmtf.from_seconds(-0.25) == -250_000_000
    assert shmtf.from_seconds(3) == 3 * 10**9
    assert shmtf.from_seconds(1_700_000_000.25) == 1_700_000_000_250_000_000
    assert shmtf.to_seconds(1_500_000_000) == 1.5
    for bad in (math.nan, math.inf, 1e10):
        with pytest.raises(shmtf.InvalidArgumentException):
            shmtf.from_seconds(bad)
    for wrong in ("1", True, None):
        with pytest.raises(TypeError):
            shmtf.from_seconds(wrong)
    assert abs(shmtf.now() - shmtf.now()) < 3600 * 10**9


@given(st.floats(-9e9, 9e9))
def test_seconds_are_converted_to_the_nearest_nanosecond(s: float) -> None:
    from fractions import Fraction

    assert abs(shmtf.from_seconds(s) - Fraction(s) * 10**9) <= Fraction(1, 2) + Fraction(1, 10**6)
