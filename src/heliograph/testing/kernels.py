"""The law of robust kernels."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from heliograph.arrays import Array

__all__ = ["RobustKernel", "assert_robust_kernel"]


class RobustKernel(Protocol):
    """A robust cost of a whitened residual."""

    def cost(self, residual: Array) -> Array:
        """Return rho(r), elementwise; ``r^2 / 2`` for small residuals."""
        ...

    def weight(self, residual: Array) -> Array:
        """Return ``rho'(r) / r``, elementwise; 1 at zero."""
        ...


def assert_robust_kernel(kernel: RobustKernel, *, largest: float = 1e3, tolerance: float = 1e-6) -> None:
    """Assert that a kernel is least squares near zero, never steeper, symmetric, and that its weight is its slope.

    Parameters
    ----------
    kernel : RobustKernel
        Its scale should be within a few orders of magnitude of 1.
    largest : float
        Largest residual tried.
    tolerance : float
        Relative.
    """
    r = np.concatenate([[0.0], np.logspace(-6, np.log10(largest), 400)])
    cost, weight = np.asarray(kernel.cost(r)), np.asarray(kernel.weight(r))
    assert cost.shape == weight.shape == r.shape, "cost and weight must work element by element"
    assert cost[0] == 0.0, f"the cost at zero is {cost[0]}, not 0"
    np.testing.assert_allclose(weight[0], 1.0, rtol=tolerance, err_msg="the weight at zero")
    np.testing.assert_allclose(cost[1:4], 0.5 * r[1:4] ** 2, rtol=1e-3, err_msg="the cost of small residuals")
    assert np.all(cost <= 0.5 * r * r * (1.0 + tolerance) + 1e-300), "the cost exceeds least squares"
    assert np.all(np.diff(cost) >= -tolerance * cost[1:]), "the cost falls with the residual"
    assert np.all((weight >= 0.0) & (weight <= 1.0 + tolerance)), "a weight lies outside [0, 1]"
    assert np.all(np.diff(weight) <= tolerance), "the weight grows with the residual"
    np.testing.assert_array_equal(kernel.cost(-r), cost, err_msg="the cost of a negative residual")
    np.testing.assert_array_equal(kernel.weight(-r), weight, err_msg="the weight of a negative residual")
    step = 1e-4 * r[1:]
    near = np.asarray(kernel.cost(r[1:] + step)) - np.asarray(kernel.cost(r[1:] - step))
    far = np.asarray(kernel.cost(r[1:] + 2 * step)) - np.asarray(kernel.cost(r[1:] - 2 * step))
    slope = (8.0 * near - far) / (12.0 * step)
    # The rounding of the difference scales with the cost itself, which saturates where the slope dies out.
    slack = tolerance * weight[1:] * r[1:] + 1e-11 * cost[1:] / step
    assert np.all(np.abs(slope - weight[1:] * r[1:]) <= slack), "the weight is not the cost's slope over the residual"
