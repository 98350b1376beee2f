# SPDX-License-Identifier: Apache-2.0
"""One transform between two frames: what is written, and what a lookup returns."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from . import _core, _time  # noqa: F401  _time: other libraries' stamps
from .errors import InvalidArgumentException

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    Array = NDArray[np.float64]

__all__ = ["Transform"]

_MATRIX_TOLERANCE = 1e-4  # largest |R^T R - I| that counts as rounding


def _invalid(what: str, value: Any, hint: str) -> InvalidArgumentException:
    return InvalidArgumentException(what=what, value=value, hint=hint)


def _vectors(values: ArrayLike, what: str, size: int = 3) -> Array:
    array = np.asarray(values, dtype=np.float64)
    if array.ndim not in (1, 2) or array.shape[-1] != size:
        raise _invalid(what, array.shape, f"an array of shape ({size},) or (N, {size})")
    return array


def _quaternion_from_matrix(r: Array) -> tuple[float, float, float, float]:
    """x y z w of a rotation matrix, by the largest of the four (Shepperd, 1978)."""
    d = (r[0, 0], r[1, 1], r[2, 2], r.trace())
    i = int(np.argmax(d))
    if i == 3:
        q = [r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1], 1 + d[3]]
    else:
        j, k = (i + 1) % 3, (i + 2) % 3
        q = [0.0, 0.0, 0.0, r[k, j] - r[j, k]]
        q[i] = 1 - d[3] + 2 * d[i]
        q[j] = r[j, i] + r[i, j]
        q[k] = r[k, i] + r[i, k]
    norm = math.sqrt(sum(v * v for v in q))
    return tuple(float(v) / norm for v in q)  # type: ignore[return-value]


def _product(a: Array, b: Array) -> Array:
    """Quaternion products x y z w of one `a` with one or N `b`."""
    av, aw, bv, bw = a[:3], a[3], b[..., :3], b[..., 3:]
    vector = aw * bv + bw * av + np.cross(av, bv)
    return np.concatenate([vector, aw * bw - (bv @ av)[..., None]], axis=-1)


class Transform(_core.Transform):
    """T_parent_child, the pose of `child` in `parent`: p_parent = T.apply(p_child).  Immutable.

    ``Transform(parent, child, stamp=None, translation=(0, 0, 0), rotation=(0, 0, 0, 1))``

    parent, child: frame names (UTF-8, 1 to 127 bytes, no leading '/').  stamp: int nanoseconds, or an rclpy, rospy or
    numpy time; None: stamped when it is written.  translation: metres.  rotation: unit quaternion **x y z w** (within
    0.5 %; kept normalised, with w >= 0).

    Raises InvalidArgumentException for a number that is not finite, a quaternion that is no rotation or a bad name;
    TypeError for a float stamp.
    """

    __slots__ = ()
    __array_ufunc__ = None  # an array on the left of @ must not take this for seven numbers

    # ---- other ways to make one ----

    @classmethod
    def from_matrix(cls, parent: str, child: str, stamp: Any, matrix: ArrayLike) -> Transform:
        """From a rigid (4, 4) matrix.  Raises InvalidArgumentException if it scales, shears or mirrors."""
        m = np.asarray(matrix, dtype=np.float64)
        if m.shape != (4, 4):
            raise _invalid("matrix", m.shape, "an array of shape (4, 4)")
        r = m[:3, :3]
        if not np.isfinite(m).all() or not np.array_equal(m[3], (0, 0, 0, 1)):
            raise _invalid("matrix", m, "finite numbers, and a last row of 0 0 0 1")
        if np.abs(r.T @ r - np.eye(3)).max() > _MATRIX_TOLERANCE or np.linalg.det(r) < 0:
            raise _invalid("matrix", m, "its 3 x 3 part must be a rotation: orthonormal, with determinant +1")
        return cls(parent, child, stamp, m[:3, 3], _quaternion_from_matrix(r))

    @classmethod
    def from_rpy(
        cls,
        parent: str,
        child: str,
        stamp: Any = None,
        translation: ArrayLike = (0.0, 0.0, 0.0),
        rpy: ArrayLike = (0.0, 0.0, 0.0),
    ) -> Transform:
        """From roll, pitch, yaw in radians about the parent's fixed x, y, z axes: R = Rz(yaw) Ry(pitch) Rx(roll)."""
        angles = np.asarray(rpy, dtype=np.float64)
        if angles.shape != (3,) or not np.isfinite(angles).all():
            raise _invalid("rpy", rpy, "three finite angles in radians: roll, pitch, yaw")
        cr, cp, cy = np.cos(angles / 2)
        sr, sp, sy = np.sin(angles / 2)
        rotation = (
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
            cr * cp * cy + sr * sp * sy,
        )
        return cls(parent, child, stamp, translation, rotation)

    @classmethod
    def from_scipy(
        cls, parent: str, child: str, stamp: Any, transform: Any, translation: ArrayLike | None = None
    ) -> Transform:
        """From a scipy.spatial.transform RigidTransform, or a Rotation and a translation (default: zero)."""
        rotation = getattr(transform, "rotation", transform)
        if translation is None:
            translation = getattr(transform, "translation", (0.0, 0.0, 0.0))
        return cls(parent, child, stamp, translation, rotation.as_quat())

    @classmethod
    def identity(cls, parent: str, child: str, stamp: Any = None) -> Transform:
        """Both frames at one place."""
        return cls(parent, child, stamp)

    # ---- its numbers ----

    def _doubles(self, count: int, offset: int) -> Array:
        array: Array = np.frombuffer(self, np.float64, count, offset)  # type: ignore[call-overload]
        return array

    @property
    def translation(self) -> Array:
        """(3,) read-only, metres."""
        return self._doubles(3, 0)

    @property
    def rotation(self) -> Array:
        """(4,) read-only unit quaternion x y z w, w >= 0."""
        return self._doubles(4, 24)

    @property
    def rotation_wxyz(self) -> Array:
        """(4,) read-only unit quaternion w x y z, as Eigen's constructor, MuJoCo and others order it."""
        x, y, z, w = self._values()[3:]
        return _frozen([w, x, y, z])

    @property
    def matrix(self) -> Array:
        """(4, 4) read-only homogeneous matrix."""
        return np.frombuffer(self._matrix_bytes(), np.float64).reshape(4, 4)

    @property
    def rpy(self) -> Array:
        """(3,) read-only roll, pitch, yaw in radians about the parent's fixed x, y, z axes; |pitch| <= pi/2.

        At pitch = +-pi/2 only yaw -+ roll is determined; roll is 0 then.
        """
        m = self.matrix
        horizontal = math.hypot(m[0, 0], m[1, 0])
        pitch = math.atan2(-m[2, 0], horizontal)
        if horizontal < 1e-9:
            return _frozen([0.0, pitch, math.atan2(-m[0, 1], m[1, 1])])
        return _frozen([math.atan2(m[2, 1], m[2, 2]), pitch, math.atan2(m[1, 0], m[0, 0])])

    @property
    def yaw(self) -> float:
        """The third of rpy, radians in [-pi, pi]."""
        return float(self.rpy[2])

    @property
    def used_fallback(self) -> bool:
        """Whether a lookup answered with its fallback instead of the time asked for."""
        return False

    # ---- calculating ----

    def inv(self) -> Transform:
        """T_child_parent, with the same stamp."""
        return self._inverse()

    inverse = inv

    def __matmul__(self, other: Transform) -> Transform:
        """T_a_c = T_a_b @ T_b_c.  Its stamp is the older one, its stamp_range covers both.

        Raises InvalidArgumentException unless self.child == other.parent.
        """
        if not isinstance(other, Transform):
            return NotImplemented
        if self.child != other.parent:
            raise _invalid("product", f"T_{self.parent}_{self.child} @ T_{other.parent}_{other.child}",
                           "T @ U needs T.child == U.parent; inv() turns one around")  # fmt: skip
        return self._compose(other)

    def apply(self, points: ArrayLike) -> Array:
        """Points (3,) or (N, 3) in `child` -> the same points in `parent`, metres."""
        return self.rotate(_vectors(points, "points")) + self.translation

    def rotate(self, vectors: ArrayLike) -> Array:
        """Vectors (3,) or (N, 3) in the axes of `child` -> in the axes of `parent`; no translation."""
        return _vectors(vectors, "vectors") @ self.matrix[:3, :3].T

    def transform_pose(self, position: ArrayLike, orientation: ArrayLike) -> tuple[Array, Array]:
        """Poses in `child` -> poses in `parent`: positions (3,) or (N, 3), quaternions x y z w (4,) or (N, 4)."""
        return self.apply(position), _product(self.rotation, _vectors(orientation, "orientation", 4))

    def transform_covariance(self, covariance: ArrayLike) -> Array:
        """(6, 6) covariance of a pose (x, y, z, rotations about x, y, z) in the axes of `child` -> of `parent`.

        Rotates both halves; the uncertainty of this transform itself is not added.
        """
        c = np.asarray(covariance, dtype=np.float64)
        if c.shape != (6, 6):
            raise _invalid("covariance", c.shape, "an array of shape (6, 6)")
        rr = np.zeros((6, 6))
        rr[:3, :3] = rr[3:, 3:] = self.matrix[:3, :3]
        return rr @ c @ rr.T

    def is_close(self, other: Transform, *, distance: float = 1e-9, angle: float = 1e-9) -> bool:
        """Same frames, and within `distance` metres and `angle` radians of each other.  Stamps do not count."""
        if (self.parent, self.child) != (other.parent, other.child):
            return False
        if np.linalg.norm(self.translation - other.translation) > distance:
            return False
        turn = _product(self.rotation * (-1, -1, -1, 1), other.rotation)
        return 2 * math.atan2(float(np.linalg.norm(turn[:3])), abs(float(turn[3]))) <= angle

    def to_scipy(self) -> Any:
        """A scipy.spatial.transform.RigidTransform (scipy 1.16 or newer)."""
        from scipy.spatial.transform import RigidTransform, Rotation

        return RigidTransform.from_components(self.translation, Rotation.from_quat(self.rotation))

    # ---- being a value ----

    def __eq__(self, other: object) -> bool:
        """Same frames, stamp and numbers."""
        if not isinstance(other, Transform):
            return NotImplemented
        return self._key() == other._key()

    def __hash__(self) -> int:
        return hash(self._key())

    def _key(self) -> tuple[Any, ...]:
        return self.parent, self.child, self.stamp, self._values()

    def __repr__(self) -> str:
        v = self._values()
        return f"Transform({self.parent!r}, {self.child!r}, stamp={self.stamp}, translation={v[:3]}, rotation={v[3:]})"

    def __reduce__(self) -> tuple[Any, ...]:
        state = (self.parent, self.child, self.stamp, self._values(), self.stamp_range, self.version or 0, self.edges)
        return type(self)._restore, state

    def __copy__(self) -> Transform:
        return self

    def __deepcopy__(self, memo: object) -> Transform:
        return self


def _frozen(values: list[float]) -> Array:
    return np.frombuffer(np.array(values, dtype=np.float64).tobytes(), np.float64)


_core.set_transform_type(Transform)
