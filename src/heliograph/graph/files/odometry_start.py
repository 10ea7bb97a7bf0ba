"""First poses of a pose graph from its relative poses alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from heliograph import _core
from heliograph.arrays import Indices, freeze
from heliograph.errors import DataError
from heliograph.lie import SE2, SE3

__all__ = ["SpanningStart", "distinct", "odometry_start"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SpanningStart:
    """Poses along a spanning tree of each component.

    Parameters
    ----------
    ids : (N,) int64
        The poses, ascending.
    matrices : (N, k, k) float64
        T_root_i in the frame of the component's root.
    root : (N,) int64
        The lowest id of each pose's component, which is at the origin.
    parent : (N,) int64
        The id that each pose was placed from; its own at a root.
    """

    ids: Indices
    matrices: NDArray[np.float64]
    root: Indices
    parent: Indices

    def __post_init__(self) -> None:
        freeze(self)


def distinct(ids: Indices) -> Indices:
    """Return the ids that occur, ascending; by sorting, which for long arrays beats the hashing of `numpy.unique`."""
    ordered = np.sort(ids, axis=None)
    return ordered[np.concatenate([[True], np.diff(ordered) != 0])] if len(ordered) else ordered


def odometry_start(i: ArrayLike, j: ArrayLike, T_i_j: SE2 | SE3, ids: ArrayLike | None = None) -> SpanningStart:
    """Return poses from relative poses: odometry first, the rest by a breadth-first spanning tree.

    The lowest id of a component is at the origin. Each next id follows by its edge from the previous one, in either
    direction and by the first of parallel edges, as far as that goes; what remains is placed breadth first from there.

    Parameters
    ----------
    i, j : (E,) int
        The ids that each edge joins.
    T_i_j : SE2 or SE3, batch of E
        Relative poses.
    ids : (N,) int, optional
        All poses, where some may have no edge; each of those is at the origin of a component of its own.

    Raises
    ------
    DataError
        The numbers of ids and relative poses differ.
    """
    first, second = (np.atleast_1d(np.asarray(x, dtype=np.int64)) for x in (i, j))
    size = T_i_j.size
    relative = np.ascontiguousarray(T_i_j.matrix.reshape(-1, size, size))
    if not len(first) == len(second) == len(relative):
        raise DataError(
            f"{len(first)} ids i, {len(second)} ids j and {len(relative)} relative poses do not fit together"
        )
    both = [first, second] if ids is None else [first, second, np.asarray(ids, dtype=np.int64)]
    names = distinct(np.concatenate(both))
    index = [np.searchsorted(names, x).astype(np.int32) for x in (first, second)]
    matrices, root, parent = _core.spanning_start(len(names), index[0], index[1], relative)
    return SpanningStart(ids=names, matrices=matrices, root=names[root], parent=names[parent])
