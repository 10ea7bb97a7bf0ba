"""What joining two local maps at a pose does to their sharpness: a wall beside a wall is a blur.

References
----------
.. [1] O. K. Smith, "Eigenvalues of a symmetric 3 x 3 matrix", Communications of the ACM 4(4), 1961.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import Array, Points
from heliograph.maps import transformed

__all__ = ["joined_blur"]

_MIN_POINTS = 4  # of each local map in a cube that counts
_MIN_SIGMA_M = 5e-3  # of a cube's thickness: below it, a plane is as sharp as it need be
_TABLE = 1 << 16  # entries of a table of cubes: those that share one do no harm, they are told apart afterwards
_THINNED = 10_000  # points of each local map that are looked at: the mean over their cubes is good to a hundredth


def joined_blur(target: Points, source: Points, T_target_source: Array, edge: float) -> float:
    """Return by how much the entropy of cubes grows when the points of two clouds are joined in them [nat].

    Entropy is that of the points' Gaussian, as in `heliograph.metrics.map_sharpness`, here over the cubes that both
    clouds reach and less the mean of the two clouds' own: what only one reaches does not change, and would drown the
    rest. NaN where they reach no cube together.

    Parameters
    ----------
    target, source : (N, 3) float32
        Clouds, finite [m].
    T_target_source : (4, 4) float64
        The pose.
    edge : float
        Edge of a cube [m].
    """
    a, b = (cloud[:: max(1, len(cloud) // _THINNED)] for cloud in (target, source))
    moved = transformed(b, T_target_source)
    cells = np.floor(np.concatenate([a, moved]) / np.float32(edge)).astype(np.int64)
    cells -= cells.min(axis=0)
    size = cells.max(axis=0) + 1
    keys = (cells[:, 0] * size[1] + cells[:, 1]) * size[2] + cells[:, 2]
    # Cubes that only one reaches do not count: most points are let go before anything is sorted.
    table = keys % _TABLE
    few = [np.bincount(some, minlength=_TABLE) < _MIN_POINTS for some in (table[: len(a)], table[len(a) :])]
    kept = ~(few[0] | few[1])[table]
    of_a, of_b = kept[: len(a)], kept[len(a) :]
    found, which = np.unique(keys[kept], return_inverse=True)
    first = _moments(a[of_a], which[: of_a.sum()], len(found))
    second = _moments(moved[of_b], which[of_a.sum() :], len(found))
    both = (first[0] >= _MIN_POINTS) & (second[0] >= _MIN_POINTS)
    if not both.any():
        return float("nan")
    first, second = ((count[both], total[both], products[both]) for count, total, products in (first, second))
    own = [_entropy(*part) for part in (first, second)]
    joined = _entropy(*(x + y for x, y in zip(first, second, strict=True)))
    return float(np.average(joined - 0.5 * (own[0] + own[1]), weights=np.minimum(first[0], second[0])))


def _moments(points: Points, which: NDArray[np.int64], cells: int) -> tuple[Array, Array, Array]:
    """Count, sum (K, 3) and sum of products (K, 3, 3) of each cell's points."""
    p = points.astype(np.float64)
    count = np.bincount(which, minlength=cells).astype(np.float64)
    total = np.stack([np.bincount(which, p[:, i], cells) for i in range(3)], axis=1)
    products = np.empty((cells, 3, 3))
    for i in range(3):
        for j in range(i, 3):
            products[:, i, j] = products[:, j, i] = np.bincount(which, p[:, i] * p[:, j], cells)
    return count, np.asarray(total, dtype=np.float64), products


def _entropy(count: Array, total: Array, products: Array) -> Array:
    mean = total / count[:, None]
    covariance = products / count[:, None, None] - mean[:, :, None] * mean[:, None, :]
    values = np.maximum(_eigenvalues(covariance), _MIN_SIGMA_M**2)
    return np.asarray(0.5 * np.log(2.0 * np.pi * np.e * values).sum(axis=1))


def _eigenvalues(S: Array) -> Array:
    """Return the eigenvalues (K, 3) of symmetric matrices (K, 3, 3), by the trigonometric formula [1]_."""
    mean = np.trace(S, axis1=1, axis2=2) / 3.0
    off = S - mean[:, None, None] * np.eye(3)
    spread = np.sqrt(np.einsum("kij,kij->k", off, off) / 6.0)
    a, b, c = off[:, 0], off[:, 1], off[:, 2]
    half_det = 0.5 * np.einsum("ki,ki->k", a, np.cross(b, c)) / np.maximum(spread, 1e-150) ** 3
    angle = np.arccos(np.clip(half_det, -1.0, 1.0)) / 3.0
    thirds = 2.0 * np.pi / 3.0 * np.arange(3)
    return np.asarray(mean[:, None] + 2.0 * spread[:, None] * np.cos(angle[:, None] + thirds))
