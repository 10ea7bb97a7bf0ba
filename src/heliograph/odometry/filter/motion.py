"""The motion between two scans: the IMU's, or a constant velocity where there is none; and the path that both make."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import Array
from heliograph.config import FilterConfig, ImuConfig
from heliograph.data import ImuBatch, ImuNoise, NavState
from heliograph.data.error_layout import GYRO_BIAS, NAV, POSITION, ROTATION, VELOCITY
from heliograph.imu import ImuPath, Prediction, predict
from heliograph.lie import so3
from heliograph.odometry.filter.bending import SweepBend
from heliograph.odometry.filter.error_state import local
from heliograph.odometry.filter.unsteadiness import Unsteadiness
from heliograph.snapshots import Stateful

__all__ = ["MotionModel", "corrected_path", "rate_change", "sweep_path"]

_SPEED_CHANGE = 1.0  # of a body within seconds [m/s]


class MotionModel(Stateful):
    """Predicts states from inertial samples, or from a constant velocity.

    The constant-velocity model is the same filter with an imaginary IMU that always reads zero in a world without
    gravity: its "gyroscope bias" is minus the body rate, and white noise on its "accelerometer" and the random walk of
    its "bias" let velocity and rate change: as much as configured, or as much as the scans have shown.

    Parameters
    ----------
    imu, filter : ImuConfig, FilterConfig
    noise : ImuNoise or None
        Noise of the IMU; None selects the constant-velocity model.
    """

    _STATE: ClassVar = {
        "_unsteadiness": Unsteadiness,
    }

    def __init__(self, imu: ImuConfig, filter_config: FilterConfig, noise: ImuNoise | None) -> None:
        self.inertial = noise is not None
        self.noise = noise
        """Noise of the IMU, None without one."""
        self._config = imu
        self._unsteadiness = Unsteadiness()
        self._noise = noise or ImuNoise(
            gyro=1e-4,
            accel=filter_config.constant_velocity_accel,
            gyro_walk=filter_config.constant_velocity_gyro,
            accel_walk=0.0,
        )

    def predict(self, state: NavState, imu: ImuBatch, end_ns: int) -> Prediction:
        """Carry ``state`` to ``end_ns``; ``imu`` is not looked at by the constant-velocity model."""
        if not self.inertial:
            stamps = np.array([state.stamp_ns, max(end_ns, state.stamp_ns + 1)], dtype=np.int64)
            imu = ImuBatch(stamps_ns=stamps, gyro=np.zeros((2, 3)), accel=np.zeros((2, 3)), received_ns=0)
        elif not state.imu_clock.exact:
            imu = replace(imu, stamps_ns=state.imu_clock.lidar_time(imu.stamps_ns))
        noise = self._noise if self.inertial else self._unsteadiness.allowed(self._noise)
        ahead = predict(state, imu, end_ns, noise=noise, config=self._config)
        # Without an IMU none of its samples is missing, however long the way from scan to scan.
        return ahead if self.inertial else replace(ahead, path=replace(ahead.path, held_s=0.0))

    def way_back(self, state: NavState, imu: ImuBatch, begin_ns: int) -> ImuPath:
        """Return the motion from an earlier instant to the one at which it ends in ``state``."""
        return self.predict(self._begin_of(state, imu, begin_ns), imu, state.stamp_ns).path

    def _begin_of(self, state: NavState, imu: ImuBatch, begin_ns: int) -> NavState:
        """Return what the state must have been at an earlier instant to end in ``state``.

        The motion between is integrated forwards from rest at the origin, to dR, dv, dp. Then ``R = R_1 dR^T``,
        ``v = v_1 - g t - R dv`` and ``p = p_1 - v t - g t^2 / 2 - R dp``.
        """
        rest = replace(
            state,
            stamp_ns=begin_ns,
            R_odom_imu=np.eye(3),
            p_odom=np.zeros(3),
            v_odom=np.zeros(3),
            g_odom=np.zeros(3),
            imu_offset=state.imu_offset - state.imu_drift * (state.stamp_ns - begin_ns) * 1e-9,
        )
        moved = self.predict(rest, imu, state.stamp_ns).state
        seconds = (state.stamp_ns - begin_ns) * 1e-9
        R = state.R_odom_imu @ moved.R_odom_imu.T
        v = state.v_odom - state.g_odom * seconds - R @ moved.v_odom
        p = state.p_odom - v * seconds - 0.5 * state.g_odom * seconds**2 - R @ moved.p_odom
        return replace(rest, R_odom_imu=R, p_odom=p, v_odom=v, g_odom=state.g_odom)

    def carried_back(self, state: NavState, imu: ImuBatch, begin_ns: int) -> tuple[NavState, Array]:
        """Return the state at an earlier instant, and the derivative (K, K) of its errors by those of ``state``."""
        begin = self._begin_of(state, imu, begin_ns)
        growth = self.predict(begin, imu, state.stamp_ns).growth
        back = np.eye(len(state.covariance))
        back[NAV, NAV] = np.linalg.inv(growth.transition)
        added = np.zeros_like(back)
        added[NAV, NAV] = growth.added
        covariance = back @ (state.covariance + added) @ back.T
        return replace(begin, covariance=0.5 * (covariance + covariance.T)), back

    def levelled(self, state: NavState, imu: ImuBatch, begin_ns: int, end_ns: int) -> NavState:
        """Return the state carried on to ``begin_ns``, and turned so that the mean force until ``end_ns`` points up.

        A body that neither falls nor flies away changes its speed by `_SPEED_CHANGE` meanwhile: so well is up known.
        """
        if not self.inertial or begin_ns <= state.stamp_ns:
            return state
        ahead = self.predict(state, imu, begin_ns).state
        rest = replace(ahead, R_odom_imu=np.eye(3), p_odom=np.zeros(3), v_odom=np.zeros(3), g_odom=np.zeros(3))
        force = ahead.R_odom_imu @ self.predict(rest, imu, end_ns).state.v_odom
        up, size = -state.g_odom / np.linalg.norm(state.g_odom), float(np.linalg.norm(force))
        if size == 0.0:
            return ahead
        axis = np.cross(force / size, up)
        turn = np.arctan2(float(np.linalg.norm(axis)), float(force @ up) / size)
        R = so3.exp(turn * axis / max(float(np.linalg.norm(axis)), 1e-12)) @ ahead.R_odom_imu
        along, P = R.T @ up, ahead.covariance.copy()
        about = float(along @ P[ROTATION, ROTATION] @ along)
        P[ROTATION, :], P[:, ROTATION] = 0.0, 0.0
        tilt = (_SPEED_CHANGE / size) ** 2
        P[ROTATION, ROTATION] = tilt * np.eye(3) + (about - tilt) * np.outer(along, along)
        return replace(ahead, R_odom_imu=R, covariance=P)

    def learn(self, prior: NavState, posterior: NavState, *, seconds: float, bend: SweepBend | None) -> None:
        """Take in an update, ``seconds`` after the one before: how unsteady the motion was between and within."""
        if not self.inertial:
            self._unsteadiness = self._unsteadiness.updated(prior, posterior, seconds, bend)

    def settled(
        self, prior: NavState, posterior: NavState, *, converged: bool, seconds: float, sweep: float
    ) -> NavState:
        """Return the state after an update whose sweep is not asked how bent it is, and learn from it.

        Parameters
        ----------
        prior, posterior : NavState
            Before and after the update.
        converged : bool
            Whether it settled; one that still moves is followed, but nothing is known better by it.
        seconds : float
            Since the update before [s].
        sweep : float
            Time from a scan's first point to its last [s].
        """
        if self.inertial:
            return posterior
        if not converged:
            posterior = replace(posterior, covariance=prior.covariance)
        self.learn(prior, posterior, seconds=seconds, bend=None)
        return self._unsteadiness.smoothly_bent(posterior, sweep)

    def loosened(self, state: NavState, prior: NavState, share: float, *, converged: bool) -> NavState:
        """Return the state after an update, less sure by a share of the variance that unsteady motion leaves.

        Parameters
        ----------
        state, prior : NavState
            After and before the update.
        share : float
        converged : bool
            Whether it settled. Without an IMU the motion within the sweep is fitted along; where it is no steady one,
            that may go to and fro between two minima, and nothing is known better than by what it was corrected.
        """
        if self.inertial:
            return state
        state = self._unsteadiness.bent(state, share)
        if converged:
            return state
        corrected, covariance = local(prior, state), state.covariance.copy()
        for part in (ROTATION, POSITION, VELOCITY, GYRO_BIAS):
            covariance[part, part] += share * float(corrected[part] @ corrected[part]) / 3.0 * np.eye(3)
        return replace(state, covariance=covariance)


def rate_change(path: ImuPath) -> NDArray[np.float64]:
    """Return the mean change of the body's rate over a path, (3,) [rad/s^2]: its second half against its first."""
    stamps = path.stamps_ns
    middle = len(stamps) // 2
    first, second = float(stamps[middle] - stamps[0]) * 1e-9, float(stamps[-1] - stamps[middle]) * 1e-9
    if middle == 0 or min(first, second) <= 0.0:
        return np.zeros(3)
    R = path.R_odom_imu
    change = so3.log(R[middle].T @ R[-1]) / second - so3.log(R[0].T @ R[middle]) / first
    return np.asarray(change / (0.5 * (first + second)))


