"""Batch inertial propagation with covariance (Sola 2017, "Quaternion kinematics for the error-state KF", ch. 5)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from heliograph import _core
from heliograph.arrays import freeze
from heliograph.config import ImuConfig
from heliograph.data import ImuBatch, ImuNoise, NavState
from heliograph.data.error_layout import CLOCK, DRIFT, FULL_DIM, NAV
from heliograph.errors import DataError
from heliograph.imu.clock_shift import clock_shift
from heliograph.lie import s2

__all__ = ["ErrorGrowth", "ImuPath", "Prediction", "model_numbers", "predict", "propagate"]


@dataclass(frozen=True, slots=True, kw_only=True)
class ImuPath:
    """The motion between two instants as the IMU saw it.

    Parameters
    ----------
    stamps_ns : (K,) int64
        From the start to the end of the interval [ns].
    R_odom_imu : (K, 3, 3) float64
    p_odom, v_odom : (K, 3) float64
        Position [m], velocity [m/s].
    held_s : float
        Time within it that no pair of samples covered [s].
    """

    stamps_ns: NDArray[np.int64]
    R_odom_imu: NDArray[np.float64]
    p_odom: NDArray[np.float64]
    v_odom: NDArray[np.float64]
    held_s: float

    def __post_init__(self) -> None:
        freeze(self)


@dataclass(frozen=True, slots=True, kw_only=True)
class ErrorGrowth:
    """What an interval does to the covariance of a state's errors.

    Parameters
    ----------
    transition, added : (17, 17) float64
        F and Q of the errors that inertial propagation moves.
    clock_shift : (17,) float64 or None
        Derivative of those by the offset of the IMU's clock at the start; None where it was not asked for.
    span : float
        Length of the interval [s].
    """

    transition: NDArray[np.float64]
    added: NDArray[np.float64]
    clock_shift: NDArray[np.float64] | None
    span: float

    def __post_init__(self) -> None:
        freeze(self)

    def carried(self, errors: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return what errors (K, M) at the interval's start, one a column, are at its end."""
        moved = errors.copy()
        moved[NAV] = self.transition @ errors[NAV]
        if self.clock_shift is not None:
            moved[NAV] += np.outer(self.clock_shift, errors[CLOCK] + 0.5 * self.span * errors[DRIFT])
            moved[CLOCK] += self.span * errors[DRIFT]
        return np.asarray(moved)

    def grown(self, covariance: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the covariance (K, K) at the interval's end from that at its start.

        It is ``F P F^T + Q`` with F and Q over the first 17 errors; those of the mounting only correlate. The clock
        then makes ``G P G^T`` of it: its offset at the start moves the first 17 errors by ``clock_shift``; a drift
        moves the offset and, by half of that, the mean over the interval, them too; eq. (11) and (13) of
        docs/theory/filter.md.
        """
        P = covariance.copy()
        P[NAV] = self.transition @ P[NAV]
        P[:, NAV] = P[:, NAV] @ self.transition.T
        P[NAV, NAV] += self.added
        P = 0.5 * (P + P.T)
        if self.clock_shift is None:
            return np.asarray(P)
        G = np.eye(len(P))
        G[NAV, CLOCK], G[NAV, DRIFT] = self.clock_shift, 0.5 * self.span * self.clock_shift
        G[CLOCK, DRIFT] = self.span
        P = G @ P @ G.T
        return np.asarray(0.5 * (P + P.T))


@dataclass(frozen=True, slots=True, kw_only=True)
class Prediction:
    """A state carried on: the state at the end, the way there, and what that does to a covariance."""

    state: NavState
    path: ImuPath
    growth: ErrorGrowth


def propagate(
    state: NavState, imu: ImuBatch, end_ns: int, *, noise: ImuNoise, config: ImuConfig
) -> tuple[NavState, ImuPath]:
    """Return state and path of `predict`; parameters and errors are the same."""
    ahead = predict(state, imu, end_ns, noise=noise, config=config)
    return ahead.state, ahead.path


def predict(state: NavState, imu: ImuBatch, end_ns: int, *, noise: ImuNoise, config: ImuConfig) -> Prediction:
    """Carry ``state`` to ``end_ns`` on the IMU's samples and grow its covariance.

    Samples are interpolated linearly and integrated with the midpoint rule in steps of at most ``config.max_step``. The
    error made by interpolating is unknown but bounded by how much the signal changes from one sample to the next: a
    share ``config.curvature`` of that change is added to the white noise, so that a slow IMU is trusted less. Outside
    the samples, and in gaps, the nearest one is held for ``config.hold``; farther away the body coasts without turning.
    Both with the noise of ``held_*``.

    Parameters
    ----------
    state : NavState
        At or before ``end_ns``; the offset of its IMU's clock goes on at the state's drift.
    imu : ImuBatch
        Samples around the interval, in the clock of the state's stamp; at least one, ideally one more on either side.
    end_ns : int
        Where to stop [ns].
    noise : ImuNoise
        White noise and random walk of this IMU.
    config : ImuConfig
        Steps, gaps, held noise.

    Raises
    ------
    DataError
        No sample at all, or ``end_ns`` before the state.
    """
    if len(imu) == 0:
        raise DataError("no IMU sample to propagate with; without an IMU use the constant-velocity model")
    if end_ns < state.stamp_ns:
        raise DataError(f"cannot propagate backwards by {(state.stamp_ns - end_ns) * 1e-9:.3f} s")
    magnitude = float(np.linalg.norm(state.g_odom))
    g_basis = magnitude * s2.basis(state.g_odom / magnitude) if magnitude > 0.0 else np.zeros((3, 2))
    vectors = np.stack([state.p_odom, state.v_odom, state.gyro_bias, state.accel_bias, state.g_odom])
    model = model_numbers(noise, config)
    stamps, R, p, v, transition, added, held_s = _core.propagate(
        imu.stamps_ns,
        imu.gyro,
        imu.accel,
        state.stamp_ns,
        end_ns,
        np.ascontiguousarray(state.R_odom_imu),
        vectors,
        np.ascontiguousarray(g_basis),
        model,
    )
    moved = replace(
        state,
        stamp_ns=int(end_ns),
        R_odom_imu=R[-1].copy(),
        p_odom=p[-1].copy(),
        v_odom=v[-1].copy(),
        imu_offset=state.imu_offset + state.imu_drift * (end_ns - state.stamp_ns) * 1e-9,
    )
    size = len(state.covariance)
    asked = size == FULL_DIM or (size > FULL_DIM and bool(state.covariance[CLOCK:FULL_DIM].any()))
    growth = ErrorGrowth(
        transition=transition,
        added=added,
        clock_shift=clock_shift(state, moved, imu, transition, noise) if asked else None,
        span=(end_ns - state.stamp_ns) * 1e-9,
    )
    moved = replace(moved, covariance=growth.grown(state.covariance))
    path = ImuPath(stamps_ns=stamps, R_odom_imu=R, p_odom=p, v_odom=v, held_s=held_s)
    return Prediction(state=moved, path=path, growth=growth)


def model_numbers(noise: ImuNoise, config: ImuConfig) -> NDArray[np.float64]:
    """Return the native model's numbers in their order: variances, then limits."""
    return np.array(
        [
            noise.gyro**2,
            noise.accel**2,
            noise.gyro_walk**2,
            noise.accel_walk**2,
            config.held_gyro_noise**2,
            config.held_accel_noise**2,
            config.curvature,
            config.max_step,
            1e9 * config.max_gap,
            1e9 * config.hold,
        ]
    )
