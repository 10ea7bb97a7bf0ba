"""Derivatives by differences, and random tangent vectors."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from heliograph.arrays import Array
from heliograph.lie.groups import MatrixGroup

__all__ = ["assert_jacobian", "numeric_jacobian", "random_tangent", "rotations"]


def numeric_jacobian(f: Callable[[Array], Array], x: Array, *, step: float = 1e-3) -> Array:
    """Return the derivative of ``f`` at ``x`` by a five-point stencil, (..., m, n) for ``f: (n,) -> (..., m)``.

    Parameters
    ----------
    f : callable
        Takes a vector.
    x : (n,) float64
        Where.
    step : float
        Its truncation error is ``step^4 / 30`` times the fifth derivative, its rounding error about ``1e-16 / step``.
    """
    x = np.asarray(x, dtype=np.float64)
    columns = []
    for direction in np.eye(len(x)):
        d = step * direction
        near, far = f(x + d) - f(x - d), f(x + 2.0 * d) - f(x - 2.0 * d)
        columns.append((8.0 * near - far) / (12.0 * step))
    return np.stack(columns, axis=-1)


def assert_jacobian(
    f: Callable[[Array], Array], x: Array, J: Array, *, step: float = 1e-3, rtol: float = 1e-7, atol: float = 1e-9
) -> None:
    """Assert that ``J`` (..., m, n) is the derivative of ``f`` at ``x`` (n,).

    For arguments on a manifold pass ``lambda d: f(X.retract(d))`` and ``x = 0``; for values on one, their `local` from
    the value at ``x``. Use points where the residual is large: a Jacobian that holds only near zero is wrong.
    """
    expected = numeric_jacobian(f, x, step=step)
    np.testing.assert_allclose(J, expected, rtol=rtol, atol=atol, err_msg=f"the Jacobian at x = {np.asarray(x)}")


def random_tangent(group: type[MatrixGroup], rng: np.random.Generator, angle: float) -> Array:
    """Return a random tangent vector with a rotation by the angle and, in a rigid group, a translation of metres."""
    x, part = rng.normal(size=group.dof), rotations(group)
    x[part] *= angle / np.linalg.norm(x[part])
    return x


def rotations(group: type[MatrixGroup]) -> slice:
    """Return the part of a tangent vector that is rotation."""
    return slice(0, group.turns)
