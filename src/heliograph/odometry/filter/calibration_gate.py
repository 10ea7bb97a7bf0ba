"""Mounting and clock as states that only excited motion may move.

A state that the motion does not excite is moved all the same by what the model leaves out, and ends far away with a
small sigma. Here a second covariance, that of the filter if it let everything move, says what the scans have shown of
each direction. Until that is enough the direction is considered: its uncertainty counts, its value stays (S. Schmidt,
1966).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from heliograph.arrays import Array, freeze
from heliograph.config import FilterConfig
from heliograph.data import NavState, OnlineCalibration
from heliograph.data.error_layout import CALIBRATION, CLOCK, DRIFT, MOUNTING
from heliograph.imu import ErrorGrowth
from heliograph.odometry.filter.update import Linearization, embedded

__all__ = ["CalibrationGate"]


_MEASURED = slice(MOUNTING.start, CLOCK + 1)  # what scans measure; the drift only changes one of them with time


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationGate:
    """What the motion has shown so far.

    Parameters
    ----------
    covariance : (25, 25) float64
        Covariance of a filter that lets every direction move.
    prior_sigma : (8,) float64
        Sigmas of mounting and clock at the start; 0 for what is not estimated.
    gain : float
        A direction opens when its sigma has fallen to its prior's by this factor.
    """

    covariance: Array
    prior_sigma: Array
    gain: float

    def __post_init__(self) -> None:
        freeze(self)

    @classmethod
    def at_start(cls, state: NavState, config: FilterConfig) -> CalibrationGate:
        """Return the gate of a start with the errors of mounting and clock."""
        sigma = np.sqrt(np.diag(state.covariance)[CALIBRATION])
        return cls(covariance=state.covariance, prior_sigma=sigma, gain=config.calibration_gain)

    def predicted(self, growth: ErrorGrowth) -> CalibrationGate:
        """Return the gate after a prediction; the errors grow as those of the state do."""
        return replace(self, covariance=growth.grown(self.covariance))

    def updated(self, measurement: Linearization) -> CalibrationGate:
        """Return the gate after a scan."""
        A, _ = embedded(measurement, len(self.covariance))
        covariance = np.linalg.solve(np.eye(len(A)) + self.covariance @ A, self.covariance)
        return replace(self, covariance=0.5 * (covariance + covariance.T))

    def moved(self, M: Array) -> CalibrationGate:
        """Return the gate after a change of frame with the derivative ``M`` (25, 25)."""
        return replace(self, covariance=M @ self.covariance @ M.T)

    def directions(self) -> tuple[Array, Array]:
        """Return how much is known of each direction, and the directions.

        Returns
        -------
        gains : (M,) float64
            Prior sigma by the sigma that the scans would leave, ascending; at least 1.
        directions : (8, M) float64
            Columns in units of the prior sigmas, orthonormal; M counts what is estimated.

        Notes
        -----
        Eq. (14) of docs/theory/filter.md. The drift has a direction of its own: mixed with the offset that it carries
        away, a drift not observed yet would hold back an offset that is.
        """
        measured = np.flatnonzero(self.prior_sigma[:-1] > 0.0)
        scale = self.prior_sigma[measured]
        block = self.covariance[_MEASURED, _MEASURED][np.ix_(measured, measured)] / np.outer(scale, scale)
        # The marginal covariance of this block has what pose, velocity, biases and drift leave open in it already.
        values, vectors = np.linalg.eigh(np.linalg.inv(block))
        directions = np.zeros((len(self.prior_sigma), len(scale)))
        directions[measured] = vectors
        if self.prior_sigma[-1] > 0.0:
            values = np.append(values, self.prior_sigma[-1] ** 2 / self.covariance[DRIFT, DRIFT])
            directions = np.column_stack([directions, np.eye(len(self.prior_sigma))[-1]])
        order = np.argsort(values, kind="stable")
        return np.sqrt(np.maximum(values[order], 1.0)), directions[:, order]

    def account(self, state: NavState) -> OnlineCalibration:
        """Return what a state says of mounting and clock."""
        gains, directions = self.directions()
        # The filter's rotation error is about lidar axes; what people read is about imu axes, where motion is excited.
        turn = np.eye(len(self.prior_sigma))
        turn[:3, :3] = state.T_imu_lidar[:3, :3]
        covariance = turn @ state.covariance[CALIBRATION, CALIBRATION] @ turn.T
        return OnlineCalibration(
            T_imu_lidar=state.T_imu_lidar,
            stamp_ns=state.stamp_ns,
            imu_offset=state.imu_offset,
            imu_drift=state.imu_drift,
            sigma=np.sqrt(np.maximum(np.diag(covariance), 0.0)),
            gains=gains,
            directions=turn @ directions,
            kept=gains < self.gain,
        )

    def considered(self) -> Array:
        """Return the projection (25, 25) of an error onto the directions that may not move, eq. (15)."""
        gains, directions = self.directions()
        shut = directions[:, gains < self.gain]
        projection = np.zeros_like(self.covariance)
        sigma = np.where(self.prior_sigma > 0.0, self.prior_sigma, 1.0)
        projection[CALIBRATION, CALIBRATION] = (shut @ shut.T) * (sigma[:, None] / sigma)
        return projection
