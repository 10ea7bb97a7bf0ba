"""Preintegration: what an IMU says of the motion between two instants, whatever the state at the first one is.

References
----------
.. [1] C. Forster, L. Carlone, F. Dellaert, D. Scaramuzza, "On-manifold preintegration for real-time visual-inertial
   odometry", IEEE T-RO, 2017.
.. [2] A. Barrau, S. Bonnabel, "The invariant extended Kalman filter as a stable observer", IEEE TAC, 2017.
.. [3] M. Brossard, A. Barrau, P. Chauchat, S. Bonnabel, "Associating uncertainty to extended poses for on Lie group IMU
   preintegration with rotating Earth", IEEE T-RO, 2022.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from heliograph import _core
from heliograph.arrays import Array, freeze
from heliograph.config import ImuConfig
from heliograph.data import ImuBatch, ImuNoise
from heliograph.errors import DataError
from heliograph.imu.propagation import model_numbers
from heliograph.lie import ExtendedPose

__all__ = ["Preintegration", "preintegrate"]


_DEFAULT = ImuConfig()
_SHARED = {"imu", "noise", "config"}  # of all intervals


@dataclass(frozen=True, slots=True, kw_only=True)
class Preintegration:
    """The motion over N intervals by the IMU alone, with its uncertainty and its derivative by the biases.

    The motion is an extended pose without gravity, seen from the imu frame at the start: with ``X = (R, p, v)`` in a
    world where gravity is g, ``R_j = R_i delta_R``, ``v_j = v_i + g gravity_s + R_i delta_v`` and
    ``p_j = p_i + v_i duration_s + g gravity_s2 + R_i delta_p``.

    Parameters
    ----------
    start_ns, end_ns : (N,) int64
        The intervals [ns].
    duration_s : (N,) float64
        [s].
    delta_R : (N, 3, 3) float64
        Rotation of the imu frame at the end in that at the start.
    delta_p, delta_v : (N, 3) float64
        In the imu frame at the start [m], [m/s].
    gravity_s, gravity_s2 : (N,) float64
        What gravity adds to velocity and position, over g: the duration and half its square but where the body is taken
        to coast, far from any sample [s], [s^2].
    covariance : (N, 9, 9) float64
        Covariance of a right perturbation of `delta`, in the order of `ExtendedPose`: rotation, position, velocity, all
        in the imu frame at the end. By white noise, the biases known.
    combined : (N, 15, 15) float64
        Covariance of that perturbation and the change of both biases from start to end (gyro, accelerometer): the
        biases are known at the start and walk from there, which also disturbs the motion.
    bias_jacobian : (N, 9, 6) float64
        Derivative of that perturbation by gyro bias and accelerometer bias, exact for the discrete scheme.
    gyro_bias, accel_bias : (N, 3) float64
        At which the samples were integrated [rad/s], [m/s^2].
    held_s : (N,) float64
        Time within them that no pair of samples covered [s].
    imu, noise, config : ImuBatch, ImuNoise, ImuConfig
        What was integrated, and how.
    """

    start_ns: NDArray[np.int64]
    end_ns: NDArray[np.int64]
    duration_s: Array
    delta_R: Array  # noqa: N815 - a rotation
    delta_p: Array
    delta_v: Array
    gravity_s: Array
    gravity_s2: Array
    covariance: Array
    combined: Array
    bias_jacobian: Array
    gyro_bias: Array
    accel_bias: Array
    held_s: Array
    imu: ImuBatch
    noise: ImuNoise
    config: ImuConfig

    def __post_init__(self) -> None:
        freeze(self)

    def __len__(self) -> int:
        return len(self.start_ns)

    def __getitem__(self, index: slice | NDArray[Any]) -> Preintegration:
        """Return some of the intervals, by a slice or an array of indices."""
        parts: dict[str, Any] = {name: getattr(self, name)[index] for name in _OF_EACH}
        return replace(self, **parts)

    @property
    def delta(self) -> ExtendedPose:
        """The motions as a batch of N extended poses."""
        return ExtendedPose.from_rotation_position_velocity(self.delta_R, self.delta_p, self.delta_v)

    def corrected(self, gyro_bias: ArrayLike, accel_bias: ArrayLike) -> Preintegration:
        """Return the motion at other biases (3,) or (N, 3), to first order; the error grows with the change squared.

        Covariances and derivatives are kept.
        """
        change, gyro, accel = self._change(gyro_bias, accel_bias)
        delta = self.delta.retract(np.einsum("nij,nj->ni", self.bias_jacobian, change))
        return replace(
            self,
            delta_R=delta.rotation.copy(),
            delta_p=delta.position.copy(),
            delta_v=delta.velocity.copy(),
            gyro_bias=gyro,
            accel_bias=accel,
        )

    def predict(
        self, X_world_imu: ExtendedPose, gyro_bias: ArrayLike, accel_bias: ArrayLike, g_world: ArrayLike
    ) -> ExtendedPose:
        """Return the states at the ends of the intervals.

        Parameters
        ----------
        X_world_imu : ExtendedPose
            At the starts, one or a batch of N.
        gyro_bias, accel_bias : (3,) or (N, 3) float64
            [rad/s], [m/s^2].
        g_world : (3,) or (N, 3) float64
            Gravity [m/s^2].
        """
        change, _, _ = self._change(gyro_bias, accel_bias)
        X, g = np.empty((len(self), 5, 5)), np.empty((len(self), 3))
        X[:], g[:] = X_world_imu.matrix, g_world
        flat = np.ascontiguousarray
        return ExtendedPose(
            _core.predict_states(
                flat(self.delta_R),
                flat(self.delta_p),
                flat(self.delta_v),
                flat(self.duration_s),
                flat(self.gravity_s),
                flat(self.gravity_s2),
                flat(self.bias_jacobian),
                change,
                X,
                g,
            )
        )

    def _change(self, gyro_bias: ArrayLike, accel_bias: ArrayLike) -> tuple[Array, Array, Array]:
        gyro, accel = _biases(gyro_bias, len(self)), _biases(accel_bias, len(self))
        return np.concatenate([gyro - self.gyro_bias, accel - self.accel_bias], axis=1), gyro, accel


_OF_EACH = tuple(field.name for field in fields(Preintegration) if field.name not in _SHARED)


def preintegrate(
    imu: ImuBatch,
    start_ns: ArrayLike,
    end_ns: ArrayLike,
    *,
    noise: ImuNoise,
    config: ImuConfig | None = None,
    gyro_bias: ArrayLike = (0.0, 0.0, 0.0),
    accel_bias: ArrayLike = (0.0, 0.0, 0.0),
) -> Preintegration:
    """Integrate an IMU's samples over N intervals in one native call.

    The scheme is that of `propagate`: linear interpolation, the midpoint rule, and the same treatment of gaps and of
    times that no sample covers; so a prediction from any state equals direct integration.

    Parameters
    ----------
    imu : ImuBatch
        Samples around the intervals; at least one, ideally one before and one after each interval.
    start_ns, end_ns : int or (N,) int64
        The intervals; they may overlap and be of any order [ns].
    noise : ImuNoise
        White noise and random walk of this IMU.
    config : ImuConfig, optional
        Steps, gaps, held noise.
    gyro_bias, accel_bias : (3,) or (N, 3) float64
        At which to integrate: the best ones known [rad/s], [m/s^2].

    Returns
    -------
    Preintegration
        Motion over N intervals; N = 1 for single stamps.

    Raises
    ------
    DataError
        No sample at all, an interval that runs backwards, or biases or stamps that do not fit.
    """
    if len(imu) == 0:
        raise DataError("no IMU sample to preintegrate; without an IMU use a constant-velocity model")
    config = config or _DEFAULT
    start, end = (np.atleast_1d(np.asarray(stamps)) for stamps in (start_ns, end_ns))
    if start.dtype.kind not in "iu" or end.dtype.kind not in "iu" or start.ndim != 1 or start.shape != end.shape:
        raise DataError(
            f"intervals need as many integer starts as ends [ns], got {start.dtype} {start.shape} and "
            f"{end.dtype} {end.shape}"
        )
    start, end = start.astype(np.int64), end.astype(np.int64)
    backwards = end < start
    if backwards.any():
        k = int(np.argmax(backwards))
        raise DataError(f"interval {k} ends {1e-9 * float(start[k] - end[k]):.3f} s before it starts; swap them")
    gyro, accel = _biases(gyro_bias, len(start)), _biases(accel_bias, len(start))
    R, p, v, times, by_bias, covariance, combined = _core.preintegrate(
        imu.stamps_ns,
        imu.gyro,
        imu.accel,
        start,
        end,
        np.concatenate([gyro, accel], axis=1),
        model_numbers(noise, config),
    )
    duration_s, gravity_s, gravity_s2, held_s = times.T.copy()
    return Preintegration(
        start_ns=start,
        end_ns=end,
        duration_s=duration_s,
        delta_R=R,
        delta_p=p,
        delta_v=v,
        gravity_s=gravity_s,
        gravity_s2=gravity_s2,
        covariance=covariance,
        combined=combined,
        bias_jacobian=by_bias,
        gyro_bias=gyro,
        accel_bias=accel,
        held_s=held_s,
        imu=imu,
        noise=noise,
        config=config,
    )


def _biases(bias: ArrayLike, count: int) -> Array:
    """Return biases (N, 3) from one or N of them."""
    array = np.asarray(bias, dtype=np.float64)
    if array.shape not in ((3,), (count, 3)) or not np.isfinite(array).all():
        raise DataError(f"a bias is (3,) or ({count}, 3) finite numbers, got shape {array.shape}")
    each = np.empty((count, 3))
    each[:] = array
    return each
