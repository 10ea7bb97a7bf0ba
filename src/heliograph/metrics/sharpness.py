"""How crisp a map is, without any truth.

References
----------
.. [1] J. Razlaw et al., "Evaluation of registration methods for sparse 3D laser scans", ECMR 2015 (mean map entropy,
   mean plane variance).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import Array, as_real
from heliograph.errors import DataError

__all__ = ["MapSharpness", "map_sharpness"]

# Half an edge along the diagonal: a wall on the boundary of one grid's cells lies in the middle of the other's.
_SHIFTS = (0.0, 0.5)
# A standard deviation below this is no property of a map [m]; it keeps the entropy of an exact plane finite.
_MIN_SIGMA_M = 1e-3
_INDEX_BITS = 21


@dataclass(frozen=True, slots=True, kw_only=True)
class MapSharpness:
    """Thickness of a map's surfaces; lower is crisper.

    Parameters
    ----------
    entropy : float
        Mean over points of the neighbourhood's Gaussian entropy ``0.5 ln det(2 pi e S)`` [nat].
    plane_variance : float
        Mean over points of the neighbourhood's smallest eigenvalue [m^2].
    thickness : float
        Its root [m].
    radius : float
        Half the edge of a neighbourhood [m].
    neighbourhoods : int
        Cells with enough points.
    coverage : float
        Share of the points that lie in one of them.
    """

    entropy: float
    plane_variance: float
    thickness: float
    radius: float
    neighbourhoods: int
    coverage: float


def map_sharpness(points: NDArray[np.floating], radius: float = 0.5, *, min_points: int = 10) -> MapSharpness:
    """Return the mean map entropy and mean plane variance [1]_ over cubes of edge ``2 radius``.

    The cubes of two grids, half an edge apart, stand in for the ball around every point, which makes five million
    points a matter of seconds.

    Parameters
    ----------
    points : (N, 3) float32 or float64
        The map [m].
    radius : float
        Half the edge of a neighbourhood: larger than the smear looked for, smaller than a room [m].
    min_points : int
        Cells with fewer points are left out.

    Raises
    ------
    DataError
        Bad arguments, values that are not finite, or no cell with enough points.

    Notes
    -----
    Compare only maps of the same place, made of about the same points (same scans, same downsampling, same radius), and
    read `coverage` beside them: points that were smeared out of every cell no longer count. It sees noise, smear and
    doubled walls; it does not see a map that is bent as a whole.
    """
    cloud = as_real("points", points)
    if cloud.ndim != 2 or cloud.shape[1] != 3 or not np.issubdtype(cloud.dtype, np.floating):
        raise DataError(f"points needs shape (N, 3) and floating-point values, got {cloud.shape} of {cloud.dtype}")
    if not radius > 0.0 or min_points < 4:
        raise DataError(f"radius {radius:g} m must be positive and min_points {min_points} at least 4")
    if not np.isfinite(cloud).all():
        raise DataError(f"{int((~np.isfinite(cloud)).any(axis=1).sum())} points are not finite; remove them first")
    grids = [_grid(cloud, 2.0 * radius, shift, min_points) for shift in _SHIFTS]
    counts = np.concatenate([count for count, _ in grids])
    eigenvalues = np.concatenate([values for _, values in grids])
    if len(counts) == 0:
        raise DataError(
            f"no cube of {2.0 * radius:g} m holds {min_points} of the {len(cloud)} points; give a larger radius or a "
            "denser map"
        )
    entropy = 0.5 * np.log(2.0 * np.pi * np.e * np.maximum(eigenvalues, _MIN_SIGMA_M**2)).sum(axis=1)
    plane_variance = float(np.average(np.maximum(eigenvalues[:, 0], 0.0), weights=counts))
    return MapSharpness(
        entropy=float(np.average(entropy, weights=counts)),
        plane_variance=plane_variance,
        thickness=float(np.sqrt(plane_variance)),
        radius=radius,
        neighbourhoods=len(counts),
        coverage=float(counts.sum() / (len(_SHIFTS) * len(cloud))),
    )


def _grid(cloud: NDArray[np.floating], edge: float, shift: float, min_points: int) -> tuple[Array, Array]:
    """Return the point counts (K,) and ascending covariance eigenvalues (K, 3) of one grid's full enough cells."""
    scaled = cloud / edge + shift
    cells = np.floor(scaled)
    if len(cells) and np.abs(cells).max() >= 2 ** (_INDEX_BITS - 1):
        far = np.abs(cloud).max()
        raise DataError(f"points lie {far:.3g} m out, too far for cells of {edge:g} m; remove the outliers")
    # Within its cell a point needs few digits: sums of squares lose nothing, however far out the map lies.
    inside = (scaled - cells - 0.5).astype(np.float64)
    index = cells.astype(np.int64) + 2 ** (_INDEX_BITS - 1)
    key = (index[:, 0] << (2 * _INDEX_BITS)) | (index[:, 1] << _INDEX_BITS) | index[:, 2]
    order = np.argsort(key, kind="stable")
    starts = np.flatnonzero(np.diff(key[order], prepend=-1))
    counts = np.diff(starts, append=len(key))
    full = counts >= min_points
    if not full.any():
        return np.zeros(0), np.zeros((0, 3))
    inside = inside[order]
    n = counts[full].astype(np.float64)
    mean = np.stack([np.add.reduceat(inside[:, i], starts)[full] for i in range(3)], axis=1) / n[:, None]
    covariance = np.empty((len(n), 3, 3))
    for i in range(3):
        for j in range(i, 3):
            second = np.add.reduceat(inside[:, i] * inside[:, j], starts)[full] / n
            covariance[:, i, j] = covariance[:, j, i] = (second - mean[:, i] * mean[:, j]) * n / (n - 1.0)
    return n, np.asarray(np.linalg.eigvalsh(covariance) * edge**2, dtype=np.float64)
