"""Argument checks that the records share: shape, dtype, layout, finiteness."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from heliograph.errors import DataError

__all__ = ["frozen"]


def frozen(
    name: str, value: ArrayLike, dtype: DTypeLike, shape: tuple[int | None, ...], *, finite: bool = False
) -> NDArray[Any]:
    """Return a read-only C-contiguous view of ``value``, or raise `DataError` if it is not what the record promises.

    Parameters
    ----------
    name : str
        The field's name, for the message.
    value : array_like
        Already of the right dtype: a silent conversion would hide a wrong unit, so it is an error.
    dtype : dtype
        Required dtype.
    shape : tuple
        Required shape; None leaves a length free.
    finite : bool
        Refuse NaN and infinity.
    """
    array: NDArray[Any] = np.asarray(value)
    if array.dtype != np.dtype(dtype):
        raise DataError(f"{name} has dtype {array.dtype}, expected {np.dtype(dtype)}; convert it explicitly")
    if array.ndim != len(shape) or any(
        want is not None and want != got for want, got in zip(shape, array.shape, strict=True)
    ):
        wanted = "(" + ", ".join("N" if n is None else str(n) for n in shape) + ")"
        raise DataError(f"{name} has shape {array.shape}, expected {wanted}")
    if finite and not np.isfinite(array).all():
        raise DataError(f"{name} holds {int(np.count_nonzero(~np.isfinite(array)))} values that are not finite")
    array = np.ascontiguousarray(array).view()
    array.flags.writeable = False
    return array
