"""Clouds prepared for registration, and the surfaces at their points: normals and covariances."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from heliograph import _core
from heliograph.arrays import freeze
from heliograph.config import AlignConfig
from heliograph.errors import ConfigError, DataError

__all__ = ["PreparedCloud", "estimate_covariances", "estimate_normals", "prepare_cloud"]

Array = NDArray[np.float64]
_ON_LINE = 1e-3  # of its length, a cloud is as thick as this at most when it is called a line
_FAR = 1000.0  # single precision holds a tenth of a millimetre up to here [m]


@dataclass(frozen=True, slots=True, kw_only=True)
class PreparedCloud:
    """A cloud with the surfaces that registration uses; prepare once what is aligned often.

    Parameters
    ----------
    native : object
        The prepared cloud of the native core.
    points : (N, 3) float32
        The points, less ``origin`` [m].
    origin : (3,) float64
        What was taken off coordinates in double precision, so that single precision suffices; else zero [m].
    used : int
        Points that are finite.
    config : AlignConfig
        What it was prepared with.
    """

    native: _core.SurfaceCloud
    points: NDArray[np.float32]
    origin: Array
    used: int
    config: AlignConfig

    def __post_init__(self) -> None:
        freeze(self)

    def __len__(self) -> int:
        return self.used


def prepare_cloud(
    points: NDArray[np.float32] | Array, config: AlignConfig | None = None, *, name: str = "cloud", threads: int = 1
) -> PreparedCloud:
    """Prepare a cloud for `align`.

    Parameters
    ----------
    points : (N, 3) float32 or float64
        Any frame [m]; NaN is left out. C-contiguous float32 is used in place. Float64, such as UTM coordinates, is
        moved near the origin before it is narrowed.
    config : AlignConfig, optional
    name : str
        For messages.
    threads : int
        The result does not depend on it.

    Raises
    ------
    DataError
        Wrong shape or dtype, fewer than three finite points, all on one line, or in another unit than metres.
    """
    config = config or AlignConfig()
    narrow, origin = _narrow(points, name)
    native = _core.SurfaceCloud(
        narrow,
        config.voxel,
        config.levels if config.voxel > 0.0 else 1,
        config.max_thickness,
        config.min_support if config.voxel > 0.0 else config.neighbours,
        threads,
    )
    used = native.finite()
    _check_content(native, len(narrow), used, config, name)
    return PreparedCloud(native=native, points=narrow, origin=origin, used=used, config=config)


def _narrow(points: NDArray[np.float32] | Array, name: str) -> tuple[NDArray[np.float32], Array]:
    array: NDArray[Any] = np.asarray(points)
    if array.ndim != 2 or array.shape[1] != 3:
        raise DataError(f"{name} has shape {array.shape}; points are (N, 3)")
    if array.dtype == np.float32:
        return np.ascontiguousarray(array), np.zeros(3)
    if array.dtype != np.float64:
        raise DataError(f"{name} has dtype {array.dtype}; points are float32 or float64 metres: convert them")
    finite = np.isfinite(array).all(axis=1)
    middle = np.median(array[finite], axis=0) if finite.any() else np.zeros(3)
    origin = np.round(middle) if np.abs(middle).max(initial=0.0) > _FAR else np.zeros(3)
    return np.ascontiguousarray(array - origin, dtype=np.float32), origin


def _check_content(native: _core.SurfaceCloud, given: int, used: int, config: AlignConfig, name: str) -> None:
    if used < 3:
        raise DataError(f"{name} has {used} finite points of {given}; an alignment needs at least three, and surfaces")
    extent = native.extent(native.levels() - 1)
    if extent > config.max_extent:
        raise DataError(
            f"{name} spans {extent:.0f} m, more than {config.max_extent:.0f}: are its coordinates in millimetres? "
            "divide them by 1000, or raise max_extent"
        )
    _, across, along = native.spread(0)
    if across <= _ON_LINE * along:
        raise DataError(
            f"all {used} points of {name} lie within {across:.2g} m of one line or place, which says nothing of a turn "
            "about it; give a cloud with surfaces"
        )


def estimate_normals(
    points: NDArray[np.float32], *, neighbours: int = 10, viewpoint: Array | None = None, threads: int = 1
) -> NDArray[np.float32]:
    """Return a unit normal for each point, (N, 3): the direction in which its nearest neighbours scatter least.

    Parameters
    ----------
    points : (N, 3) float32
        Any frame [m], not copied.
    neighbours : int
        Nearest points that make a surface, the point itself included.
    viewpoint : (3,) float64, optional
        The normals are turned towards it; by default to the origin, where a scan's sensor is.
    threads : int
        The result does not depend on it.

    Returns
    -------
    (N, 3) float32
        NaN where the point is not finite or its neighbours lie on one line.

    Raises
    ------
    DataError
        Wrong shape or dtype.
    ConfigError
        Fewer than three neighbours.
    """
    index, axes, values = _point_surfaces(points, neighbours, threads)
    n = axes[:, 0]
    towards = (np.zeros(3) if viewpoint is None else np.asarray(viewpoint)) - points[index]
    n = np.where((np.einsum("ij,ij->i", n, towards) < 0.0)[:, None], -n, n)
    n[values[:, 1] <= 1e-9 * np.maximum(values[:, 2], 1e-30)] = np.nan
    out = np.full(points.shape, np.nan, dtype=np.float32)
    out[index] = n
    return out


def estimate_covariances(points: NDArray[np.float32], *, neighbours: int = 10, threads: int = 1) -> Array:
    """Return the covariance of each point's nearest neighbours, (N, 3, 3) [m^2]; NaN where a point is not finite.

    Parameters
    ----------
    points : (N, 3) float32
        Any frame [m], not copied.
    neighbours, threads : int
        As for `estimate_normals`.
    """
    index, axes, values = _point_surfaces(points, neighbours, threads)
    out = np.full((len(points), 3, 3), np.nan)
    out[index] = np.einsum("nk,nki,nkj->nij", values, axes, axes)
    return out


def _point_surfaces(
    points: NDArray[np.float32], neighbours: int, threads: int
) -> tuple[NDArray[np.uint32], Array, Array]:
    if neighbours < 3:
        raise ConfigError(f"neighbours = {neighbours}: a surface needs at least 3 points")
    if points.dtype != np.float32 or points.ndim != 2 or points.shape[1] != 3:
        raise DataError(f"points have shape {points.shape} and dtype {points.dtype}; they are (N, 3) float32 metres")
    native = _core.SurfaceCloud(np.ascontiguousarray(points), 0.0, 1, 1.0, neighbours, threads)
    _, _, axes, values, *_ = native.elements(0)
    return np.asarray(native.source()), np.asarray(axes, dtype=np.float64), np.asarray(values, dtype=np.float64)
