"""Covariances of a solved graph, from the factor of its normal equations."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from heliograph import _core
from heliograph.arrays import Array
from heliograph.errors import GraphError
from heliograph.graph.batch.constraints import stiffen
from heliograph.graph.diagnosis.diagnosis import inspect, raise_free
from heliograph.graph.model.factor_graph import FactorGraph
from heliograph.graph.model.records import as_keys, key_list
from heliograph.graph.model.symbols import key_name
from heliograph.graph.model.values import Values
from heliograph.graph.problem.problem import Problem

__all__ = ["Marginals"]


class Marginals:
    """Gaussian approximation of what is known of the variables: the inverse of the normal equations at some values.

    Parameters
    ----------
    graph : FactorGraph
        The factors; robust kernels enter by their weights at the values.
    values : Values
        Where to linearise: a solution's.
    threads : int
        For the factorisation.

    Raises
    ------
    UnderconstrainedError
        The graph does not determine every variable.

    Notes
    -----
    Covariances are of right perturbations, rotation first. A held variable has zero covariance. Blocks come by the
    Takahashi recursion over the fronts between the asked variables and the root (docs/theory/graph.md, eq. 15); joint
    covariances by solving for their columns.

    Examples
    --------
    >>> marginals = Marginals(graph, solution.values)
    >>> marginals.covariance(keys)  # (N, 6, 6)
    >>> marginals.joint([3, 700])  # (12, 12)
    """

    __slots__ = ("_held", "_inverse", "_problem", "_values")

    def __init__(self, graph: FactorGraph, values: Values, *, threads: int = 1) -> None:
        self._problem = Problem(graph, values, threads=threads)
        self._values = values
        self._held = np.zeros(len(values), dtype=bool)
        self._held[self._problem.held] = True
        self._problem.analyze()
        stiffen(self._problem)
        self._problem.check_finite(self._problem.linearize())
        raise_free(inspect(self._problem, weighted=True, factorize=None))
        key = self._problem.factorize(0.0, 0.0)
        if key is not None:
            raise_free(inspect(self._problem, weighted=True, factorize=True))
            raise GraphError(
                f"the normal equations are not positive definite at variable {key_name(key)}, although no motion is "
                "entirely free: the information of its factors is too uneven for double precision"
            )
        self._inverse = _core.GraphInverse(self._problem.native)  # keeps what it finds for the next call

    def _dense(self, keys: ArrayLike) -> NDArray[np.int64]:
        asked = as_keys(keys).reshape(-1)
        dense = self._values.dense(asked)
        if (dense < 0).any():
            raise GraphError(f"{key_list(asked[dense < 0])}: not among the variables of this graph")
        return dense

    def covariance(self, keys: ArrayLike) -> Array:
        """Return the covariance of each variable.

        Parameters
        ----------
        keys : int or (N,) int
            Keys of one family, or of families with as many degrees of freedom.

        Returns
        -------
        (d, d) or (N, d, d) float64
            Covariance of right perturbations.
        """
        dense = self._dense(keys)
        _, dofs = self._problem.tangents(dense)
        if len(dense) == 0:
            return np.zeros((0, 0, 0))
        if (dofs != dofs[0]).any():
            raise GraphError(
                f"{key_list(keys)}: variables of {dofs.min()} and of {dofs.max()} degrees of freedom; "
                "ask for one size at a time"
            )
        d = int(dofs[0])
        out = np.zeros((len(dense), d, d))
        free = ~self._held[dense]
        if free.any():
            blocks = self._inverse.covariance_blocks(dense[free].astype(np.int32))
            out[free] = blocks.reshape(-1, d, d)
        out = 0.5 * (out + np.swapaxes(out, 1, 2))
        return out[0] if np.ndim(keys) == 0 else out

    def joint(self, keys: ArrayLike) -> Array:
        """Return the joint covariance (D, D) of several variables, in the order of the keys."""
        dense = self._dense(keys)
        if len(dense) == 0:
            return np.zeros((0, 0))
        starts, dofs = self._problem.tangents(dense)
        columns = np.concatenate([np.arange(s, s + d) for s, d in zip(starts, dofs, strict=True)])
        held = np.repeat(self._held[dense], dofs)
        right = np.zeros((len(columns), self._problem.size))
        right[np.arange(len(columns)), columns] = 1.0
        right[held] = 0.0
        joint: Array = self._problem.native.solve_for(right)[:, columns]
        joint[:, held] = 0.0
        return np.asarray(0.5 * (joint + joint.T))
