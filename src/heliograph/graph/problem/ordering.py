"""Elimination orders of a graph: which to take, and what each costs before anything is factorised."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from heliograph import _core
from heliograph.arrays import freeze
from heliograph.errors import GraphError

__all__ = ["Fill", "Pattern", "minimum_degree", "nested_dissection"]

Order = NDArray[np.int32]


@dataclass(frozen=True, slots=True, kw_only=True)
class Fill:
    """What an elimination order makes of the factor, found without factorising.

    Attributes
    ----------
    nonzeros : int
        Scalars on and below the diagonal of the Cholesky factor.
    flops : float
        Sum over its scalar columns of the square of their height: multiplications and additions of Cholesky.
    parent : (N,) int32
        Elimination tree over positions in the order, -1 at a root; a parent comes after its children.
    column_counts : (N,) int64
        Scalar height of each block column, by position, the block's own rows included.
    """

    nonzeros: int
    flops: float
    parent: NDArray[np.int32]
    column_counts: NDArray[np.int64]

    def __post_init__(self) -> None:
        freeze(self)


@dataclass(frozen=True, slots=True, kw_only=True)
class Pattern:
    """Which variables share a factor: a symmetric graph in compressed rows, no loops, no repeats.

    Attributes
    ----------
    offset : (N + 1,) int64
        Where each node's neighbours begin.
    neighbour : (E,) int32
        Neighbours of each node, ascending; each edge is there twice.
    weight : (N,) int32
        Degrees of freedom of each node, at least 1.
    """

    offset: NDArray[np.int64]
    neighbour: NDArray[np.int32]
    weight: NDArray[np.int32]

    def __post_init__(self) -> None:
        freeze(self)

    @classmethod
    def from_edges(cls, edges: ArrayLike, weight: ArrayLike) -> Pattern:
        """Build it from pairs of nodes.

        Parameters
        ----------
        edges : (E, 2) int
            Pairs of nodes numbered from 0, in any order and direction; repeats and loops are dropped.
        weight : (N,) int
            Degrees of freedom of each node.

        Raises
        ------
        GraphError
            If a pair names a node that has no weight.
        """
        weights = np.ascontiguousarray(weight, np.int32)
        pairs = np.asarray(edges, np.int64).reshape(-1, 2)
        count = len(weights)
        if pairs.size and (pairs.min() < 0 or pairs.max() >= count):
            wrong = pairs[((pairs < 0) | (pairs >= count)).any(axis=1)][0]
            raise GraphError(
                f"edge {wrong.tolist()} leaves the {count} nodes that have a weight; number nodes from 0 to {count - 1}"
            )
        pairs = pairs[pairs[:, 0] != pairs[:, 1]]
        both = np.unique(np.concatenate((pairs, pairs[:, ::-1])), axis=0)
        offset = np.zeros(count + 1, np.int64)
        np.cumsum(np.bincount(both[:, 0], minlength=count), out=offset[1:])
        return cls(offset=offset, neighbour=both[:, 1].astype(np.int32), weight=weights)

    def fill(self, order: ArrayLike) -> Fill:
        """Return what eliminating the nodes in this order costs (elimination tree and column counts).

        Raises
        ------
        GraphError
            If the order is not a permutation of the nodes.

        Notes
        -----
        Liu, "The role of elimination trees in sparse factorization", 1990; Gilbert, Ng, Peyton, "An efficient algorithm
        to compute row and column counts for sparse Cholesky factorization", 1994.
        """
        chosen = np.ascontiguousarray(order, np.int32)
        try:
            nonzeros, flops, parent, counts = _core.order_fill(self.offset, self.neighbour, self.weight, chosen)
        except ValueError as error:
            raise GraphError(f"fill of an order of {chosen.size} over {self.weight.size} nodes: {error}") from error
        return Fill(nonzeros=nonzeros, flops=flops, parent=parent, column_counts=counts)


def minimum_degree(pattern: Pattern, group: ArrayLike | None = None) -> Order:
    """Return the nodes in an order of approximately least degree, (N,) int32.

    Parameters
    ----------
    pattern : Pattern
        The graph.
    group : (N,) int, optional
        Lower groups are eliminated before higher ones: what must stay to the end gets a higher number.

    Raises
    ------
    GraphError
        If a weight is not positive or the group has another length.

    Notes
    -----
    Amestoy, Davis, Duff, "An approximate minimum degree ordering algorithm", 1996: quotient graph, element
    absorption (aggressive), supervariables, mass elimination; dense nodes go last in their group. Deterministic.
    """
    groups = np.ascontiguousarray([] if group is None else group, np.int32)
    try:
        return np.asarray(_core.order_minimum_degree(pattern.offset, pattern.neighbour, pattern.weight, groups))
    except ValueError as error:
        raise GraphError(f"minimum degree order of {pattern.weight.size} nodes: {error}") from error


def nested_dissection(pattern: Pattern) -> Order:
    """Return the nodes in an order by recursive separators, (N,) int32.

    Better than minimum degree on large graphs with many loops, and slower: what it saves is arithmetic.

    Raises
    ------
    GraphError
        If a weight is not positive.

    Notes
    -----
    George, "Nested dissection of a regular finite element mesh", 1973; multilevel as in Karypis, Kumar, "A fast and
    high quality multilevel scheme for partitioning irregular graphs", 1998. Deterministic.
    """
    try:
        return np.asarray(_core.order_nested_dissection(pattern.offset, pattern.neighbour, pattern.weight))
    except ValueError as error:
        raise GraphError(f"nested dissection of {pattern.weight.size} nodes: {error}") from error
