"""Calls of the native maps over batches. One element alone is quicker in NumPy, or in plain numbers."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from heliograph.arrays import Array

__all__ = ["each", "each_pair"]


def each(function: Callable[[Array, Array], None], x: Array, core: int, tail: tuple[int, ...]) -> Array:
    """Return the function of every element, (*batch, *tail) from (*batch, ...) with `core` axes an element."""
    out = np.empty((*x.shape[: x.ndim - core], *tail))
    function(np.ascontiguousarray(x), out)
    return out


def each_pair(function: Callable[[Array, Array, Array], None], a: Array, b: Array) -> Array:
    """Return the function of every pair of matrices, of their shape."""
    out = np.empty(a.shape)
    function(np.ascontiguousarray(a), np.ascontiguousarray(b), out)
    return out
