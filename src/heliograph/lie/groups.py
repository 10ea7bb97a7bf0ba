"""Lie group elements as values: a thin skin over the array functions, for readable code outside hot loops."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, TypeVar, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from heliograph.arrays import Array, as_batch, freeze, match
from heliograph.errors import DataError
from heliograph.lie import s2, se2, se3, se23, so2, so3

__all__ = ["S2", "SE2", "SE3", "SO2", "SO3", "ExtendedPose", "MatrixGroup"]

Self = TypeVar("Self", bound="MatrixGroup")


@dataclass(frozen=True, slots=True, eq=False)
class MatrixGroup:
    """What the five matrix groups share; use a subclass.

    Parameters
    ----------
    matrix : (..., k, k) float64
        One element or a batch, trusted to lie on the group.
    """

    matrix: Array

    ops: ClassVar[Any]  # the module with the array functions
    size: ClassVar[int]  # of the matrix
    dof: ClassVar[int]  # of the tangent space
    turns: ClassVar[int]  # how many of the tangent's numbers are rotation; they come first
    space: ClassVar[int]  # dimension of the points it acts on; 0: it acts on none

    def __post_init__(self) -> None:
        value = as_batch(f"the matrix of {type(self).__name__}", self.matrix, (self.size, self.size))
        object.__setattr__(self, "matrix", value.copy())
        freeze(self)

    @classmethod
    def identity(cls: type[Self], batch: tuple[int, ...] = ()) -> Self:
        """Return the neutral element."""
        return cls(cls.ops.identity(batch))

    @classmethod
    def exp(cls: type[Self], tangent: ArrayLike) -> Self:
        """Return the element of a tangent vector (..., dof), rotation first."""
        return cls(cls.ops.exp(tangent))

    def log(self) -> Array:
        """Return the tangent vector (..., dof) with ``exp(log()) = self``."""
        return np.asarray(self.ops.log(self.matrix), dtype=np.float64)

    def inverse(self: Self) -> Self:
        """Return the inverse."""
        return type(self)(self.ops.inverse(self.matrix))

    def adjoint(self) -> Array:
        """Return Ad with ``X exp(d) = exp(Ad d) X``, (..., dof, dof)."""
        return np.asarray(self.ops.adjoint(self.matrix), dtype=np.float64)

    def retract(self: Self, d: ArrayLike) -> Self:
        """Return ``self @ exp(d)``."""
        return type(self)(self.ops.retract(self.matrix, d))

    def local(self: Self, other: Self) -> Array:
        """Return the d with ``self.retract(d) = other``, (..., dof)."""
        return np.asarray(self.ops.local(self.matrix, other.matrix), dtype=np.float64)

    @classmethod
    def right_jacobian(cls, tangent: ArrayLike) -> Array:
        """Return Jr with ``exp(x + d) = exp(x) exp(Jr d)`` to first order, (..., dof, dof)."""
        return np.asarray(cls.ops.right_jacobian(tangent), dtype=np.float64)

    @classmethod
    def right_jacobian_inverse(cls, tangent: ArrayLike) -> Array:
        """Return the inverse of `right_jacobian`, (..., dof, dof)."""
        return np.asarray(cls.ops.right_jacobian_inverse(tangent), dtype=np.float64)

    @overload
    def __matmul__(self: Self, other: Self) -> Self: ...
    @overload
    def __matmul__(self, other: ArrayLike) -> Array: ...
    def __matmul__(self: Self, other: Any) -> Any:
        """Compose with an element of the same group, or act on points (..., space)."""
        if isinstance(other, MatrixGroup):
            if type(other) is not type(self):
                return NotImplemented
            match("both elements", self.matrix.shape, other.matrix.shape)
            return type(self)(self.matrix @ other.matrix)
        if self.space == 0:
            raise DataError(f"{type(self).__name__} does not act on points; use its rotation and position")
        return self._act(as_batch(f"an array of points for {type(self).__name__}", other, (self.space,)))

    def _act(self, points: Array) -> Array:
        if self.matrix.ndim > 2:
            match("rotations and points", self.matrix.shape[:-2], points.shape[:-1])
        return np.asarray((self.matrix @ points[..., None])[..., 0], dtype=np.float64)

    def __getitem__(self: Self, index: int | slice | NDArray[Any]) -> Self:
        """Return a part of the batch."""
        if self.matrix.ndim == 2:
            raise TypeError(f"a single {type(self).__name__} has no batch to index")
        return type(self)(self.matrix[index])

    def __len__(self) -> int:
        if self.matrix.ndim == 2:
            raise TypeError(f"a single {type(self).__name__} has no length")
        return len(self.matrix)


@dataclass(frozen=True, slots=True, eq=False)
class SO2(MatrixGroup):
    """A rotation of the plane."""

    ops: ClassVar[Any] = so2
    size: ClassVar[int] = 2
    dof: ClassVar[int] = 1
    turns: ClassVar[int] = 1
    space: ClassVar[int] = 2


@dataclass(frozen=True, slots=True, eq=False)
class SO3(MatrixGroup):
    """A rotation of space."""

    ops: ClassVar[Any] = so3
    size: ClassVar[int] = 3
    dof: ClassVar[int] = 3
    turns: ClassVar[int] = 3
    space: ClassVar[int] = 3

    @classmethod
    def from_quaternion(cls, xyzw: ArrayLike) -> SO3:
        """Return the rotation of a quaternion (x, y, z, w)."""
        return cls(so3.from_quaternion(xyzw))

    def to_quaternion(self) -> Array:
        """Return the unit quaternion (x, y, z, w) with w >= 0."""
        return so3.to_quaternion(self.matrix)


@dataclass(frozen=True, slots=True, eq=False)
class _Rigid(MatrixGroup):
    """What SE(2) and SE(3) share."""

    @classmethod
    def from_rotation_translation(cls: type[RigidSelf], R: ArrayLike, t: ArrayLike) -> RigidSelf:
        """Return the motion ``p -> R p + t``."""
        return cls(cls.ops.from_rotation_translation(R, t))

    @property
    def rotation(self) -> Array:
        """The rotation matrix, (..., space, space)."""
        return self.matrix[..., :-1, :-1]

    @property
    def translation(self) -> Array:
        """The translation, (..., space) [m]."""
        return self.matrix[..., :-1, -1]

    def _act(self, points: Array) -> Array:
        return np.asarray(self.ops.act(self.matrix, points), dtype=np.float64)


RigidSelf = TypeVar("RigidSelf", bound=_Rigid)


@dataclass(frozen=True, slots=True, eq=False)
class SE2(_Rigid):
    """A rigid motion of the plane; tangent (theta, x, y)."""

    ops: ClassVar[Any] = se2
    size: ClassVar[int] = 3
    dof: ClassVar[int] = 3
    turns: ClassVar[int] = 1
    space: ClassVar[int] = 2


@dataclass(frozen=True, slots=True, eq=False)
class SE3(_Rigid):
    """A rigid motion of space; tangent (theta_x, theta_y, theta_z, x, y, z)."""

    ops: ClassVar[Any] = se3
    size: ClassVar[int] = 4
    dof: ClassVar[int] = 6
    turns: ClassVar[int] = 3
    space: ClassVar[int] = 3


@dataclass(frozen=True, slots=True, eq=False)
class ExtendedPose(MatrixGroup):
    """Attitude, position and velocity (SE_2(3)); tangent (theta_x, theta_y, theta_z, x, y, z, vx, vy, vz)."""

    ops: ClassVar[Any] = se23
    size: ClassVar[int] = 5
    dof: ClassVar[int] = 9
    turns: ClassVar[int] = 3
    space: ClassVar[int] = 0

    @classmethod
    def from_rotation_position_velocity(cls, R: ArrayLike, p: ArrayLike, v: ArrayLike) -> ExtendedPose:
        """Return the element of a rotation (..., 3, 3), a position (..., 3) [m] and a velocity (..., 3) [m/s]."""
        return cls(se23.from_rotation_position_velocity(R, p, v))

    @property
    def rotation(self) -> Array:
        """The rotation matrix, (..., 3, 3)."""
        return self.matrix[..., :3, :3]

    @property
    def position(self) -> Array:
        """The position, (..., 3) [m]."""
        return self.matrix[..., :3, 3]

    @property
    def velocity(self) -> Array:
        """The velocity, (..., 3) [m/s]."""
        return self.matrix[..., :3, 4]


@dataclass(frozen=True, slots=True, eq=False)
class S2:
    """A direction in space.

    Parameters
    ----------
    vector : (..., 3) float64
        One or a batch; made unit length.
    """

    vector: Array

    dof: ClassVar[int] = 2

    def __post_init__(self) -> None:
        value = as_batch("the vector of S2", self.vector, (3,))
        lengths = np.linalg.norm(value, axis=-1)
        if not np.all((lengths > 0.0) & np.isfinite(lengths)):
            bad = int(np.count_nonzero(~((lengths > 0.0) & np.isfinite(lengths))))
            raise DataError(f"{bad} of {lengths.size} directions are zero or not finite; give non-zero vectors")
        object.__setattr__(self, "vector", value / lengths[..., None])
        freeze(self)

    def basis(self) -> Array:
        """Return the basis of the tangent plane, (..., 3, 2)."""
        return s2.basis(self.vector)

    def retract(self, d: ArrayLike) -> S2:
        """Return the direction reached along ``basis() @ d`` by the angle ``|d|``, d (..., 2) [rad]."""
        return S2(s2.retract(self.vector, d))

    def local(self, other: S2) -> Array:
        """Return the d with ``self.retract(d) = other``, (..., 2) [rad]."""
        return s2.local(self.vector, other.vector)

    def retract_jacobian(self, d: ArrayLike) -> Array:
        """Return the derivative of the retraction by d, (..., 3, 2)."""
        return s2.retract_jacobian(self.vector, d)
