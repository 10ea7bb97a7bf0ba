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
from heliograph.odometry.filter.bending import SweepBend
from heliograph.odometry.filter.error_state import local, reset_jacobian, retract

__all__ = ["FilterUpdate", "Linearization", "embedded", "iterated_update", "weighed_less"]


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
    linearized_at: NavState
    """Where the measurement was linearised last."""
    excess: float = 0.0
    """How many times too large that is for chance, alone or with the scans before; the measurement weighs less then."""
    bend: SweepBend | None = None
    """How unsteady the motion was within the sweep; None where an IMU tells it."""

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
    start: NavState | None = None,
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
    start : NavState, optional
        Where the iteration begins; the prior if not given.
    """
    state = prior if start is None else start
    converged = False
    for iteration in range(max_iterations):
        measurement = linearize(state, iteration)
        last = _corrected(prior, state, measurement, considered)
        state, step = last.state, last.step
        small = (
            float(np.linalg.norm(step[ROTATION])) < tolerance_rotation
            and float(np.linalg.norm(step[POSITION])) < tolerance_position
        )
        if small and settled(iteration):
            converged = True
            break
    return _concluded(prior, last, measurement, considered, iterations=iteration + 1, converged=converged)


def weighed_less(fit: FilterUpdate[L], prior: NavState, measurement: L, considered: Array | None) -> FilterUpdate[L]:
    """Return an update with a measurement that counts less in place of its own, linearised where that one was."""
    last = _corrected(prior, fit.linearized_at, measurement, considered)
    less = _concluded(prior, last, measurement, considered, iterations=fit.iterations, converged=fit.converged)
    return replace(less, nis=fit.nis)


@dataclass(frozen=True, slots=True)
class _Correction:
    """One step from ``before`` to ``state``; ``gain_form`` is ``(I + P A)^-1``, P and J are the prior's there."""

    before: NavState
    state: NavState
    step: Array
    gain_form: Array
    P: Array
    J: Array

    def __post_init__(self) -> None:
        freeze(self)


def _corrected(prior: NavState, state: NavState, measurement: Linearization, considered: Array | None) -> _Correction:
    """Return one step of the iteration from ``state``."""
    dim = len(prior.covariance)
    A, b = embedded(measurement, dim)
    # The prior around the iterate: its mean lies at -offset, its covariance is carried over by the reset Jacobian.
    offset = local(prior, state)
    J = reset_jacobian(prior, offset)
    P = J @ prior.covariance @ J.T
    gain_form = np.linalg.inv(np.eye(dim) + P @ A)
    step = -gain_form @ (P @ b + J @ offset)
    if considered is not None:
        step = step - considered @ step
    return _Correction(state, retract(state, step), step, gain_form, P, J)


def _concluded(
    prior: NavState, last: _Correction, measurement: L, considered: Array | None, *, iterations: int, converged: bool
) -> FilterUpdate[L]:
    """Return the update that ends with a step."""
    state, P, J = last.state, last.P, last.J
    J_step = reset_jacobian(last.before, last.step)
    covariance = J_step @ last.gain_form @ P @ J_step.T
    retained = J_step @ last.gain_form @ J
    if considered is not None:
        retained += considered @ (J_step @ J - retained)
        # The gain of all else is the optimal one, so only the block of what stayed differs from the full update's.
        covariance += considered @ (J_step @ P @ J_step.T - covariance) @ considered.T
    moved = prior.covariance[POSE, POSE] - covariance[POSE, POSE]
    return FilterUpdate(
        state=replace(state, covariance=0.5 * (covariance + covariance.T)),
        measurement=measurement,
        iterations=iterations,
        converged=converged,
        retained=retained,
        nis=_normalised_square(local(prior, state)[POSE], moved),
        linearized_at=last.before,
    )


def _normalised_square(correction: Array, covariance: Array) -> float:
    """Return ``c^T C^+ c`` over the directions in which the covariance is clearly positive.

    After a large correction prior and posterior live in different tangent spaces, and their difference need not be
    positive in directions that the measurement hardly changed.
    """
    values, vectors = np.linalg.eigh(0.5 * (covariance + covariance.T))
    kept = values > 1e-6 * max(float(values[-1]), 0.0)
    return float(np.sum((vectors.T @ correction)[kept] ** 2 / values[kept]))
