"""An array that grows by rows."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import Array
from heliograph.snapshots import Snapshot, array, require

__all__ = ["GrowingRows"]


class GrowingRows:
    """Rows of one shape: all of them are there as one array at any time.

    Parameters
    ----------
    *shape : int
        Lengths of a row.
    dtype : type
    """

    def __init__(self, *shape: int, dtype: type = float) -> None:
        self._array: NDArray[Any] = np.zeros((64, *shape), dtype=dtype)
        self._count = 0

    def append(self, row: Array | int) -> None:
        """Add a row."""
        if self._count == len(self._array):
            more = np.zeros((max(64, self._count), *self._array.shape[1:]), dtype=self._array.dtype)
            self._array = np.concatenate([self._array, more])
        self._array[self._count] = row
        self._count += 1

    @property
    def all(self) -> NDArray[Any]:
        """A view that later rows do not reach."""
        return self._array[: self._count]

    def snapshot(self) -> Snapshot:
        """Return the rows."""
        return {"rows": self.all}

    def restore(self, snapshot: Snapshot) -> None:
        """Hold the rows of another one, and no others; `DataError` where they are of another shape."""
        require(self, snapshot, {"rows": array(self._array.dtype, None, *self._array.shape[1:])})
        self._array, self._count = np.array(snapshot["rows"]), len(snapshot["rows"])
