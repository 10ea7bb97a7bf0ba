"""By how much the IMU's stamps are late against the LiDAR's, roughly."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import Array
from heliograph.checks.records import CheckedMotion
from heliograph.checks.windows import orientation_at
from heliograph.data import ImuBatch

__all__ = ["MAX_OFFSET", "MIN_CORRELATION", "Offset", "find_offset"]


MAX_OFFSET = 10.0
"""No offset beyond it is looked for [s]."""
MIN_CORRELATION = 0.9
"""Correlation of the angular speeds below which no offset can be determined."""
_SEARCH_S, _FINE_STEP_S = 0.5, 0.005  # of the offset nearby [s]
_COARSE_STEP_S = 0.02  # and far away [s]
_MIN_SPEED_SIGMA = 0.05  # standard deviation of the angular speed below which there is nothing to correlate [rad/s]
_MIN_PAIRS = 20
_CORRELATION_NOISE = 0.01  # by which correlations differ for no reason


@dataclass(frozen=True, slots=True, kw_only=True)
class Offset:
    """A shift of the IMU's stamps against the LiDAR's.

    Parameters
    ----------
    seconds, sigma : float
        Positive where the IMU's stamps are late [s].
    correlation : float
        Correlation of the angular speeds at that shift.
    speed_sigma : float
        Standard deviation of the LiDAR's angular speed [rad/s].
    """

    seconds: float
    sigma: float
    correlation: float
    speed_sigma: float

    @property
    def determined(self) -> bool:
        """Whether the motion shows it at all."""
        return self.speed_sigma >= _MIN_SPEED_SIGMA and self.correlation >= MIN_CORRELATION

    def significant(self, limit: float) -> bool:
        """Whether it is known to be above a limit [s] that is worth a remark."""
        return self.determined and abs(self.seconds) >= max(limit, 3.0 * self.sigma)


def find_offset(batch: ImuBatch, motion: CheckedMotion, *, near: float | None = None) -> Offset | None:
    """Return the shift at which the angular speeds correlate best; None where too few scans can be shifted.

    Searched nearby first, and far only where nothing nearby fits: a gait repeats itself.

    Parameters
    ----------
    batch : ImuBatch
        Its gyroscope preferably without bias.
    motion : CheckedMotion
    near : float
        Search around this shift only [s].
    """
    if near is not None:
        return _best(batch, motion, near, 10.0 * _FINE_STEP_S, _FINE_STEP_S)
    nearby = _best(batch, motion, 0.0, _SEARCH_S, _FINE_STEP_S)
    if nearby is not None and nearby.correlation >= MIN_CORRELATION:
        return nearby
    overlap = min(batch.stamps_ns[-1], motion.trajectory.stamps_ns[-1]) - max(
        batch.stamps_ns[0], motion.trajectory.stamps_ns[0]
    )
    reach = min(MAX_OFFSET, 0.25 * overlap * 1e-9)
    far = _best(batch, motion, 0.0, reach, _COARSE_STEP_S) if reach > _SEARCH_S else None
    if far is None or far.correlation < MIN_CORRELATION - 0.1:
        return nearby
    return _best(batch, motion, far.seconds, 10.0 * _FINE_STEP_S, _FINE_STEP_S) or nearby


def _best(batch: ImuBatch, motion: CheckedMotion, center: float, reach: float, step: float) -> Offset | None:
    stamps, R = motion.trajectory.stamps_ns, motion.trajectory.T_frame_body[:, :3, :3]
    early, late = round((center - reach) * 1e9), round((center + reach) * 1e9)
    covered = (stamps + early >= batch.stamps_ns[0]) & (stamps + late <= batch.stamps_ns[-1])
    whole = covered & motion.tracked
    pairs = np.flatnonzero(whole[1:] & whole[:-1])
    if len(pairs) < _MIN_PAIRS:
        return None
    spans: Array = (stamps[pairs + 1] - stamps[pairs]).astype(np.float64) * 1e-9
    seen = _speeds(R, pairs, spans)
    speed_sigma = float(np.std(seen))
    offsets: Array = center + step * np.arange(-round(reach / step), round(reach / step) + 1, dtype=np.float64)
    # One integration serves all offsets.
    shifted = stamps[None, :] + np.round(offsets * 1e9).astype(np.int64)[:, None]
    R_imu = orientation_at(batch, shifted)
    alike = _correlations(seen, _speeds(R_imu, pairs, spans))
    best = _nearest_peak(alike, offsets - center)
    if not 0 < best < len(offsets) - 1:
        return Offset(
            seconds=float(offsets[best]), sigma=np.inf, correlation=float(alike[best]), speed_sigma=speed_sigma
        )
    below, peak, above = alike[best - 1 : best + 2]
    curvature = max((2.0 * peak - below - above) / step**2, 1e-12)
    offset = float(offsets[best] + (above - below) / (2.0 * curvature * step))
    sigma = float(np.sqrt(max(1.0 - peak, 1e-6) / (len(pairs) * curvature)))
    return Offset(seconds=offset, sigma=sigma, correlation=float(peak), speed_sigma=speed_sigma)


def _nearest_peak(alike: Array, shifts: Array) -> int:
    """Return the peak nearest to no shift among those that chance could have made the highest: gaits repeat."""
    highest = float(alike.max())
    inner = np.flatnonzero((alike[1:-1] >= alike[:-2]) & (alike[1:-1] >= alike[2:])) + 1
    level = [int(k) for k in inner if 1.0 - alike[k] < 2.0 * (1.0 - highest) + _CORRELATION_NOISE]
    return min(level, key=lambda k: abs(shifts[k]), default=int(alike.argmax()))


def _speeds(R: Array, pairs: NDArray[np.intp], spans: Array) -> Array:
    """Return the angular speeds between neighbouring orientations, (..., N) [rad/s] of (..., M, 3, 3)."""
    # The angle alone: of the chord between two rotations, which is exact for small ones as well.
    chord = np.linalg.norm(
        (R[..., pairs + 1, :, :] - R[..., pairs, :, :]).reshape(*R.shape[:-3], len(pairs), 9), axis=-1
    )
    return np.asarray(2.0 * np.arcsin(np.minimum(chord / np.sqrt(8.0), 1.0)) / spans)


def _correlations(seen: Array, speeds: Array) -> Array:
    """Return how the speeds of each row (K, N) correlate with those seen (N,); 0 where either is constant."""
    a, b = seen - seen.mean(), speeds - speeds.mean(axis=1, keepdims=True)
    size = np.sqrt((a @ a) * np.einsum("kn,kn->k", b, b))
    return np.asarray(b @ a / np.where(size > 0.0, size, 1.0))