def sweep_path(path: ImuPath, prior: NavState, state: NavState) -> ImuPath:
    """Return the motion within a sweep as ``state`` at its end has it, for de-skewing.

    ``path`` was predicted with the velocity and gyroscope bias of ``prior``; an error of theirs grows backwards from
    the sweep's end. Changing both here does to the points exactly what the Jacobian of the registration says it does. A
    clock offset that differs looks up other rates within the sweep: a bias as large as they change in that time.
    """
    before = (path.stamps_ns[-1] - path.stamps_ns)[:, None] * 1e-9
    end = path.p_odom[-1]
    bias = state.gyro_bias - prior.gyro_bias
    if state.imu_offset != prior.imu_offset:
        bias = bias - (state.imu_offset - prior.imu_offset) * rate_change(path)
    turned = path.R_odom_imu @ so3.exp(before * bias)
    align = state.R_odom_imu @ path.R_odom_imu[-1].T
    return replace(
        path,
        R_odom_imu=align @ turned,
        p_odom=state.p_odom + (path.p_odom - end) @ align.T - before * (state.v_odom - align @ prior.v_odom),
        v_odom=path.v_odom + (state.v_odom - prior.v_odom),
    )


def corrected_path(path: ImuPath, posterior: NavState) -> ImuPath:
    """Bend a predicted path so that it ends in the posterior.

    It starts where the last update left it, so the correction grows linearly from nothing there to all of it at the
    end.
    """
    span = float(path.stamps_ns[-1] - path.stamps_ns[0])
    share = (path.stamps_ns - path.stamps_ns[0]) / span if span > 0.0 else np.ones(len(path.stamps_ns))
    turn = so3.log(path.R_odom_imu[-1].T @ posterior.R_odom_imu)
    return replace(
        path,
        R_odom_imu=path.R_odom_imu @ so3.exp(share[:, None] * turn),
        p_odom=path.p_odom + share[:, None] * (posterior.p_odom - path.p_odom[-1]),
        v_odom=path.v_odom + share[:, None] * (posterior.v_odom - path.v_odom[-1]),
    )
