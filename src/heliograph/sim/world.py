"""Worlds of textured rectangles, boxes and cylinders, and casting rays into them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from heliograph import _core
from heliograph.arrays import freeze, frozen
from heliograph.errors import DataError

__all__ = ["PRIMITIVE_COLUMNS", "SHAPES", "Returns", "SimulatedWorld", "Surface", "box", "cylinder", "rectangle"]

SHAPES = {"rectangle": 0, "box": 1, "cylinder": 2}
PRIMITIVE_COLUMNS = 18


@dataclass(frozen=True, slots=True, kw_only=True)
class Surface:
    """How a primitive reflects: a checkerboard in three dimensions, fixed to it.

    Parameters
    ----------
    reflectivity : float
        Reflectivity of the brighter cells, in (0, 1].
    contrast : float
        The darker cells reflect ``1 - contrast`` of that, in [0, 1].
    period : float
        Edge of a cell [m].
    """

    reflectivity: float = 0.5
    contrast: float = 0.3
    period: float = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class Primitive:
    """One thing in a world; make it with `rectangle`, `box` or `cylinder`.

    Parameters
    ----------
    shape : str
        ``"rectangle"`` (local z = 0), ``"box"``, or ``"cylinder"`` (axis along local z, with both caps).
    center : (3,) float64
        In the world [m].
    half : (3,) float64
        Half-extents [m]; of a cylinder: radius, radius, half of the height.
    R_world_local : (3, 3) float64
        Orientation.
    surface : Surface
        How it reflects.
    """

    shape: str
    center: NDArray[np.float64]
    half: NDArray[np.float64]
    R_world_local: NDArray[np.float64]
    surface: Surface

    def __post_init__(self) -> None:
        if self.shape not in SHAPES:
            raise DataError(f"shape '{self.shape}' is none of {', '.join(SHAPES)}")
        for name, shape in (("center", (3,)), ("half", (3,)), ("R_world_local", (3, 3))):
            object.__setattr__(self, name, frozen(name, getattr(self, name), np.float64, shape, finite=True))
        if (self.half < 0.0).any() or self.half[0] == 0.0:
            raise DataError(f"half-extents must be positive, got {self.half.tolist()}")


def _primitive(
    shape: str, center: ArrayLike, half: ArrayLike, R: NDArray[np.float64] | None, surface: Surface | None
) -> Primitive:
    return Primitive(
        shape=shape,
        center=np.array(center, dtype=np.float64),
        half=np.array(half, dtype=np.float64),
        R_world_local=np.eye(3) if R is None else R,
        surface=surface or Surface(),
    )


def rectangle(
    center: ArrayLike, size: ArrayLike, R_world_local: NDArray[np.float64], surface: Surface | None = None
) -> Primitive:
    """Return a two-sided rectangle of ``size`` (along local x, local y) [m] with its normal along local z."""
    width, height = np.asarray(size, dtype=np.float64)
    return _primitive("rectangle", center, (width / 2.0, height / 2.0, 0.0), R_world_local, surface)


def box(
    center: ArrayLike,
    size: ArrayLike,
    R_world_local: NDArray[np.float64] | None = None,
    surface: Surface | None = None,
) -> Primitive:
    """Return a box of ``size`` [m] along its local axes."""
    return _primitive("box", center, np.asarray(size, dtype=np.float64) / 2.0, R_world_local, surface)


def cylinder(
    center: ArrayLike,
    radius: float,
    height: float,
    R_world_local: NDArray[np.float64] | None = None,
    surface: Surface | None = None,
) -> Primitive:
    """Return a capped cylinder about its local z axis [m]."""
    return _primitive("cylinder", center, (radius, radius, height / 2.0), R_world_local, surface)


@dataclass(frozen=True, slots=True, kw_only=True)
class Returns:
    """What a sweep's rays hit; all arrays are (rows, columns).

    Parameters
    ----------
    range : float64
        Exact distance [m]; 0 where nothing lies between the sensor's limits.
    brightness : float32
        Reflectivity times the cosine of incidence, in [0, 1].
    primitive : int32
        Index in the world; -1 where nothing was hit.
    """

    range: NDArray[np.float64]
    brightness: NDArray[np.float32]
    primitive: NDArray[np.int32]

    def __post_init__(self) -> None:
        freeze(self)


class SimulatedWorld:
    """An immutable set of primitives, indexed for ray casting.

    Parameters
    ----------
    primitives : iterable of Primitive
        Where two surfaces coincide, the one named first is seen.
    """

    def __init__(self, primitives: Iterable[Primitive]) -> None:
        self.primitives = tuple(primitives)
        self.packed, self.shapes = self._pack()
        self._scene = _core.Scene(self.packed, self.shapes)

    def __len__(self) -> int:
        return len(self.primitives)

    def _pack(self) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
        packed = np.empty((len(self.primitives), PRIMITIVE_COLUMNS))
        for row, p in zip(packed, self.primitives, strict=True):
            row[:9], row[9:12], row[12:15] = p.R_world_local.ravel(), p.center, p.half
            row[15:] = p.surface.reflectivity, p.surface.contrast, p.surface.period
        return packed, np.array([SHAPES[p.shape] for p in self.primitives], dtype=np.int32)

    def cast(
        self,
        directions: NDArray[np.float64],
        T_world_sensor: NDArray[np.float64],
        *,
        min_range: float = 0.0,
        max_range: float = 1e9,
        threads: int = 1,
    ) -> Returns:
        """Return the nearest hit of every ray.

        Parameters
        ----------
        directions : (R, C, 3) float64
            Unit vectors in the sensor frame.
        T_world_sensor : (C, 4, 4) float64
            Pose of the sensor at each column's firing.
        min_range, max_range : float
            Hits outside are not seen [m].
        threads : int
            The result does not depend on it.

        Raises
        ------
        DataError
            If a shape is wrong.
        """
        rows_columns = directions.shape[:2]
        directions = frozen("directions", directions, np.float64, (*rows_columns, 3))
        poses = frozen("T_world_sensor", T_world_sensor, np.float64, (rows_columns[1], 4, 4))
        hit = self._scene.cast(directions, poses, min_range, max_range, threads)
        return Returns(range=hit[0], brightness=hit[1], primitive=hit[2])

    def distance(self, points_world: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return how far points (N, 3) lie from the nearest surface, inside or outside of what it bounds, (N,) [m].

        Raises
        ------
        DataError
            An array of another dtype or shape.
        """
        points = frozen("points_world", points_world, np.float64, (None, 3))
        nearest = np.full(len(points), np.inf)
        for p in self.primitives:
            local = (points - p.center) @ p.R_world_local
            beyond = np.abs(local) - p.half
            if p.shape == "cylinder":
                beyond = np.column_stack([np.hypot(local[:, 0], local[:, 1]) - p.half[0], beyond[:, 2]])
            distance = np.linalg.norm(np.maximum(beyond, 0.0), axis=1)
            if p.shape != "rectangle":  # which has no inside
                distance = np.where((beyond <= 0.0).all(axis=1), -beyond.max(axis=1), distance)
            np.minimum(nearest, distance, out=nearest)
        return nearest
