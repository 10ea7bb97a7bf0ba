"""The iterated Kalman update in the form whose cost grows with the state, not with the measurements.

With H the stacked Jacobian, R the measurement noise and P the prior around the current iterate, the textbook gain is
``P H^T (H P H^T + R)^-1``, an inverse as large as the number of points. The matrix inversion lemma turns it into
``(I + P A)^-1 P H^T R^-1`` with the information ``A = H^T R^-1 H`` of the size of the state (W. Xu, F. Zhang,
"FAST-LIO", RA-L 2021, eq. 20). Written so, P may be singular: a state known exactly stays so.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import Array, freeze
from heliograph.data import NavState
from heliograph.data.error_layout import POSE, POSITION, ROTATION
from heliograph.odometry.filter.error_state import local, reset_jacobian, retract

__all__ = ["FilterUpdate", "Linearization", "embedded", "iterated_update"]


class Linearization(Protocol):
    """What a measurement says about some of the errors."""

    @property
    def columns(self) -> NDArray[np.intp]:
        """Which errors they are, (C,)."""
        ...

    @property
    def information(self) -> Array:
        """``H^T R^-1 H`` over those, (C, C)."""
        ...

    @property
    def gradient(self) -> Array:
        """``H^T R^-1 r``, (C,)."""
        ...


L = TypeVar("L", bound=Linearization)


@dataclass(frozen=True, slots=True, kw_only=True)
class FilterUpdate(Generic[L]):
    """The posterior, the measurement as linearised last, and whether the iteration settled."""

    state: NavState
    measurement: L
    iterations: int
    converged: bool
    retained: Array
    """What is left of an error of the prior in the posterior, (K, K)."""
    nis: float
    """Squared correction of pose in units of its predicted uncertainty; 6 on average if matches erred independently."""

    def __post_init__(self) -> None:
        freeze(self)


def embedded(measurement: Linearization, dim: int) -> tuple[Array, Array]:
    """Spread the measurement over the whole error state."""
    A, b = np.zeros((dim, dim)), np.zeros(dim)
    A[np.ix_(measurement.columns, measurement.columns)] = measurement.information
    b[measurement.columns] = measurement.gradient
    return A, b


def iterated_update(
    prior: NavState,
    linearize: Callable[[NavState, int], L],
    *,
    max_iterations: int,
    tolerance_rotation: float,
    tolerance_position: float,
    settled: Callable[[int], bool] = lambda _: True,
    considered: Array | None = None,
) -> FilterUpdate[L]:
    """Find the state that fits prior and measurement best, by Gauss-Newton, and its covariance.

    Parameters
    ----------
    prior : NavState
    linearize : callable
        ``(state, iteration) -> Linearization`` of the measurement at that state; its gradient is of the residual there.
    max_iterations : int
    tolerance_rotation, tolerance_position : float
        Converged when a step is smaller [rad], [m] ...
    settled : callable
        ... and ``settled(iteration)`` says that the measurement's own settings have reached their final values.
    considered : (K, K) float64, optional
        Projects an error onto what must not move: its uncertainty counts in the gain of all else and stays as it is
        (S. Schmidt, "Application of state-space methods to navigation problems", 1966). The correlations are learnt.
    """
    state, dim = prior, len(prior.covariance)
    identity = np.eye(dim)
    converged = False
    for iteration in range(max_iterations):
        measurement = linearize(state, iteration)
        A, b = embedded(measurement, dim)
        # The prior around the iterate: its mean lies at -offset, its covariance is carried over by the reset
        # Jacobian.
        offset = local(prior, state)
        J = reset_jacobian(prior, offset)
        P = J @ prior.covariance @ J.T
        gain_form = np.linalg.inv(identity + P @ A)
        step = -gain_form @ (P @ b + J @ offset)
        if considered is not None:
            step = step - considered @ step
        before, state = state, retract(state, step)
        small = (
            float(np.linalg.norm(step[ROTATION])) < tolerance_rotation
            and float(np.linalg.norm(step[POSITION])) < tolerance_position
        )
        if small and settled(iteration):
            converged = True
            break
    J_step = reset_jacobian(before, step)
    covariance = J_step @ gain_form @ P @ J_step.T
    retained = J_step @ gain_form @ J
    if considered is not None:
        retained += considered @ (J_step @ J - retained)
        # The gain of all else is the optimal one, so only the block of what stayed differs from the full update's.
        covariance += considered @ (J_step @ P @ J_step.T - covariance) @ considered.T
    total = local(prior, state)[POSE]
    moved = prior.covariance[POSE, POSE] - covariance[POSE, POSE]
    nis = _normalised_square(total, moved)
    return FilterUpdate(
        state=replace(state, covariance=0.5 * (covariance + covariance.T)),
        measurement=measurement,
        iterations=iteration + 1,
        converged=converged,
        retained=retained,
        nis=nis,
    )


def _normalised_square(correction: Array, covariance: Array) -> float:
    """Return ``c^T C^+ c`` over the directions in which the covariance is clearly positive.

    After a large correction prior and posterior live in different tangent spaces, and their difference need not be
    positive in directions that the measurement hardly changed.
    """
    values, vectors = np.linalg.eigh(0.5 * (covariance + covariance.T))
    kept = values > 1e-6 * max(float(values[-1]), 0.0)
    return float(np.sum((vectors.T @ correction)[kept] ** 2 / values[kept]))
