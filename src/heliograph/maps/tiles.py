"""Large cubes of space, one after the other: how a map of any length is put together in bounded memory."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from heliograph import _core
from heliograph.arrays import as_array

__all__ = ["TileSplit", "split_tiles"]


class TileSplit(NamedTuple):
    """Which cells lie in which tile.

    Parameters
    ----------
    tiles : (T, 3) int32
        Index of each tile along the axes, in the order in which cells reach them.
    begin : (T + 1,) uint32
        Where each tile's cells begin in ``cells``.
    cells : (L,) uint32
        Indices of cells, ascending within a tile.
    """

    tiles: NDArray[np.int32]
    begin: NDArray[np.uint32]
    cells: NDArray[np.uint32]


def split_tiles(cubes: NDArray[np.int32], edge: int, halo: int) -> TileSplit:
    """Split the cubes (M, 3) of a map by tiles of ``edge`` cubes; one within ``halo`` of a tile belongs to it too."""
    return TileSplit(*_core.split_tiles(as_array("cubes", cubes, np.int32, (None, 3)), edge, halo))
