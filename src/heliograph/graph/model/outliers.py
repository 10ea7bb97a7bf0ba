"""Which factors may be outliers, and the weights of graduated non-convexity."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from heliograph.arrays import Array, Mask
from heliograph.errors import GraphError
from heliograph.graph.model.factor_graph import FactorGraph
from heliograph.graph.model.factors import Between

__all__ = ["geman_mcclure_weight", "truncated_weight", "trusted_factors"]


def truncated_weight(squared: Array, mu: float) -> Array:
    """Return the weights of truncated least squares for residuals in units of their threshold ([1]_ eq. 14).

    References
    ----------
    .. [1] H. Yang et al., "Graduated non-convexity for robust spatial perception", RA-L 2020.
    """
    low, high = mu / (mu + 1.0), (mu + 1.0) / mu
    between = np.sqrt(mu * (mu + 1.0) / np.maximum(squared, 1e-100)) - mu
    return np.clip(np.where(squared >= high, 0.0, np.where(squared <= low, 1.0, between)), 0.0, 1.0)


def geman_mcclure_weight(squared: Array, mu: float) -> Array:
    """Return the weights of Geman-McClure for residuals in units of their threshold ([1]_ eq. 12).

    References
    ----------
    .. [1] H. Yang et al., "Graduated non-convexity for robust spatial perception", RA-L 2020.
    """
    return np.asarray((mu / (mu + squared)) ** 2)


def trusted_factors(graph: FactorGraph, trusted: ArrayLike | None) -> Mask:
    """Return which factors are trusted, (N,); without a choice all but loops: keys that do not follow each other."""
    known = np.zeros(len(graph), dtype=bool)
    if trusted is None:
        for added in graph.groups():
            keys, span = added.record.keys, slice(added.first, added.first + len(added.record))
            apart = isinstance(added.record, Between)
            known[span] = np.abs(keys[:, 0] - keys[:, -1]) == 1 if apart else True
        return known
    given = np.asarray(trusted)
    if given.dtype == np.bool_:
        if given.shape != known.shape:
            raise GraphError(f"trusted: a mask of shape {given.shape} for {len(graph)} factors")
        known[:] = given
        return known
    numbers = given.astype(np.int64).reshape(-1)
    if len(numbers) and (numbers.min() < 0 or numbers.max() >= len(graph)):
        raise GraphError(
            f"trusted: factors {numbers.min()} to {numbers.max()}, but the graph has 0 to {len(graph) - 1}"
        )
    known[numbers] = True
    return known
