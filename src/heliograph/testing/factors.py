"""The law of factors."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence

import numpy as np

from heliograph.arrays import Array
from heliograph.errors import GraphError
from heliograph.graph.model.factor import Factor
from heliograph.graph.model.families import Family
from heliograph.lie.groups import MatrixGroup
from heliograph.testing.jacobians import numeric_jacobian, random_tangent

__all__ = ["assert_factor"]


def assert_factor(
    factor: type[Factor],
    rng: np.random.Generator,
    data: Callable[[np.random.Generator, int], Sequence[Array]] | None = None,
    *,
    unchanged_by: Callable[[np.random.Generator, Sequence[Array]], Sequence[Array]] | None = None,
    tolerance: float = 1e-6,
) -> None:
    """Assert the shapes of a user's factor, that instances do not mix, and its Jacobians at large errors.

    Where a variable may be of several families, for each of them.

    Parameters
    ----------
    factor : type
        Derived from `heliograph.graph.Factor`.
    rng : numpy.random.Generator
        Draws the variables: rotations of up to 3 rad, positions and vectors of metres.
    data : callable, optional
        Called with a generator and N, draws the data, each (N, ...).
    unchanged_by : callable, optional
        Called with a generator and the variables' arrays, moves them to where the residual must be the same: an
        invariance that the factor claims, such as moving the whole world.
    tolerance : float
        For Jacobians, relative to their largest number or to 1; identities must hold to a thousandth of it.
    """
    for families in itertools.product(*factor.families):
        _assert_factor_of(factor, families, rng, data, unchanged_by, tolerance)


def _assert_factor_of(
    factor: type[Factor],
    families: Sequence[Family],
    rng: np.random.Generator,
    data: Callable[[np.random.Generator, int], Sequence[Array]] | None,
    unchanged_by: Callable[[np.random.Generator, Sequence[Array]], Sequence[Array]] | None,
    tolerance: float,
) -> None:
    """Assert the law of factors for variables of these families."""
    count, name = 9, factor.__name__
    arrays = [_elements(family, rng, count) for family in families]
    items = [np.asarray(item, dtype=np.float64) for item in (data(rng, count) if data is not None else ())]
    residual, jacobians = _evaluated(factor, families, arrays, items)
    scale = max(1.0, float(np.abs(residual).max()))
    for row in range(count):
        one = slice(row, row + 1)
        alone, alone_jacobians = _evaluated(factor, families, [a[one] for a in arrays], [item[one] for item in items])
        law = f"{name}: instance {row} alone is not what it is in the batch,"
        bound = 1e-3 * tolerance * scale
        np.testing.assert_allclose(alone, residual[one], rtol=0, atol=bound, err_msg=f"{law} residual")
        for k, (found, expected) in enumerate(zip(alone_jacobians, jacobians, strict=True)):
            bound = 1e-3 * tolerance * max(1.0, float(np.abs(expected).max()))
            np.testing.assert_allclose(found, expected[one], rtol=0, atol=bound, err_msg=f"{law} Jacobian {k}")
        for k, (family, J) in enumerate(zip(families, jacobians, strict=True)):
            moved = _residual_of_step(factor, family, arrays, items, row, k)
            slope = numeric_jacobian(moved, np.zeros(family.dof))
            bound = tolerance * max(1.0, float(np.abs(slope).max()))
            case = f"{name}: the Jacobian of instance {row} by variable {k} ({family.name})"
            np.testing.assert_allclose(J[row], slope, rtol=0, atol=bound, err_msg=case)
    if unchanged_by is not None:
        elsewhere, _ = _evaluated(factor, families, unchanged_by(rng, arrays), items)
        law = f"{name}: the residual changes with what it should not depend on"
        np.testing.assert_allclose(elsewhere, residual, rtol=0, atol=tolerance * scale, err_msg=law)


def _elements(family: Family, rng: np.random.Generator, count: int) -> Array:
    """Return random values of a family, (N, *shape)."""
    if family.lie is None:
        return 3.0 * rng.normal(size=(count, family.dof))
    if not issubclass(family.lie, MatrixGroup):
        return np.asarray(family.lie(rng.normal(size=(count, 3))).vector)
    group = family.lie
    return np.stack([group.exp(3.0 * random_tangent(group, rng, rng.uniform(0.1, 1.0))).matrix for _ in range(count)])


def _evaluated(
    factor: type[Factor], families: Sequence[Family], arrays: Sequence[Array], data: Sequence[Array]
) -> tuple[Array, list[Array]]:
    try:
        return factor.evaluate(arrays, data, families=families)
    except GraphError as error:
        raise AssertionError(str(error)) from error


def _residual_of_step(
    factor: type[Factor], family: Family, arrays: Sequence[Array], data: Sequence[Array], row: int, variable: int
) -> Callable[[Array], Array]:
    """Return the residual (rows,) of one instance as a function of a step (dof,) of one variable."""
    one = slice(row, row + 1)

    def residual(step: Array) -> Array:
        moved = [array[one] for array in arrays]
        moved[variable] = family.retract(moved[variable], step[None])
        return np.asarray(factor.residuals(moved, [item[one] for item in data])[0])

    return residual
