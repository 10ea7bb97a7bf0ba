"""A recording cut into stretches of equal steps, and those of them in which the IMU rests."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import Array, Mask, freeze
from heliograph.config import ImuConfig
from heliograph.data import ImuBatch
from heliograph.errors import DataError

__all__ = ["Grid", "ImuStretch", "even_stretches", "still_stretches"]


_MAX_MISSING = 5  # samples missing in a row that are interpolated; more of them split the record
_STEP_TOLERANCE = 0.05  # steps within this share of the usual one are even
_LONG_STEPS, _PAUSE = 0.99, 10.0  # quantile of the steps, and how many times it a pause lasts
_PERIOD_SPAN = 1000  # steps over which one estimate of the period is taken, so that jitter hardly enters it
_WINDOW, _MIN_SAMPLES = 0.5, 8  # length of one look at the signal [s], and samples in it
_AVERAGING = 0.02  # what the limits of stillness are held against is averaged over this long [s]
_MIN_REST = 5.0  # shortest stretch of rest that is used [s]
_QUIET_SHARE, _LOUDNESS_RATIO = 0.2, 3.0  # share of windows taken for quiet, and how much louder others may be
_JUMP_RATIO = 8.0  # largest change of a mean from one window to the next, by its usual one
_SWAY_RATIO = 20.0  # how much more than white noise the means of quiet windows may scatter, as a ratio of variances


@dataclass(frozen=True, slots=True, kw_only=True)
class ImuStretch:
    """Samples at equal steps without a gap.

    Parameters
    ----------
    begin_ns : int
        Time of the first [ns].
    samples : (n, 6) float64
        Gyroscope [rad/s], then accelerometer [m/s^2].
    """

    begin_ns: int
    samples: Array

    def __post_init__(self) -> None:
        freeze(self)

    def __len__(self) -> int:
        return len(self.samples)


@dataclass(frozen=True, slots=True, kw_only=True)
class Grid:
    """A recording as stretches of equal steps.

    Parameters
    ----------
    period : float
        The step [s].
    stretches : tuple of ImuStretch
        In the order of time.
    filled : int
        Single samples that were missing and were interpolated.
    gaps : int
        Longer losses, which separate stretches.
    """

    period: float
    stretches: tuple[ImuStretch, ...]
    filled: int
    gaps: int

    @property
    def duration(self) -> float:
        """Time covered by the stretches [s]."""
        return self.period * sum(len(stretch) for stretch in self.stretches)


def even_stretches(imu: ImuBatch) -> Grid:
    """Put samples on equal steps.

    An IMU samples by its own even clock; what jitters is when the stamps were taken. Samples are therefore counted
    rather than placed by their stamps: a stamp moves the count on only where it is later than all lateness so far
    explains, which is where samples were lost. Up to five in a row are interpolated, more begin a new stretch.

    Parameters
    ----------
    imu : ImuBatch
        The whole recording.

    Raises
    ------
    DataError
        Fewer than two samples, or stamps that do not increase.
    """
    n = len(imu)
    if n < 2:
        raise DataError(f"{n} IMU samples; noise does not show in fewer than two - check --imu-topic")
    steps = np.diff(imu.stamps_ns)
    if (steps <= 0).any():
        bad = int((steps <= 0).sum())
        raise DataError(f"{bad} of {n} IMU stamps do not increase; sort and clean the samples first")
    period_ns = _period_ns(steps)
    ideal = np.rint((imu.stamps_ns - imu.stamps_ns[0]) / period_ns).astype(np.int64)
    slots = np.arange(n) + np.maximum.accumulate(ideal - np.arange(n))
    samples = np.hstack([imu.gyro, imu.accel])
    missing = np.diff(slots) - 1
    cuts = np.flatnonzero(missing > _MAX_MISSING) + 1
    bounds = np.concatenate([[0], cuts, [n]])
    stretches = tuple(
        ImuStretch(begin_ns=int(imu.stamps_ns[first]), samples=_filled(slots[first:last], samples[first:last]))
        for first, last in pairwise(bounds.tolist())
    )
    filled = int(missing[missing <= _MAX_MISSING].sum())
    return Grid(period=1e-9 * period_ns, stretches=stretches, filled=filled, gaps=len(cuts))


def _period_ns(steps: NDArray[np.int64]) -> float:
    """Return the IMU's own period: the usual step where stamps are even, else that of long spans."""
    usual = float(np.median(steps))
    # A few long steps are pauses, which may last for years; those between packets are many.
    steps = np.where(steps > _PAUSE * np.quantile(steps, _LONG_STEPS, method="higher"), usual, steps)
    even = np.abs(steps - usual) <= _STEP_TOLERANCE * usual
    # Samples stamped as they arrive in packets have an even step as well, but it covers next to no time.
    if even.mean() >= 0.5 and 2 * float(steps[even].sum()) >= float(steps.sum()):
        return float(steps[even].mean())
    span = min(_PERIOD_SPAN, len(steps))
    times = np.concatenate([[0.0], np.cumsum(steps, dtype=np.float64)])
    return float(np.median(times[span:] - times[:-span])) / span


def _filled(slots: NDArray[np.int64], samples: Array) -> Array:
    """Return samples for every slot from the first to the last, interpolated where one is missing."""
    every = np.arange(slots[0], slots[-1] + 1)
    if len(every) == len(slots):
        return samples
    return np.stack([np.interp(every, slots, column) for column in samples.T], axis=1)


