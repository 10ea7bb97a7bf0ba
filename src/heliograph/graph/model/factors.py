"""Built-in factors. Each record holds N of them and is evaluated natively, with exact Jacobians by right perturbation.

Keys are one int or (N,) ints a variable; measurements are one for all or one each; so is the noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from heliograph.arrays import Array
from heliograph.errors import GraphError
from heliograph.graph.model.families import FAMILIES, Family, Value, vectors
from heliograph.graph.model.kernels import Kernel
from heliograph.graph.model.noise import Noise
from heliograph.graph.model.records import NativeRecord, as_measurement, key_columns
from heliograph.lie import S2, SE2, SE3, SO2, SO3, ExtendedPose

__all__ = [
    "Bearing",
    "BearingRange",
    "Between",
    "Landmark",
    "LinearMotion",
    "PartialPrior",
    "Position",
    "Prior",
    "Range",
]


# What has a frame to look from, and what has a place to be seen at, by the dimension of the space.
_POSES = {2: (FAMILIES[SE2],), 3: (FAMILIES[SE3], FAMILIES[ExtendedPose])}
_PLACED = {2: (vectors(2), *_POSES[2]), 3: (vectors(3), *_POSES[3])}

# Variables that hold what is measured: a motion in space begins with its rotation, an extended pose with its pose.
_HOLDERS = {SO3: (FAMILIES[SO3], *_POSES[3]), SE3: _POSES[3]}


def _holders(measured: Family) -> tuple[Family, ...]:
    return _HOLDERS.get(measured.lie, (measured,)) if measured.lie is not None else (measured,)


# By the class of a single measurement.
_ONE_HOLDER = {lie: (_holders(family),) for lie, family in FAMILIES.items()}
_TWO_HOLDERS = {lie: 2 * allowed for lie, allowed in _ONE_HOLDER.items() if lie is not S2}


class Prior(NativeRecord):
    """A variable is measured: ``Log(Z^-1 X)``, for directions ``Z.local(X)``, for vectors ``x - z``.

    Parameters
    ----------
    key : int or (N,) int
        The variable's key, or one for each of N factors.
    value : lie value or (d,) or (N, d) float64
        Measured; its family is the variable's. An SE3 may also measure the pose of an ExtendedPose, an SO3 the rotation
        of an SE3 or ExtendedPose: then it says nothing of the rest.
    noise : Noise
        Noise of the residual, as many rows as the value's family has degrees of freedom.
    kernel : Kernel, optional
        For robust costs.

    Raises
    ------
    GraphError
        Keys that are no integers, or different numbers of keys and measurements.
    """

    __slots__ = ()
    type: ClassVar[int] = 1

    def __init__(self, key: ArrayLike, value: Value, noise: Noise, *, kernel: Kernel | None = None) -> None:
        if self._fill_single((key,), value, noise, kernel, _ONE_HOLDER):
            return
        keys = key_columns("Prior", (key,))
        measurement, family = as_measurement("Prior", value, len(keys))
        self._fill(
            keys=keys,
            measurement=measurement,
            measured=family,
            rows=family.dof,
            noise=noise,
            kernel=kernel,
            allowed=(_holders(family),),
        )


class PartialPrior(NativeRecord):
    """Some rows of a `Prior`: ``Log(Z^-1 X)[rows]``.

    The rows of a motion are the rotation, about the axes of Z, then position (and velocity), along them, to first order
    in the error. What is measured along the axes of the world is rather a `Position`; all of the rotation rather a
    `Prior` with an SO3.

    Parameters
    ----------
    key : int or (N,) int
        The variable's key, or one for each of N factors.
    value : lie value or (d,) or (N, d) float64
        Its rows that are not chosen say nothing.
    rows : sequence of int
        Which rows, ascending.
    noise : Noise
        Noise of the chosen rows.
    kernel : Kernel, optional
        For robust costs.

    Raises
    ------
    GraphError
        Keys that are no integers, different numbers of keys and measurements, or rows that the family does not have.
    """

    __slots__ = ()
    type: ClassVar[int] = 8

    def __init__(
        self, key: ArrayLike, value: Value, rows: Sequence[int], noise: Noise, *, kernel: Kernel | None = None
    ) -> None:
        keys = key_columns("PartialPrior", (key,))
        measurement, family = as_measurement("PartialPrior", value, len(keys))
        chosen = list(rows)
        if not chosen or sorted(set(chosen)) != chosen or chosen[0] < 0 or chosen[-1] >= family.dof:
            raise GraphError(f"PartialPrior: rows are ascending numbers of 0 to {family.dof - 1}, got {chosen}")
        numbers = np.broadcast_to(np.array(chosen, dtype=np.float64), (len(keys), len(chosen)))
        self._fill(
            keys=keys,
            measurement=np.concatenate([measurement, numbers], axis=1),
            measured=family,
            rows=len(chosen),
            noise=noise,
            kernel=kernel,
            allowed=((family,),),
        )

    def flaws(self) -> NDArray[np.bool_]:
        """Return which values (N,) are not finite or not on their manifold."""
        assert self.measured is not None
        value = self.measurement[:, : self.measured.storage]
        return self.measured.off_manifold(self.measured.elements(value))


class Between(NativeRecord):
    """The motion from one variable to another is measured: ``Log(Z^-1 Xi^-1 Xj)``, for vectors ``xj - xi - z``.

    Parameters
    ----------
    i, j : int or (N,) int
        Keys of the two variables.
    T_i_j : SE2, SE3, SO2, SO3, ExtendedPose or (d,) or (N, d) float64
        Measured; its family is that of both variables. An SE3 may also join the poses of ExtendedPose variables, an SO3
        the rotations of SE3 and ExtendedPose ones.
    noise : Noise
        Noise of the residual, as many rows as the measurement has degrees of freedom, rotation first.
    kernel : Kernel, optional
        For robust costs.

    Raises
    ------
    GraphError
        Keys that are no integers, different numbers of keys and measurements, or a family without differences.
    """

    __slots__ = ()
    type: ClassVar[int] = 2

    def __init__(self, i: ArrayLike, j: ArrayLike, T_i_j: Value, noise: Noise, *, kernel: Kernel | None = None) -> None:
        if self._fill_single((i, j), T_i_j, noise, kernel, _TWO_HOLDERS):
            return
        keys = key_columns("Between", (i, j))
        measurement, family = as_measurement("Between", T_i_j, len(keys))
        if family.lie is S2:
            raise GraphError("Between: directions have no difference that is a direction; write a Factor of your own")
        self._fill(
            keys=keys,
            measurement=measurement,
            measured=family,
            rows=family.dof,
            noise=noise,
            kernel=kernel,
            allowed=(_holders(family), _holders(family)),
        )

    def mismatch(self, families: tuple[Family, ...]) -> str | None:
        """Return what is wrong with variables of these families, or None."""
        bare = [family for family in families if family.lie is SO3]
        if len(bare) == 1 and super().mismatch(families) is None:
            names = ", ".join(family.name for family in families)
            return f"Between joins two rotations or two poses, but its variables are {names}"
        return super().mismatch(families)


class Range(NativeRecord):
    """The distance between two positions is measured: ``|p_j - p_i| - z``.

    Parameters
    ----------
    i, j : int or (N,) int
        Keys of poses or points, both in the plane or both in space.
    distance : float or (N,) float64
        Measured, not negative [m].
    noise : Noise
        Noise of one row [m].
    kernel : Kernel, optional
        For robust costs.

    Raises
    ------
    GraphError
        Keys that are no integers, or different numbers of keys and distances.
    """

    __slots__ = ()
    type: ClassVar[int] = 3

    def __init__(
        self, i: ArrayLike, j: ArrayLike, distance: ArrayLike, noise: Noise, *, kernel: Kernel | None = None
    ) -> None:
        keys = key_columns("Range", (i, j))
        z = np.asarray(distance, dtype=np.float64)
        if z.ndim > 1:
            raise GraphError(f"Range: distances are one number or (N,), got shape {z.shape}")
        measurement, _ = as_measurement("Range", z.reshape(-1, 1), len(keys))
        placed = (*_PLACED[2], *_PLACED[3])
        self._fill(
            keys=keys,
            measurement=measurement,
            measured=None,
            rows=1,
            noise=noise,
            kernel=kernel,
            allowed=(placed, placed),
        )

    def flaws(self) -> NDArray[np.bool_]:
        """Return which distances (N,) are not finite or negative."""
        return ~((self.measurement[:, 0] >= 0.0) & np.isfinite(self.measurement[:, 0]))

    def mismatch(self, families: tuple[Family, ...]) -> str | None:
        """Return what is wrong with variables of these families, or None."""
        first, second = families
        if first.space != second.space and first.space and second.space:
            return f"Range needs two positions in the same space, but its variables are {first.name}, {second.name}"
        return super().mismatch(families)


class Bearing(NativeRecord):
    """The direction from a pose to a position is measured: ``Z.local(direction to j in the frame of i)``.

    Parameters
    ----------
    i : int or (N,) int
        Keys of the poses that look.
    j : int or (N,) int
        Keys of the points or poses that are seen.
    direction : SO2 or S2
        Measured in the frame of i: an SO2 for poses SE2, an S2 for poses SE3 and ExtendedPose.
    noise : Noise
        Noise of one row [rad] in the plane, of two in space (in the tangent basis of `heliograph.lie.s2` there).
    kernel : Kernel, optional
        For robust costs.

    Raises
    ------
    GraphError
        Keys that are no integers, different numbers of keys and directions, or no direction.
    """

    __slots__ = ()
    type: ClassVar[int] = 4

    def __init__(
        self, i: ArrayLike, j: ArrayLike, direction: Value, noise: Noise, *, kernel: Kernel | None = None
    ) -> None:
        keys = key_columns("Bearing", (i, j))
        if not isinstance(direction, (SO2, S2)):
            raise GraphError(
                f"Bearing: a direction is an SO2 (poses SE2) or an S2 (poses SE3), not a {type(direction).__name__}"
            )
        measurement, family = as_measurement("Bearing", direction, len(keys))
        space = 2 if family.lie is SO2 else 3
        self._fill(
            keys=keys,
            measurement=measurement,
            measured=family,
            rows=family.dof,
            noise=noise,
            kernel=kernel,
            allowed=(_POSES[space], _PLACED[space]),
        )


class BearingRange(NativeRecord):
    """Direction and distance from a pose to a position are measured: the rows of `Bearing`, then that of `Range`.

    Parameters
    ----------
    i, j : int or (N,) int
        Keys as of `Bearing`.
    direction : SO2 or S2
        Measured in the frame of i, as of `Bearing`.
    distance : float or (N,) float64
        Measured, not negative [m].
    noise : Noise
        Noise of two rows in the plane, of three in space: angles [rad], then the distance [m].
    kernel : Kernel, optional
        For robust costs.

    Raises
    ------
    GraphError
        Keys that are no integers, different numbers of keys and measurements, or no direction.
    """

    __slots__ = ()
    type: ClassVar[int] = 9

    def __init__(
        self,
        i: ArrayLike,
        j: ArrayLike,
        direction: Value,
        distance: ArrayLike,
        noise: Noise,
        *,
        kernel: Kernel | None = None,
    ) -> None:
        angles = Bearing(i, j, direction, noise)
        lengths = Range(i, j, distance, noise)
        family = angles.measured
        assert family is not None
        self._fill(
            keys=angles.keys,
            measurement=np.concatenate([angles.measurement, lengths.measurement], axis=1),
            measured=None,
            rows=family.dof + 1,
            noise=noise,
            kernel=kernel,
            allowed=angles.allowed,
        )

    def flaws(self) -> NDArray[np.bool_]:
        """Return which measurements (N,) are not finite, no direction, or of a negative distance."""
        direction, distance = self.measurement[:, :-1], self.measurement[:, -1]
        long = np.abs(np.einsum("ni,ni->n", direction, direction) - 1.0)
        return np.asarray(~((long <= 1e-3) & (distance >= 0.0) & np.isfinite(distance)))


class Landmark(NativeRecord):
    """A point is measured in the frame of a pose: ``Ti^-1 p_j - z``.

    Parameters
    ----------
    i : int or (N,) int
        Keys of the poses: SE2, or SE3 and ExtendedPose.
    j : int or (N,) int
        Keys of the points: vectors of dimension 2 or 3, or poses, whose position is meant.
    p_i : (d,) or (N, d) float64
        Measured in the frame of i [m].
    noise : Noise
        Noise of d rows, in the frame of i.
    kernel : Kernel, optional
        For robust costs.

    Raises
    ------
    GraphError
        Keys that are no integers, different numbers of keys and points, or a dimension that is neither 2 nor 3.
    """

    __slots__ = ()
    type: ClassVar[int] = 5

    def __init__(
        self, i: ArrayLike, j: ArrayLike, p_i: ArrayLike, noise: Noise, *, kernel: Kernel | None = None
    ) -> None:
        keys = key_columns("Landmark", (i, j))
        measurement, dimension = _points("Landmark", p_i, len(keys))
        self._fill(
            keys=keys,
            measurement=measurement,
            measured=None,
            rows=dimension,
            noise=noise,
            kernel=kernel,
            allowed=(_POSES[dimension], _PLACED[dimension]),
        )


class Position(NativeRecord):
    """The position of a variable is measured in the world: ``p - z``.

    Parameters
    ----------
    key : int or (N,) int
        Keys of poses (SE2, SE3, ExtendedPose) or points.
    p_world : (d,) or (N, d) float64
        Measured [m], d is 2 or 3.
    noise : Noise
        Noise of d rows, along the world's axes.
    kernel : Kernel, optional
        For robust costs.

    Raises
    ------
    GraphError
        Keys that are no integers, different numbers of keys and points, or a dimension that is neither 2 nor 3.
    """

    __slots__ = ()
    type: ClassVar[int] = 6

    def __init__(self, key: ArrayLike, p_world: ArrayLike, noise: Noise, *, kernel: Kernel | None = None) -> None:
        keys = key_columns("Position", (key,))
        measurement, dimension = _points("Position", p_world, len(keys))
        self._fill(
            keys=keys,
            measurement=measurement,
            measured=None,
            rows=dimension,
            noise=noise,
            kernel=kernel,
            allowed=(_PLACED[dimension],),
        )


def _points(kind: str, points: ArrayLike, count: int) -> tuple[Array, int]:
    if not isinstance(points, (np.ndarray, list, tuple)):
        raise GraphError(f"{kind}: points are an array (d,) or (N, d), not a {type(points).__name__}")
    measurement, family = as_measurement(kind, points, count)
    if family.dof not in (2, 3):
        raise GraphError(f"{kind}: points have 2 or 3 coordinates, got {family.dof}")
    return measurement, family.dof


class LinearMotion(NativeRecord):
    """One vector follows linearly from another: ``x_j - F x_i - u``.

    Parameters
    ----------
    i, j : int or (N,) int
        Keys of the vectors before (dimension d_i) and after (d_j).
    F : (d_j, d_i) or (N, d_j, d_i) float64
        Transition matrix.
    u : (d_j,) or (N, d_j) float64
        What is added.
    noise : Noise
        Noise of d_j rows.
    kernel : Kernel, optional
        For robust costs.

    Raises
    ------
    GraphError
        Keys that are no integers, or shapes that do not fit together.
    """

    __slots__ = ()
    type: ClassVar[int] = 7

    def __init__(
        self, i: ArrayLike, j: ArrayLike, F: ArrayLike, u: ArrayLike, noise: Noise, *, kernel: Kernel | None = None
    ) -> None:
        keys = key_columns("LinearMotion", (i, j))
        transition, offset = np.asarray(F, dtype=np.float64), np.asarray(u, dtype=np.float64)
        if transition.ndim not in (2, 3) or offset.shape[-1:] != transition.shape[-2:-1]:
            raise GraphError(
                f"LinearMotion: F is (d_j, d_i) or (N, d_j, d_i) and u (d_j,) or (N, d_j), got shapes "
                f"{transition.shape} and {offset.shape}"
            )
        after, before = transition.shape[-2:]
        families = vectors(before), vectors(after)
        count = len(keys)
        try:
            flat_F = np.broadcast_to(transition.reshape(-1, after * before), (count, after * before))
            flat_u = np.broadcast_to(offset.reshape(-1, after), (count, after))
        except ValueError:
            raise GraphError(
                f"LinearMotion: F of shape {transition.shape} and u of shape {offset.shape} for {count} factors"
            ) from None
        self._fill(
            keys=keys,
            # What is broadcast joins column by column; the native side reads rows.
            measurement=np.ascontiguousarray(np.concatenate([flat_F, flat_u], axis=1)),
            measured=None,
            rows=after,
            noise=noise,
            kernel=kernel,
            allowed=((families[0],), (families[1],)),
        )
