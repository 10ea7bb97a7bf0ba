"""Built-in factors of directions and planes of the world, as a body sees them.

A plane is ``n . x = d``: its normal n is an S2, its distance d from the origin a vector of one number. Both are known,
or variables of the graph.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from heliograph.arrays import Array, Keys
from heliograph.errors import GraphError
from heliograph.graph.model.families import FAMILIES, Family, vectors
from heliograph.graph.model.kernels import Kernel
from heliograph.graph.model.noise import Noise
from heliograph.graph.model.records import NativeRecord, as_measurement, key_columns
from heliograph.lie import S2, SE3, SO3, ExtendedPose

__all__ = ["Attitude", "Plane", "PointToPlane"]

_POSES = (FAMILIES[SE3], FAMILIES[ExtendedPose])
_DIRECTION, _DISTANCE = (FAMILIES[S2],), (vectors(1),)


class Attitude(NativeRecord):
    """A direction of the world is seen by a body: ``Z.local(R' d)``, such as that in which things fall.

    Parameters
    ----------
    key : int or (N,) int
        Keys of the bodies: SO3, SE3 or ExtendedPose.
    direction : S2
        Measured, in the frame of the body.
    noise : Noise
        Noise of two rows [rad] (in the tangent basis of `heliograph.lie.s2` at the measurement).
    world : S2 or int or (N,) int
        The same direction in the world: known, or the key of an S2 variable.
    kernel : Kernel, optional
        For robust costs.

    Raises
    ------
    GraphError
        Keys that are no integers, different numbers of keys and directions, or what is no direction.
    """

    __slots__ = ()
    type: ClassVar[int] = 10

    def __init__(
        self, key: ArrayLike, direction: S2, noise: Noise, *, world: S2 | ArrayLike, kernel: Kernel | None = None
    ) -> None:
        known = isinstance(world, S2)
        keys = key_columns("Attitude", (key,) if isinstance(world, S2) else (key, world))
        parts = [_directions("Attitude", direction, len(keys))]
        if known:
            parts.append(_directions("Attitude", world, len(keys)))
        self._fill(
            keys=keys,
            measurement=np.concatenate(parts, axis=1),
            measured=None,
            rows=2,
            noise=noise,
            kernel=kernel,
            allowed=((FAMILIES[SO3], *_POSES), *([] if known else [_DIRECTION])),
        )

    def flaws(self) -> NDArray[np.bool_]:
        """Return which measurements (N,) are no directions."""
        return _no_directions(self.measurement)


class Plane(NativeRecord):
    """A pose sees a plane: the normal in its own frame, and its distance: ``[Z.local(R' n); d - n . p - z]``.

    Parameters
    ----------
    key : int or (N,) int
        Keys of the poses, SE3 or ExtendedPose.
    normal : S2
        Measured, in the frame of the pose.
    distance : float or (N,) float64
        Measured from the pose's origin to the plane, along the normal [m].
    noise : Noise
        Noise of three rows: two angles [rad], and the distance [m].
    plane : (S2, float or (N,) float64) or (int, int)
        Normal and distance in the world: known, or the keys of their variables (an S2 and a vector of dimension 1).
    kernel : Kernel, optional
        For robust costs.

    Raises
    ------
    GraphError
        Keys that are no integers, different numbers of keys and measurements, or what is no plane.
    """

    __slots__ = ()
    type: ClassVar[int] = 11

    def __init__(
        self,
        key: ArrayLike,
        normal: S2,
        distance: ArrayLike,
        noise: Noise,
        *,
        plane: tuple[S2 | ArrayLike, ArrayLike],
        kernel: Kernel | None = None,
    ) -> None:
        keys, known = _keys_with_plane("Plane", key, plane)
        seen = np.concatenate([_directions("Plane", normal, len(keys)), _numbers("Plane", distance, len(keys))], axis=1)
        self._fill(
            keys=keys,
            measurement=np.concatenate([seen, known], axis=1),
            measured=None,
            rows=3,
            noise=noise,
            kernel=kernel,
            allowed=(_POSES, *([_DIRECTION, _DISTANCE] if keys.shape[1] == 3 else [])),
        )

    def flaws(self) -> NDArray[np.bool_]:
        """Return which measurements (N,) are no planes."""
        bad = _no_directions(self.measurement[:, :3]) | ~np.isfinite(self.measurement).all(axis=1)
        return bad | _no_directions(self.measurement[:, 4:7])


class PointToPlane(NativeRecord):
    """A point that a pose sees lies on a plane: ``n . (R q + p) - d``.

    Parameters
    ----------
    key : int or (N,) int
        Keys of the poses that see the points, SE3 or ExtendedPose.
    point : (3,) or (N, 3) float64
        In the frame of the pose [m].
    noise : Noise
        Noise of one row [m].
    plane : (S2, float or (N,) float64) or (int, int)
        Normal and distance in the world: known, or the keys of their variables (an S2 and a vector of dimension 1).
    seen_by : int or (N,) int, optional
        Keys of other poses, in whose frames the (known) planes lie, instead of the world.
    kernel : Kernel, optional
        For robust costs.

    Raises
    ------
    GraphError
        Keys that are no integers, different numbers of keys and points, or what is no plane.
    """

    __slots__ = ()
    type: ClassVar[int] = 12

    def __init__(
        self,
        key: ArrayLike,
        point: ArrayLike,
        noise: Noise,
        *,
        plane: tuple[S2 | ArrayLike, ArrayLike],
        seen_by: ArrayLike | None = None,
        kernel: Kernel | None = None,
    ) -> None:
        keys, known = _keys_with_plane("PointToPlane", key, plane)
        variable = keys.shape[1] == 3
        if seen_by is not None:
            if variable:
                raise GraphError("PointToPlane: a plane seen by a pose is known in its frame, not a variable")
            keys = key_columns("PointToPlane", (seen_by, key))
        points, family = as_measurement("PointToPlane", point, len(keys))
        if family.dof != 3 or family.lie is not None:
            raise GraphError(f"PointToPlane: points have 3 coordinates, got {family.name}")
        allowed = (_POSES, _POSES) if seen_by is not None else (_POSES, *([_DIRECTION, _DISTANCE] if variable else []))
        self._fill(
            keys=keys,
            measurement=np.concatenate([points, known], axis=1),
            measured=None,
            rows=1,
            noise=noise,
            kernel=kernel,
            allowed=allowed,
        )

    def flaws(self) -> NDArray[np.bool_]:
        """Return which points and planes (N,) are none."""
        return _no_directions(self.measurement[:, 3:6]) | ~np.isfinite(self.measurement).all(axis=1)


def _keys_with_plane(kind: str, key: ArrayLike, plane: object) -> tuple[Keys, Array]:
    """Return the keys (N, 1 or 3), and known planes (N, 4) or (N, 0)."""
    if not isinstance(plane, tuple) or len(plane) != 2:
        raise GraphError(f"{kind}: a plane is a tuple of normal (S2) and distance, or of the keys of both")
    normal, distance = plane
    if not isinstance(normal, S2):
        keys = key_columns(kind, (key, normal, distance))
        return keys, np.zeros((len(keys), 0))
    keys = key_columns(kind, (key,))
    return keys, np.concatenate([_directions(kind, normal, len(keys)), _numbers(kind, distance, len(keys))], axis=1)


def _directions(kind: str, value: object, count: int) -> Array:
    if not isinstance(value, S2):
        raise GraphError(f"{kind}: a direction is an S2, not a {type(value).__name__}")
    return as_measurement(kind, value, count)[0]


def _numbers(kind: str, value: ArrayLike, count: int) -> Array:
    array = np.asarray(value, dtype=np.float64)
    if array.ndim > 1:
        raise GraphError(f"{kind}: distances are one number or (N,), got shape {array.shape}")
    return as_measurement(kind, array.reshape(-1, 1), count)[0]


def _no_directions(columns: Array) -> NDArray[np.bool_]:
    """Return where one of the directions (N, 3) or (N, 6) is not finite or not of unit length."""
    family: Family = FAMILIES[S2]
    bad = np.zeros(len(columns), dtype=bool)
    for first in range(0, columns.shape[1], 3):
        bad |= family.off_manifold(columns[:, first : first + 3])
    return bad
