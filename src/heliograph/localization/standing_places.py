"""Where one could stand in a map that does not tell from where it was seen: floors with room above them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import Array

__all__ = ["standing_places"]

_CELL = 0.5  # columns that are looked at [m]
_LAYER = 0.2  # and their layers [m]
_ROOM = 1.6  # free height above a floor [m]
_EYE = 1.2  # height of a sensor above it [m]
_STOREY = 2.0  # floors of one tile that differ by less are one [m]
_SHARE = 0.25  # of a tile's columns that have a floor at that height: the top of a shelf is none


def standing_places(points: NDArray[np.float32], tile: float) -> Array:
    """Return places (M, 3) above the floors of a map, at most one a storey in each tile.

    Parameters
    ----------
    points : (N, 3) float32
        Finite, z up [m].
    tile : float
        Edge of the tiles [m].
    """
    column = np.floor(points[:, :2] / np.float32(_CELL)).astype(np.int64)
    layer = np.floor(points[:, 2] / np.float32(_LAYER)).astype(np.int64)
    cells = np.unique(np.column_stack([column, layer]), axis=0)  # sorted by column, then height
    same = (np.diff(cells[:, :2], axis=0) == 0).all(axis=1)
    free = np.append(np.where(same, np.diff(cells[:, 2]), 1 << 30), 1 << 30)
    # The uppermost surface counts too: outdoors it is the ground.
    floors = cells[free * _LAYER > _ROOM]
    middle = np.column_stack([(floors[:, :2] + 0.5) * _CELL, (floors[:, 2] + 0.5) * _LAYER])
    tiles = np.floor(middle[:, :2] / tile).astype(np.int64)
    order = np.lexsort((middle[:, 2], tiles[:, 1], tiles[:, 0]))
    tiles, middle = tiles[order], middle[order]
    new_tile = np.append(True, (np.diff(tiles, axis=0) != 0).any(axis=1))
    groups = [storey for part in np.split(middle, np.flatnonzero(new_tile)[1:]) for storey in _storeys(part)]
    wide = [group for group in groups if len(group) >= _SHARE * (tile / _CELL) ** 2]
    return np.array([[*np.median(group[:, :2], axis=0), np.median(group[:, 2]) + _EYE] for group in wide])


def _storeys(middle: Array) -> list[Array]:
    """Return the floors (N, 3) of a tile, lowest first, cut wherever one lies a storey above the lowest so far."""
    parts = []
    while len(middle):
        low = middle[:, 2] <= middle[0, 2] + _STOREY
        parts.append(middle[low])
        middle = middle[~low]
    return parts
