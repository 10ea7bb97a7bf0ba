"""A graph and its values, flattened for solving: the native problem, and what Python evaluates for it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from heliograph import _core
from heliograph.arrays import Array
from heliograph.errors import GraphError
from heliograph.graph.model.factor_graph import FactorGraph
from heliograph.graph.model.families import Family
from heliograph.graph.model.values import Values
from heliograph.graph.problem.resolve import ResolvedGroup, resolve, resolve_fixed
from heliograph.graph.problem.settings import ORDERINGS

__all__ = ["Cost", "Problem", "factor_costs"]


class Cost(NamedTuple):
    """Costs of a graph at some values.

    Parameters
    ----------
    chi2 : float
        Sum of squared whitened residuals: no kernel, no factor 1/2.
    cost : float
        What is minimised, ``sum w 2 rho(|r|)``; equal to chi2 without kernels and weights.
    """

    chi2: float
    cost: float


class _Custom:
    """A group of a user's own factors: evaluated in Python, in one call for all of them."""

    __slots__ = ("group", "index", "places")

    def __init__(self, index: int, group: ResolvedGroup, firsts: NDArray[np.int64], families: Sequence[Family]) -> None:
        self.index = index
        self.group = group
        self.places = []
        for column, family in zip(group.variables.T, group.families, strict=True):
            number = families.index(family)
            self.places.append((number, column.astype(np.int64) - firsts[number]))

    def arrays(self, stacked: Sequence[Array]) -> list[Array]:
        """Return the values of each variable, one row an instance."""
        return [stacked[number][rows] for number, rows in self.places]


