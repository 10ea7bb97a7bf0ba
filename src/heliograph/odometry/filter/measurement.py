"""One scan as a measurement of the filter's errors."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import Array, freeze
from heliograph.data.error_layout import CLOCK, GYRO_BIAS, MOUNTING, POSE, VELOCITY
from heliograph.registration import NormalEquations, TrueShare, true_share

__all__ = ["ScanMeasurement"]


_ERRORS = {"pose": POSE, "motion": slice(VELOCITY.start, GYRO_BIAS.stop), "mounting": MOUNTING}
"""Which errors the registration's blocks are."""


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
    """

    columns: NDArray[np.intp]
    information: Array
    gradient: Array
    sums: NormalEquations

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

    def only_true(self, found: TrueShare) -> ScanMeasurement:
        """Return the measurement without the information that noise of the planes' normals feigns."""
        return replace(self, information=found.information(), gradient=found.gradient(self.gradient))

    def pose_share(self) -> TrueShare:
        """Return how much of the information on the pose is true if velocity and biases are known."""
        return true_share(self.sums, self.sums.columns_of("pose"))

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
