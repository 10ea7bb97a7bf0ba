"""What the last few scans saw together, where one alone cannot tell its view from what noise feigns.

Whether a direction is seen is a question of what is left of the information along it once the part that noise of the
normals feigns is taken off, and chance decides it in a single scan where little faces that way: over open ground with
faint relief every other scan cannot exclude that noise has feigned all, and in a smooth tunnel one in ten seems to
see. Scans after one another look at the same place from a little farther on, at other points of it, and their noise is
new by as much. So their information and what is feigned of it are averaged, in axes of the odom frame, and it is the
mean that is asked. A place that changes, the end of a tunnel for one, shows as a scan whose ratio of both differs from
that of the scans before by more than chance: then nothing is averaged over the change.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from heliograph.arrays import Array, freeze
from heliograph.data import NavState
from heliograph.data.error_layout import GYRO_BIAS, POSE, POSITION, ROTATION
from heliograph.registration import NormalEquations, TrueShare, feigned_deviation, split_information
from heliograph.snapshots import Stateful, array

__all__ = ["SeenInformation", "SightOfScans"]

_SCANS = 5  # that are averaged
_CHANGE_SIGMAS = 4.0  # of the ratio's logarithm, beyond which the place has changed
_PLAIN = 0.1  # feigned share below which a scan needs no others to be sure
_NEW_AFTER = 0.1  # way after which most of a scan's points fall on other planes, or on others among their points [m]


@dataclass(frozen=True, slots=True, kw_only=True)
class SeenInformation:
    """Information of one or more scans and what noise feigns of it, on average, in axes of the odom frame.

    Parameters
    ----------
    blocks : tuple of str
        What the columns are.
    information, feigned : (C, C) float64
    deviation : float
        One-sigma of the chance in the trace of what is feigned of the position.
    count : int
        Scans averaged, at most `_SCANS`.
    at : (3,) float64
        Where the last of them was [m].
    """

    blocks: tuple[str, ...]
    information: Array
    feigned: Array
    deviation: float
    count: int
    at: Array

    def __post_init__(self) -> None:
        freeze(self)

    @classmethod
    def of(cls, sums: NormalEquations, state: NavState) -> SeenInformation:
        """Return that of one scan."""
        T = _turn(len(sums.information), state.R_odom_imu, "motion" in sums.blocks)
        return cls(
            blocks=sums.blocks,
            information=T @ sums.information @ T.T,
            feigned=T @ sums.feigned @ T.T,
            deviation=feigned_deviation(sums),
            count=1,
            at=state.p_odom,
        )

    def followed_by(self, scan: SeenInformation) -> SeenInformation:
        """Return the mean with one more scan."""
        count = min(self.count + 1, _SCANS)
        a = 1.0 / count
        alike = float(np.exp(-np.linalg.norm(scan.at - self.at) / _NEW_AFTER))
        old, new = (1.0 - a) * self.deviation, a * scan.deviation
        return SeenInformation(
            blocks=scan.blocks,
            information=(1.0 - a) * self.information + a * scan.information,
            feigned=(1.0 - a) * self.feigned + a * scan.feigned,
            deviation=float(np.sqrt(old**2 + new**2 + 2.0 * alike * old * new)),
            count=count,
            at=scan.at,
        )

    @property
    def scatter(self) -> float:
        """Relative deviation of what is feigned."""
        total = 0.5 * float(np.trace(self.feigned[POSITION, POSITION]))
        return self.deviation / total if total > 0.0 else 0.0

    def pose(self) -> TrueShare:
        """Return what is seen of the pose, odom axes, if all else is known."""
        return split_information(self.information[POSE, POSE], self.feigned[POSE, POSE], self.scatter, 0.0)

    def seen(self, sums: NormalEquations, state: NavState, columns: slice = slice(None)) -> TrueShare:
        """Return the true share of a scan's columns, in its own axes."""
        T = _turn(len(self.information), state.R_odom_imu, "motion" in self.blocks)
        H, F = T.T @ self.information @ T, T.T @ self.feigned @ T
        return split_information(H[columns, columns], F[columns, columns], self.scatter, sums.robust_weight)

    def differs(self, scan: SeenInformation) -> bool:
        """Tell whether a scan sees otherwise than these did, along what either of both sees worst."""
        limit = _CHANGE_SIGMAS * float(np.hypot(self.scatter, scan.scatter))
        for worst in (self.pose().directions[:, 0], scan.pose().directions[:, 0]):
            ratios = [_ratio(sight, worst) for sight in (self, scan)]
            if min(ratios) <= 0.0 or abs(np.log(ratios[0] / ratios[1])) > limit:
                return True
        return False


def _ratio(sight: SeenInformation, u: Array) -> float:
    feigned = float(u @ sight.feigned[POSE, POSE] @ u)
    return float(u @ sight.information[POSE, POSE] @ u) / feigned if feigned > 0.0 else 0.0


def _turn(size: int, R: Array, motion: bool) -> Array:
    """Return what turns rotation and gyroscope bias, told in body axes, to axes of the odom frame, (C, C)."""
    T = np.eye(size)
    T[ROTATION, ROTATION] = R
    if motion:
        T[GYRO_BIAS, GYRO_BIAS] = R
    return T


class SightOfScans(Stateful):
    """Remembers what the last scans saw."""

    _STATE: ClassVar = {
        "_blocks": [str],
        "_information": array(np.float64, None, None),
        "_feigned": array(np.float64, None, None),
        "_deviation": float,
        "_count": int,
        "_at": array(np.float64, 3),
    }

    def __init__(self) -> None:
        self._take(None)

    def _take(self, sight: SeenInformation | None) -> None:
        self._blocks = list(sight.blocks) if sight is not None else []
        self._information = sight.information if sight is not None else np.zeros((0, 0))
        self._feigned = sight.feigned if sight is not None else np.zeros((0, 0))
        self._deviation = sight.deviation if sight is not None else 0.0
        self._count = sight.count if sight is not None else 0
        self._at = sight.at if sight is not None else np.zeros(3)

    def with_scan(self, sums: NormalEquations, state: NavState) -> SeenInformation:
        """Return what a scan sees, with those before it where it sees the like."""
        scan = SeenInformation.of(sums, state)
        if self._count == 0 or tuple(self._blocks) != scan.blocks:
            return scan
        before = SeenInformation(
            blocks=scan.blocks,
            information=self._information,
            feigned=self._feigned,
            deviation=self._deviation,
            count=self._count,
            at=self._at,
        )
        return scan if before.differs(scan) else before.followed_by(scan)

    def plain(self, found: TrueShare) -> bool:
        """Tell whether a scan is so sure of all that it sees that others would add nothing."""
        return self._count == 0 or bool(found.feigned.max() < _PLAIN)

    def take(self, seen: SeenInformation) -> None:
        """Remember what a scan saw with those before it at its final pose; one that is sure stands for itself."""
        self._take(seen)
