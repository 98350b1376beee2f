# SPDX-License-Identifier: Apache-2.0
"""What a Transform calculates, against matrices and scipy."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

import shmtf
from shmtf import Transform

coordinate = st.floats(-1e3, 1e3)
quaternion = hnp.arrays(np.float64, 4, elements=st.floats(-1, 1)).filter(lambda q: np.linalg.norm(q) > 0.1)
pose = st.tuples(st.tuples(coordinate, coordinate, coordinate), quaternion.map(lambda q: q / np.linalg.norm(q)))


def make(p: tuple, parent: str = "a", child: str = "b", stamp: int | None = 5) -> Transform:
    return Transform(parent, child, stamp, *p)


@given(pose, hnp.arrays(np.float64, (5, 3), elements=coordinate))
def test_apply_is_the_matrix(p: tuple, points: np.ndarray) -> None:
    t = make(p)
    homogeneous = np.c_[points, np.ones(5)] @ t.matrix.T
    np.testing.assert_allclose(t.apply(points), homogeneous[:, :3], atol=1e-9)
    np.testing.assert_allclose(t.apply(points[0]), homogeneous[0, :3], atol=1e-9)
    np.testing.assert_allclose(t.rotate(points), homogeneous[:, :3] - t.translation, atol=1e-9)
    np.testing.assert_allclose(t.inv().apply(t.apply(points)), points, atol=1e-8)


@given(pose, pose)
def test_product_is_the_matrix_product(p: tuple, q: tuple) -> None:
    t, u = make(p, "a", "b"), make(q, "b", "c")
    product = t @ u
    assert (product.parent, product.child) == ("a", "c")
    np.testing.assert_allclose(product.matrix, t.matrix @ u.matrix, atol=1e-9)
    assert np.linalg.norm(product.rotation) == pytest.approx(1, abs=1e-15)
    assert product.rotation[3] >= 0


@given(pose)
def test_inverse(p: tuple) -> None:
    t = make(p)
    assert (t.inv().parent, t.inv().child, t.inv().stamp) == ("b", "a", 5)
    assert t.inverse() == t.inv()
    np.testing.assert_allclose((t @ t.inv()).matrix, np.eye(4), atol=1e-9)
    assert t.inv().inv().is_close(t)


def test_product_needs_matching_frames() -> None:
    with pytest.raises(shmtf.InvalidArgumentException, match=r"T_a_b @ T_c_d.*T\.child == U\.parent"):
        Transform("a", "b") @ Transform("c", "d")
    for other in (3, np.eye(4), np.zeros(7), "x"):
        with pytest.raises(TypeError):
            Transform("a", "b") @ other
        with pytest.raises(TypeError):
            other @ Transform("a", "b")


def test_stamp_of_a_product() -> None:
    def stamps(first: int | None, second: int | None) -> tuple:
        product = Transform("a", "b", first) @ Transform("b", "c", second)
        return product.stamp, product.stamp_range

    assert stamps(3, 7) == (3, (3, 7))
    assert stamps(7, 3) == (3, (3, 7))
    assert stamps(None, 3) == (3, (3, 3))
    assert stamps(3, None) == (3, (3, 3))
    assert stamps(None, None) == (None, None)


def test_direction() -> None:
    t = Transform.from_rpy("map", "base", None, (10, 0, 0), (0, 0, math.pi / 2))
    np.testing.assert_allclose(t.apply((1, 0, 0)), (10, 1, 0), atol=1e-15)
    np.testing.assert_allclose(t.rotate((1, 0, 0)), (0, 1, 0), atol=1e-15)
    assert t.yaw == pytest.approx(math.pi / 2)


@given(st.floats(-3.1, 3.1), st.floats(-1.5, 1.5), st.floats(-3.1, 3.1))
def test_rpy_round_trip(roll: float, pitch: float, yaw: float) -> None:
    t = Transform.from_rpy("a", "b", 1, (0, 0, 0), (roll, pitch, yaw))
    np.testing.assert_allclose(t.rpy, (roll, pitch, yaw), atol=1e-7)
    rx = Transform.from_rpy("y", "x", 1, rpy=(roll, 0, 0))
    ry = Transform.from_rpy("z", "y", 1, rpy=(0, pitch, 0))
    rz = Transform.from_rpy("w", "z", 1, rpy=(0, 0, yaw))
    np.testing.assert_allclose((rz @ ry @ rx).matrix, t.matrix, atol=1e-12)


@pytest.mark.parametrize("pitch", [math.pi / 2, -math.pi / 2])
@pytest.mark.parametrize("roll", [0.0, 0.3])
def test_rpy_at_the_poles_is_the_same_rotation(pitch: float, roll: float) -> None:
    t = Transform.from_rpy("a", "b", 1, rpy=(roll, pitch, 0.5))
    assert Transform.from_rpy("a", "b", 1, rpy=t.rpy).is_close(t, angle=1e-7)


@given(pose)
def test_matrix_round_trip(p: tuple) -> None:
    t = make(p)
    assert Transform.from_matrix("a", "b", 5, t.matrix).is_close(t, angle=1e-7)


@pytest.mark.parametrize(
    "change",
    [
        lambda m: m[:3],
        lambda m: m * 2,
        lambda m: m @ np.diag([1.01, 1, 1, 1]),
        lambda m: np.diag([1, 1, -1, 1.0]),
        lambda m: m + [[0, 0, 0, 0]] * 3 + [[0, 0, 0, 1]],
        lambda m: np.full((4, 4), np.nan),
        lambda m: m.T + np.tri(4, k=-3),
    ],
)
def test_matrices_that_are_not_rigid(change: Callable[[np.ndarray], np.ndarray]) -> None:
    with pytest.raises((shmtf.InvalidArgumentException, ValueError)):
        Transform.from_matrix("a", "b", 0, change(np.eye(4)))


@given(pose, pose)
def test_pose(p: tuple, q: tuple) -> None:
    t, inner = make(p, "a", "b"), make(q, "b", "c")
    position, orientation = t.transform_pose(inner.translation, inner.rotation)
    assert Transform("a", "c", 5, position, orientation).is_close(t @ inner)
    positions, orientations = t.transform_pose([inner.translation] * 3, [inner.rotation] * 3)
    assert positions.shape == (3, 3)
    assert orientations.shape == (3, 4)
    np.testing.assert_allclose(orientations[2], orientation)


@given(pose)
def test_covariance(p: tuple) -> None:
    t = make(p)
    c = np.diag([1.0, 2, 3, 4, 5, 6])
    out = t.transform_covariance(c)
    r = t.matrix[:3, :3]
    np.testing.assert_allclose(out[:3, :3], r @ c[:3, :3] @ r.T, atol=1e-9)
    np.testing.assert_allclose(out[3:, 3:], r @ c[3:, 3:] @ r.T, atol=1e-9)
    np.testing.assert_allclose(t.inv().transform_covariance(out), c, atol=1e-9)
    with pytest.raises(shmtf.InvalidArgumentException):
        t.transform_covariance(np.eye(3))


@pytest.mark.parametrize("points", [(1, 2), np.zeros((3, 2)), np.zeros((2, 2, 3)), 5.0])
def test_points_of_another_shape(points: object) -> None:
    with pytest.raises(shmtf.InvalidArgumentException, match="shape"):
        Transform("a", "b").apply(points)


def test_is_close() -> None:
    t = Transform("a", "b", 1, (1, 2, 3))
    assert t.is_close(Transform("a", "b", 2, (1, 2, 3)))
    assert not t.is_close(Transform("a", "c", 1, (1, 2, 3)))
    assert not t.is_close(Transform("a", "b", 1, (1, 2, 3.001)))
    assert t.is_close(Transform("a", "b", 1, (1, 2, 3.001)), distance=0.01)
    turned = Transform.from_rpy("a", "b", 1, (1, 2, 3), (0.01, 0, 0))
    assert not t.is_close(turned)
    assert t.is_close(turned, angle=0.0101)
    assert not t.is_close(turned, angle=0.0099)


def test_scipy_round_trip() -> None:
    spatial = pytest.importorskip("scipy.spatial.transform")
    t = Transform.from_rpy("a", "b", 1, (1, 2, 3), (0.1, 0.2, 0.3))
    if hasattr(spatial, "RigidTransform"):
        np.testing.assert_allclose(t.to_scipy().as_matrix(), t.matrix, atol=1e-15)
        assert Transform.from_scipy("a", "b", 1, t.to_scipy()).is_close(t)
    rotation = spatial.Rotation.from_euler("xyz", (0.1, 0.2, 0.3))
    assert Transform.from_scipy("a", "b", 1, rotation, (1, 2, 3)).is_close(t)
    assert Transform.from_scipy("a", "b", 1, rotation).translation.tolist() == [0, 0, 0]


def test_identity() -> None:
    assert Transform.identity("a", "b") == Transform("a", "b")
    assert Transform.identity("a", "b", 3).stamp == 3