def still_stretches(grid: Grid, config: ImuConfig) -> Grid:
    """Return what is left of a recording when all that is not rest is cut away.

    Rest is judged on windows of half a second: by the limits of ``config`` for a static start, then against the quiet
    ones among them, because what passes there may still be touched, driven past or turned slowly. Where the means of
    the windows scatter far more than the samples inside them explain, the whole sways.

    Parameters
    ----------
    grid : Grid
        From `even_stretches`.
    config : ImuConfig
        Limits of stillness.

    Returns
    -------
    Grid
        Stretches of at least five seconds each; none where nothing is still.
    """
    size = max(round(_WINDOW / grid.period), _MIN_SAMPLES)
    windows = [_windows(stretch.samples, size) for stretch in grid.stretches]
    means = np.concatenate([mean for mean, _ in windows]).reshape(-1, 6)
    sigmas = np.concatenate([sigma for _, sigma in windows]).reshape(-1, 6)
    if not len(means):
        return replace(grid, stretches=())
    slow = np.concatenate([_slow_spread(stretch.samples, size, grid.period) for stretch in grid.stretches])
    calm = _within_limits(means, slow, config)
    if not calm.any():
        return replace(grid, stretches=())
    counts = np.cumsum([0, *(len(mean) for mean, _ in windows)])
    finest = np.array([_finest_step(grid, channel) for channel in range(6)])
    quiet = np.quantile(sigmas[calm], _QUIET_SHARE, axis=0)
    calm &= (sigmas <= _LOUDNESS_RATIO * quiet + 2.0 * finest).all(axis=1)
    jumps = np.abs(np.diff(means, axis=0))
    pairs = calm[1:] & calm[:-1]
    pairs[counts[1:-1][(counts[1:-1] > 0) & (counts[1:-1] < len(calm))] - 1] = False
    usual = 1.4826 * np.median(jumps[pairs], axis=0) if pairs.any() else np.zeros(6)
    if (usual**2 > _SWAY_RATIO * (2.0 * quiet**2 / size) + finest**2).any():
        return replace(grid, stretches=())
    joined = pairs & (jumps <= _JUMP_RATIO * usual + finest).all(axis=1)
    least = int(np.ceil(_MIN_REST / (size * grid.period)))
    kept: list[ImuStretch] = []
    for stretch, first, last in zip(grid.stretches, counts[:-1], counts[1:], strict=True):
        kept += _runs(stretch, calm[first:last], joined[first : max(last - 1, first)], size, least, grid.period)
    return replace(grid, stretches=tuple(kept))


def _windows(samples: Array, size: int) -> tuple[Array, Array]:
    """Return means and standard deviations of consecutive windows, each (w, 6)."""
    count = len(samples) // size
    blocks = samples[: count * size].reshape(count, size, 6)
    return blocks.mean(axis=1), blocks.std(axis=1)


def _slow_spread(samples: Array, size: int, period: float) -> Array:
    """Return the standard deviations of 20 ms averages in each window, (w, 6).

    The limits of stillness are meant for motion. White noise of single samples grows with the rate: at 1 kHz that of a
    common IMU would pass for motion by itself.
    """
    part = min(max(round(_AVERAGING / period), 1), size // _MIN_SAMPLES)
    count, parts = len(samples) // size, size // part
    blocks = samples[: count * size].reshape(count, size, 6)[:, : parts * part]
    return np.asarray(blocks.reshape(count, parts, part, 6).mean(axis=2).std(axis=1))


def _within_limits(means: Array, sigmas: Array, config: ImuConfig) -> Mask:
    calm: Mask = (
        (sigmas[:, :3].max(axis=1) <= config.still_gyro_sigma)
        & (sigmas[:, 3:].max(axis=1) <= config.still_accel_sigma)
        & (np.linalg.norm(means[:, :3], axis=1) <= config.still_rate)
        & (np.abs(np.linalg.norm(means[:, 3:], axis=1) - config.gravity) <= config.still_gravity_error)
    )
    return calm


def _finest_step(grid: Grid, channel: int) -> float:
    """Return the smallest change of a channel: its resolution, where that is coarse enough to matter."""
    longest = max(grid.stretches, key=len)
    changes = np.abs(np.diff(longest.samples[:100_000, channel]))
    changes = changes[changes > 0.0]
    return float(changes.min()) if len(changes) else 0.0


def _runs(stretch: ImuStretch, calm: Mask, joined: Mask, size: int, least: int, period: float) -> list[ImuStretch]:
    """Return the runs of calm windows without a jump; one window is given up at each end that borders on motion."""
    runs, first, count = [], 0, len(calm)
    for k in range(count):
        if k + 1 < count and calm[k] and joined[k]:
            continue
        at_end = k + 1 == count and bool(calm[k])
        begin = first + (first > 0)
        end = count if at_end else k - (not calm[k])
        if end - begin >= least:
            stop = len(stretch) if at_end else end * size
            at = stretch.begin_ns + round(1e9 * period * begin * size)
            runs.append(ImuStretch(begin_ns=at, samples=stretch.samples[begin * size : stop]))
        first = k + 1
    return runs
