"""Whether a registration moves the pose otherwise than the IMU allows, and how much less it weighs then.

A healthy information matrix can be wrong: points matched to the planes of the corridor below, or of the next of three
that are alike, fit as well as true ones. The IMU has a word in it: over a sweep it predicts the pose well. The
correction of the pose, squared in units of its own predicted covariance, is chi-square of six degrees of freedom where
both are right (Y. Bar-Shalom et al., "Estimation with Applications to Tracking and Navigation", 2001, section 5.4), one
scan for one and the sum over some for all. What is beyond chance cannot be told to be the IMU's or the registration's
fault, but it can be believed: the noise of the registration is taken for so much larger that its correction becomes a
likely one (covariance matching: R. Mehra, "On the identification of variances and adaptive Kalman filtering", 1970).
"""

from __future__ import annotations

from collections import deque
from typing import ClassVar

from heliograph.chi_square import chi_square_quantile
from heliograph.data.error_layout import POSE_DIM
from heliograph.snapshots import Stateful

__all__ = ["InnovationTest"]

_SCANS = 20  # over which corrections are summed: long enough for a slip that is small in each, 2 s of a usual LiDAR
_CHANCE = 1e-7  # of an alarm where nothing is wrong: one in a hundred days at ten scans a second


class InnovationTest(Stateful):
    """Remembers how surprising the last corrections were.

    Parameters
    ----------
    scans : int, optional
        How many of them are summed.
    """

    _STATE: ClassVar = {
        "_past": [float],
    }

    def __init__(self, scans: int = _SCANS) -> None:
        self._past: deque[float] = deque(maxlen=scans - 1)
        self._once = chi_square_quantile(1.0 - _CHANCE, POSE_DIM)
        self._all = chi_square_quantile(1.0 - _CHANCE, POSE_DIM * scans)

    def excess(self, nis: float) -> float:
        """Return how many times too large a normalised squared correction is for chance; at most 1 where it is not.

        By itself, or together with those before it.
        """
        together = nis + sum(self._past) if len(self._past) == self._past.maxlen else 0.0
        return max(nis / self._once, together / self._all)

    def add(self, nis: float) -> None:
        """Take in a scan's; no single one makes those after it suspect."""
        self._past.append(min(nis, self._once))
