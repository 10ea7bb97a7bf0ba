"""Where the run has been after all: poses that a back-end moved, and the odometry between them bent to fit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import frozen
from heliograph.errors import DataError
from heliograph.lie import se3

__all__ = ["FinalPoses"]

_UNMOVED = 1e-9  # keyframes moved against each other by less than this count as unmoved [m], [rad]


@dataclass(frozen=True, slots=True, kw_only=True)
class FinalPoses:
    """The keyframes of a run with the poses that they ended with, beside those that the odometry gave them.

    ``T_map_odom`` at a keyframe is ``T_map_imu @ inverse(T_odom_imu)``. Between keyframes it follows a cubic on SE(3)
    with continuous velocity; before the first and after the last it stays. A stretch whose ends are corrected alike
    moves rigidly.

    Parameters
    ----------
    stamps_ns : (K,) int64
        Times of the keyframes, increasing [ns].
    T_odom_imu : (K, 4, 4) float64
        Their poses as the odometry gave them [m].
    T_map_imu : (K, 4, 4) float64
        Their poses when the run has ended [m].

    Raises
    ------
    DataError
        No keyframe, lengths that differ, stamps that do not increase, or values that are not finite.

    Notes
    -----
    The curve is the Hermite curve of M.-J. Kim, M.-S. Kim and S. Y. Shin (SIGGRAPH 1995) on SE(3). The velocity at a
    keyframe is the limited mean of its two sides (van Leer, J. Comput. Phys. 1974), taken at the body, so that the
    result does not depend on where odom begins and no stretch overshoots.
    """

    stamps_ns: NDArray[np.int64]
    T_odom_imu: NDArray[np.float64]
    T_map_imu: NDArray[np.float64]

    def __post_init__(self) -> None:
        n = len(self.stamps_ns)
        object.__setattr__(self, "stamps_ns", frozen("stamps_ns", self.stamps_ns, np.int64, (None,)))
        for name in ("T_odom_imu", "T_map_imu"):
            object.__setattr__(self, name, frozen(name, getattr(self, name), np.float64, (n, 4, 4), finite=True))
        if n == 0:
            raise DataError("no keyframe; give at least one, or none at all for a run that nothing moved")
        if n > 1 and int(np.diff(self.stamps_ns).min()) <= 0:
            raise DataError("stamps of keyframes must increase; sort them by time and drop repeats")

    @classmethod
    def moved_by(cls, T_map_odom: NDArray[np.float64]) -> FinalPoses:
        """Return the poses of a run that moves as one by ``T_map_odom`` (4, 4)."""
        return cls(stamps_ns=np.zeros(1, np.int64), T_odom_imu=np.eye(4)[None], T_map_imu=T_map_odom[None])

    @property
    def rigid(self) -> NDArray[np.float64] | None:
        """``T_map_odom`` (4, 4) where it is the same all along, else None."""
        T_map_odom = self._at_keyframes()[0]
        apart = np.abs(self.T_map_imu - T_map_odom @ self.T_odom_imu).max()
        return T_map_odom if len(self.stamps_ns) == 1 or apart < _UNMOVED else None

    def T_map_odom(self, stamps_ns: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return ``T_map_odom`` (N, 4, 4) at the times (N,) int64 [ns]."""
        T = self._at_keyframes()
        if len(T) == 1:
            return np.broadcast_to(T, (len(stamps_ns), 4, 4))
        query = np.clip(stamps_ns, self.stamps_ns[0], self.stamps_ns[-1])
        if len(query) == 0:
            return np.zeros((0, 4, 4))
        k = np.clip(np.searchsorted(self.stamps_ns, query, side="right") - 1, 0, len(T) - 2)
        span = np.diff(self.stamps_ns)
        u = ((query - self.stamps_ns[k]) / span[k])[:, None]
        near = slice(max(int(k.min()) - 1, 0), int(k.max()) + 3)  # a block of a long run lies between few of them
        first, middle, last = (twist[k - near.start] for twist in self._twists(T, near))
        T_bent = T[k]
        shares = ((1.0 - (1.0 - u) ** 3, first), ((3.0 - 2.0 * u) * u * u, middle), (u**3, last))
        for share, twist in shares:
            T_bent = se3.retract(T_bent, share * twist)
        return np.asarray(T_bent)

    def _at_keyframes(self) -> NDArray[np.float64]:
        return se3.compose(self.T_map_imu, se3.inverse(self.T_odom_imu))

    def _twists(self, T: NDArray[np.float64], near: slice) -> tuple[NDArray[np.float64], ...]:
        """Return the three twists of each stretch between some keyframes, whose shares add up to it, in odom axes.

        The first and last of them are one further than is asked for, but where the run ends there.
        """
        T, T_odom_imu = T[near], self.T_odom_imu[near]
        step = se3.local(T[:-1], T[1:])
        seconds = 1e-9 * np.diff(self.stamps_ns[near])[:, None]
        velocity = np.zeros((len(T), 6))
        velocity[1:-1] = _limited_mean(step[:-1] / seconds[:-1], step[1:] / seconds[1:], T_odom_imu[1:-1])
        first, last = seconds * velocity[:-1] / 3.0, seconds * velocity[1:] / 3.0
        middle = se3.log(se3.exp(-first) @ se3.inverse(T[:-1]) @ T[1:] @ se3.exp(-last))
        return first, middle, last


def _limited_mean(
    before: NDArray[np.float64], after: NDArray[np.float64], T_odom_imu: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the mean of two twists (K, 6) in odom axes, each weighted by the size that the other has at the body."""
    to_body = se3.adjoint(se3.inverse(T_odom_imu))

    def size(twist: NDArray[np.float64]) -> NDArray[np.float64]:
        # A radian weighs as much as a metre.
        return np.asarray(np.linalg.norm((to_body @ twist[..., None])[..., 0], axis=-1, keepdims=True))

    a, b = size(before), size(after)
    return np.asarray((b * before + a * after) / np.maximum(a + b, np.finfo(np.float64).tiny))
