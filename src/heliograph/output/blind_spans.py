"""Stretches of a run along which one direction was not seen, and what they cost in metres."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import freeze
from heliograph.data import ScanResult
from heliograph.snapshots import Stateful, array, fixed

__all__ = ["BlindSpan", "BlindSpans"]

_BRIDGED = 10  # scans that saw a little between two stretches that count as one
_NORMAL_95 = 1.96


@dataclass(frozen=True, slots=True, kw_only=True)
class BlindSpan:
    """Scans in a row that did not see one direction.

    Parameters
    ----------
    first, last : int
        Scans, the last one included.
    begin_ns, end_ns : int
        Ends of their sweeps [ns].
    direction : (3,) float64
        Unit vector, map frame.
    distance : float
        Length of the path meanwhile [m].
    sigma_before, sigma_after : float
        Predicted one-sigma of the position along the direction before and after, against the odom frame's origin [m].
    """

    first: int
    last: int
    begin_ns: int
    end_ns: int
    direction: NDArray[np.float64]
    distance: float
    sigma_before: float
    sigma_after: float

    def __post_init__(self) -> None:
        freeze(self)

    @property
    def growth(self) -> float:
        """One-sigma that the stretch itself has added [m]."""
        return float(np.sqrt(max(self.sigma_after**2 - self.sigma_before**2, 0.0)))

    def __str__(self) -> str:
        direction = ", ".join(f"{value:+.2f}" for value in self.direction)
        return (
            f"scans {self.first} to {self.last} did not see the direction ({direction}) for {self.distance:.1f} m: the "
            f"position along it is known to {_NORMAL_95 * self.sigma_after:.2f} m after that (95 %), "
            f"to {_NORMAL_95 * self.sigma_before:.2f} m before"
        )


class BlindSpans(Stateful):
    """Collects the stretches of a run as its results pass, in constant memory a stretch."""

    _STATE: ClassVar = {
        "_closed": [BlindSpan],
        "_open": (BlindSpan, None),
        "_before": array(np.float64, 3, 3),
        "_from": array(np.float64, 3),
        "_previous": (fixed(array(np.float64, 3), array(np.float64, 3, 3)), None),
    }

    def __init__(self) -> None:
        self._closed: list[BlindSpan] = []
        self._open: BlindSpan | None = None
        self._before = np.zeros((3, 3))  # covariance of the position before the open stretch
        self._from = np.zeros(3)
        self._previous: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None

    def add(self, result: ScanResult) -> None:
        """Take in one result."""
        position, covariance = result.T_odom_imu[:3, 3].copy(), result.pose_covariance[3:, 3:].copy()
        last_position, last_covariance = self._previous if self._previous is not None else (position, covariance)
        self._previous = position, covariance
        if result.status != "degenerate":
            if self._open is not None and result.index - self._open.last > _BRIDGED:
                self._closed.append(self._open)
                self._open = None
            return
        if self._open is None:
            self._before, first, begin, distance = last_covariance, result.index, result.end_ns, 0.0
            self._from = last_position
        else:
            first, begin, distance = self._open.first, self._open.begin_ns, self._open.distance
        direction = result.weak_direction
        self._open = BlindSpan(
            first=first,
            last=result.index,
            begin_ns=begin,
            end_ns=result.end_ns,
            direction=direction.copy(),
            distance=distance + float(np.linalg.norm(position - self._from)),
            sigma_before=_along(self._before, direction),
            sigma_after=_along(covariance, direction),
        )
        self._from = position

    def all(self, R_map_odom: NDArray[np.float64]) -> tuple[BlindSpan, ...]:
        """Return the stretches so far, in order, with their directions in the map frame."""
        spans = (*self._closed, *((self._open,) if self._open is not None else ()))
        return tuple(replace(span, direction=R_map_odom @ span.direction) for span in spans)


def _along(covariance: NDArray[np.float64], direction: NDArray[np.float64]) -> float:
    return float(np.sqrt(max(float(direction @ covariance @ direction), 0.0)))
