"""Descriptors of all keyframes in one array that grows."""

from __future__ import annotations

import numpy as np

from heliograph.arrays import Indices, Mask, as_array
from heliograph.errors import DataError
from heliograph.slam.places.protocol import Descriptor

__all__ = ["DescriptorTable"]


class DescriptorTable:
    """Rows of bytes with the keyframes' indices beside them.

    Parameters
    ----------
    width : int
        Bytes a descriptor.
    """

    def __init__(self, width: int) -> None:
        self.width = width
        self._rows = np.zeros((64, width), dtype=np.uint8)
        self._indices: list[int] = []

    def __len__(self) -> int:
        return len(self._indices)

    def add(self, index: int, descriptor: Descriptor) -> None:
        """Append a row; `DataError` if it is of another detector or setting."""
        row = as_array("descriptor", descriptor, np.uint8, (None,))
        if len(row) != self.width:
            raise DataError(
                f"the descriptor of keyframe {index} has {len(row)} bytes and this detector's have {self.width}: it "
                "was made by another method or with other settings; describe the keyframe's cloud anew"
            )
        if len(self) == len(self._rows):
            self._rows = np.concatenate([self._rows, np.zeros_like(self._rows)])
        self._rows[len(self)] = row
        self._indices.append(int(index))

    def allowed_rows(self, allowed: Mask) -> Indices:
        """Return the numbers of the rows that may be found, (M,)."""
        mask = as_array("allowed", allowed, np.bool_, (None,))
        if len(mask) != len(self):
            raise DataError(f"allowed has {len(mask)} entries for {len(self)} keyframes; give one for each, as added")
        return np.flatnonzero(mask)

    def rows(self, which: Indices) -> Descriptor:
        """Return some descriptors, (M, width)."""
        return np.asarray(self._rows[which])

    def index(self, row: int) -> int:
        """Return the keyframe of a row."""
        return self._indices[row]
