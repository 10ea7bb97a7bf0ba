"""One scan as a measurement of the filter's errors."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import Array, freeze
from heliograph.data import NavState
from heliograph.data.error_layout import CLOCK, GYRO_BIAS, MOUNTING, POSE, POSE_DIM, POSITION, ROTATION, VELOCITY
from heliograph.odometry.filter.sight import SeenInformation, SightOfScans
from heliograph.registration import NormalEquations, TrueShare, true_share

__all__ = ["ScanMeasurement"]


_MOTION = slice(VELOCITY.start, GYRO_BIAS.stop)
_ERRORS = {"pose": POSE, "motion": _MOTION, "mounting": MOUNTING}
"""Which errors the registration's blocks are."""


_BIAS_OF_MOTION = slice(GYRO_BIAS.start - _MOTION.start, GYRO_BIAS.stop - _MOTION.start)
_VELOCITY_OF_MOTION = slice(VELOCITY.start - _MOTION.start, VELOCITY.stop - _MOTION.start)
# Before the sweep's end an error of velocity moves the points back, and one of the gyroscope's bias turns them.
_POSE_BY_MOTION = np.zeros((POSE_DIM, _MOTION.stop - _MOTION.start))
_POSE_BY_MOTION[ROTATION, _BIAS_OF_MOTION] = np.eye(3)
_POSE_BY_MOTION[POSITION, _VELOCITY_OF_MOTION] = -np.eye(3)


@dataclass(frozen=True, slots=True, kw_only=True)
class ScanMeasurement:
    """A `Linearization` of the matches of one scan.

    Parameters
    ----------
    columns : (C,) int
        Which errors of the state the rows and columns are.
    information : (C, C) float64
        Weighted ``J^T J``.
    gradient : (C,) float64
        Weighted ``J^T r``.
    sums : NormalEquations
        What the registration found, every match counting as an independent one.
    together : SeenInformation, optional
        What the scan and those before it saw, where it alone is not sure.
    state : NavState, optional
        Where it was linearised.
    """

    columns: NDArray[np.intp]
    information: Array
    gradient: Array
    sums: NormalEquations
    together: SeenInformation | None = None
    state: NavState | None = None

    def __post_init__(self) -> None:
        freeze(self)

    @classmethod
    def of(cls, sums: NormalEquations) -> ScanMeasurement:
        """Return the measurement that counts every match in full."""
        columns = np.concatenate([np.arange(_ERRORS[block].start, _ERRORS[block].stop) for block in sums.blocks])
        return cls(columns=columns, information=sums.information, gradient=sums.gradient, sums=sums)

    def at_mounting(self, error: Array) -> ScanMeasurement:
        """Return the measurement for a mounting that differs by ``error`` (6,) from the one of map and scan.

        The residuals follow to first order.
        """
        mounting = self.sums.columns_of("mounting")
        return replace(self, gradient=self.gradient + self.information[:, mounting] @ error)

    def only_true(self, sight: SightOfScans, state: NavState, *, motion_known: bool = True) -> ScanMeasurement:
        """Return the measurement without the information that noise of the planes' normals feigns.

        What is blind for a pose whose motion is known is so for one whose motion is not: rows of velocity and bias are
        those of position and rotation times the time before the sweep's end. Among pose and motion together a mixture
        of both may pass for seen by chance; where the motion is not known it tells nothing of either.

        Parameters
        ----------
        sight : SightOfScans
            What the scans before saw.
        state : NavState
            Where the measurement was linearised.
        motion_known : bool
            Whether the motion within the sweep is known to less than the points' noise.
        """
        found, together = true_share(self.sums), None
        if not sight.plain(found):
            together = sight.with_scan(self.sums, state)
            found = together.seen(self.sums, state)
        true = replace(
            self,
            information=found.of(self.information),
            gradient=found.gradient(self.gradient),
            together=together,
            state=state,
        )
        # Over fewer columns noise feigns no larger share: where all is seen here, it is so for the pose alone.
        if motion_known or found.share.all() or "motion" not in self.sums.blocks:
            return true
        return true.without(true.pose_share().blind())

    def without(self, blind: Array) -> ScanMeasurement:
        """Return the measurement that tells nothing of what is ``blind`` (6, 6) of the pose, nor of its motion."""
        pose, motion = self.sums.columns_of("pose"), self.sums.columns_of("motion")
        known = np.eye(len(self.columns))
        known[pose, pose] -= blind
        known[motion, motion] -= _POSE_BY_MOTION.T @ blind @ _POSE_BY_MOTION
        return replace(self, information=known.T @ self.information @ known, gradient=known.T @ self.gradient)

    def pose_share(self) -> TrueShare:
        """Return how much of the information on the pose is true if velocity and biases are known."""
        pose = self.sums.columns_of("pose")
        if self.together is None or self.state is None:
            return true_share(self.sums, pose)
        return self.together.seen(self.sums, self.state, pose)

    def with_clock(self, rate_change: Array) -> ScanMeasurement:
        """Return the measurement with the column of the clock's offset.

        Within the sweep an offset acts as a gyroscope bias of minus the rates' change ``rate_change`` (3,) [rad/s^2].
        """
        size = len(self.columns)
        G = np.eye(size, size + 1)
        G[np.searchsorted(self.columns, np.arange(GYRO_BIAS.start, GYRO_BIAS.stop)), size] = -rate_change
        return replace(
            self,
            columns=np.append(self.columns, CLOCK),
            information=G.T @ self.information @ G,
            gradient=G.T @ self.gradient,
        )

    def blurred(self, covariance: Array) -> ScanMeasurement:
        """Return the measurement of a pose and motion that are off by another error too, of ``covariance`` (12, 12).

        By the inversion lemma ``(A^-1 + B)^-1 = (1 + A B)^-1 A``, and the gradient likewise.
        """
        size = len(self.columns)
        B = np.zeros((size, size))
        B[: len(covariance), : len(covariance)] = covariance
        share = np.linalg.inv(np.eye(size) + self.information @ B)
        information = share @ self.information
        return replace(self, information=0.5 * (information + information.T), gradient=share @ self.gradient)

    def scaled(self, share: float) -> ScanMeasurement:
        """Return the measurement that counts only ``share`` of the matches as independent."""
        return replace(self, information=share * self.information, gradient=share * self.gradient)