class Problem:
    """A graph at some values, ready for solvers.

    Parameters
    ----------
    graph : FactorGraph
        Factors of any kind.
    values : Values
        One for every variable of the graph; they are copied.
    threads : int
        For the native parts; the result does not depend on it.

    Raises
    ------
    GraphError
        The graph does not fit the values; the message names factor and keys.
    """

    def __init__(self, graph: FactorGraph, values: Values, *, threads: int = 1) -> None:
        self.graph = graph
        self.start = values
        self.threads = threads
        self.families = values.families()
        self.groups = resolve(graph, values)
        counts = np.array(values.counts(), dtype=np.int64)
        self._firsts = np.concatenate([[0], np.cumsum(counts)])
        self.native = _core.GraphProblem(
            np.array([family.code for family in self.families], dtype=np.int32),
            np.array([family.dof for family in self.families], dtype=np.int32),
            counts,
        )
        self._custom = []
        for group in self.groups:
            index = self._add(group)
            if group.custom is not None:
                self._custom.append(_Custom(index, group, self._firsts, self.families))
        self.held = resolve_fixed(graph, values)
        self.native.hold(self.held.astype(np.int32))
        self.damping = np.inf  # of the last factorisation
        self.set_values(values)

    def _add(self, group: ResolvedGroup) -> int:
        noise = group.noise
        return self.native.add_group(
            group.code,
            group.variables,
            group.rows,
            group.measurement,
            noise.form,
            noise.shared,
            np.ascontiguousarray(noise.sqrt_information).reshape(-1),
            group.kernel_code,
            group.kernel_width,
        )

    @property
    def size(self) -> int:
        """Degrees of freedom of all variables, the held ones included."""
        return int(sum(family.dof * count for family, count in zip(self.families, self.start.counts(), strict=True)))

    @property
    def rows(self) -> int:
        """Numbers in all residuals."""
        return sum(group.rows * len(group.variables) for group in self.groups)

    @property
    def free_scalars(self) -> int:
        """Degrees of freedom that are estimated."""
        return self.size - int(self._dof_of(self.held).sum())

    def _dof_of(self, variables: NDArray[np.int64]) -> NDArray[np.int64]:
        dofs = np.array([family.dof for family in self.families], dtype=np.int64)
        return dofs[np.searchsorted(self._firsts, variables, side="right") - 1]

    def key_of(self, variable: int) -> int:
        """Return the key of a dense variable index."""
        return int(self.start.keys()[variable])

    def tangents(self, variables: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return where the tangents of dense variables (N,) begin in the flat vector, and their sizes, (N,) each."""
        dofs = np.array([family.dof for family in self.families], dtype=np.int64)
        bases = np.concatenate([[0], np.cumsum(dofs * np.array(self.start.counts(), dtype=np.int64))])
        number = np.searchsorted(self._firsts, variables, side="right") - 1
        return bases[number] + (variables - self._firsts[number]) * dofs[number], dofs[number]

    def analyze(self, ordering: str = "auto") -> None:
        """Order the elimination and plan its fronts."""
        self.native.analyze(ORDERINGS[ordering])

    def set_values(self, values: Values) -> None:
        """Take values of the same variables."""
        self.native.set_values(np.concatenate([packed.reshape(-1) for packed in values.packed()] or [np.zeros(0)]))

    def values(self) -> Values:
        """Return the present values."""
        return self.start.with_packed(self._blocks(self.native.values()))

    def _blocks(self, flat: Array) -> list[Array]:
        sizes = [f.storage * count for f, count in zip(self.families, self.start.counts(), strict=True)]
        parts = np.split(flat, np.cumsum(sizes)[:-1]) if sizes else []
        return [part.reshape(-1, family.storage) for part, family in zip(parts, self.families, strict=True)]

    def linearize(self) -> Cost:
        """Evaluate residuals and Jacobians at the present values and form the blocks of the normal equations."""
        if self._custom:
            self._evaluate(self.native.values(), with_jacobians=True)
        return Cost(*self.native.linearize(self.threads))

    def cost(self, *, candidate: bool = False) -> Cost:
        """Return the costs at the present values, or at the candidate's."""
        if self._custom:
            flat = self.native.candidate() if candidate else self.native.values()
            self._evaluate(flat, with_jacobians=False, finite=not candidate)
        return Cost(*self.native.cost(candidate, self.threads))

    def _evaluate(self, flat: Array, *, with_jacobians: bool, finite: bool = True) -> None:
        blocks = self._blocks(flat)
        stacked = [family.elements(block) for family, block in zip(self.families, blocks, strict=True)]
        for custom in self._custom:
            factor = custom.group.custom
            assert factor is not None
            arrays, numbers = custom.arrays(stacked), custom.group.numbers

            def name(row: int, numbers: NDArray[np.int64] = numbers) -> str:
                return self.graph.name(int(numbers[row]))

            if with_jacobians:
                residual, jacobians = factor.evaluate(
                    arrays, custom.group.data, families=custom.group.families, name=name
                )
            else:
                residual, jacobians = factor.residuals(arrays, custom.group.data, name=name, finite=finite), []
            contiguous = [np.ascontiguousarray(J) for J in jacobians]
            self.native.set_custom(custom.index, np.ascontiguousarray(residual), contiguous)

    def factorize(self, damping: float, damping_floor: float) -> int | None:
        """Factorise the (damped) normal equations; return the key at which they are not positive definite, or None."""
        variable = self.native.factorize(damping, damping_floor, self.threads)
        self.damping = np.inf if variable >= 0 else damping
        return None if variable < 0 else self.key_of(variable)

    def linear_step(self, damping: float, damping_floor: float) -> float:
        """Solve for the step and return by how much the quadratic model says that the cost falls."""
        return self.native.solve(damping, damping_floor)

    def try_step(self) -> Cost:
        """Return the costs where the step leads."""
        self.native.retract()
        return self.cost(candidate=True)

    def accept(self) -> None:
        """Make the candidate the present values."""
        self.native.accept()

    def check_finite(self, cost: Cost) -> None:
        """Raise `GraphError` that names the first factor without a finite residual, if any."""
        if np.isfinite(cost.cost):
            return
        for index, group in enumerate(self.groups):
            squared = self.native.residuals(index)[1]
            if not np.isfinite(squared).all():
                number = int(group.numbers[int(np.argmin(np.isfinite(squared)))])
                raise GraphError(
                    f"{self.graph.name(number)}: its residual is not finite at the given values; "
                    "mend the values of its variables or its measurement"
                )
        raise GraphError(
            f"the cost is {cost.cost} although every residual is finite: the residuals are too large to square"
        )


def factor_costs(graph: FactorGraph, values: Values) -> Array:
    """Return what each factor costs, (N,); see `FactorGraph.errors`."""
    problem, out = Problem(graph, values), np.zeros(len(graph))
    problem.cost()
    for index, group in enumerate(problem.groups):
        squared = problem.native.residuals(index)[1]
        out[group.numbers] = 0.5 * squared if group.kernel is None else group.kernel.cost(np.sqrt(squared))
    return out
