"""What the inertial checks share, prepared so that one mistake does not look like another."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from heliograph.checks.clock import clock_steps
from heliograph.checks.fit import bias_beside
from heliograph.checks.offset import MAX_OFFSET, Offset, find_offset
from heliograph.checks.records import CheckedMotion, ImuRecord
from heliograph.checks.windows import Forces, Turns, forces_over, turns_over, usable
from heliograph.config import CheckConfig
from heliograph.data import ImuBatch

__all__ = ["FORCE_SPAN", "GRAVITY", "Evidence", "gather"]

GRAVITY = 9.80665
FORCE_SPAN = 2
"""Scans on either side of a second difference of positions: over one, the LiDAR's noise is as large as most
accelerations."""

_TURN_SPAN = 3  # scans over which turns are compared
_UNIT_FACTOR = 3.0  # factor beyond which rates or forces are in another unit


@dataclass(frozen=True, slots=True, kw_only=True)
class Evidence:
    """Everything that the inertial checks read.

    Parameters
    ----------
    imu : ImuRecord
        As recorded.
    batch : ImuBatch
        Its usable samples as an estimator would get them: SI units, stamps that advance.
    motion : CheckedMotion or None
        The LiDAR's view.
    why : str
        Why there is none, or why it cannot be compared.
    gyro_scale, accel_scale : float
        How many times too large the samples are where they are in a wrong unit, roughly; 1 elsewhere.
    offset : Offset or None
        By how much the IMU's stamps are off.
    turns, forces : Turns, Forces or None
        Compared over windows, with samples brought to the right size, at the offset if there is one, over the longest
        stretch without a step of the clock; None without a LiDAR or with too few common scans.
    as_recorded : bool
        Whether turns and forces are of the samples as they came: of one size, at no offset, without a step.
    config : CheckConfig
        From where on a finding warns or fails.
    """

    imu: ImuRecord
    batch: ImuBatch
    motion: CheckedMotion | None
    why: str
    gyro_scale: float = 1.0
    accel_scale: float = 1.0
    offset: Offset | None = None
    turns: Turns | None = None
    forces: Forces | None = None
    as_recorded: bool = False
    config: CheckConfig = field(default_factory=CheckConfig)


def gather(
    imu: ImuRecord, motion: CheckedMotion | None, why: str = "", *, config: CheckConfig | None = None
) -> Evidence:
    """Prepare what the checks share.

    Parameters
    ----------
    imu : ImuRecord
    motion : CheckedMotion or None
    why : str
        Why there is no motion.
    config : CheckConfig, optional
    """
    batch = usable(imu)
    config = config or CheckConfig()
    alone = Evidence(imu=imu, batch=batch, motion=motion, why=why, accel_scale=_accel_scale(batch), config=config)
    if motion is None:
        return alone
    unbroken = _unbroken(imu, batch)
    whole = _within(unbroken, motion)
    gyro_scale = _gyro_scale(whole, motion)
    even = replace(whole, gyro=whole.gyro / gyro_scale, accel=whole.accel / alone.accel_scale)
    turns = turns_over(even, motion, _TURN_SPAN)
    if turns is None:
        return replace(alone, why="LiDAR and IMU overlap too little in time", gyro_scale=gyro_scale)
    offset = find_offset(even, motion)
    if offset is not None:
        # The bias distorts the speeds, and shows only once the turns are compared at about the right time.
        rough = (turns_over(_earlier(even, offset), motion, _TURN_SPAN) if offset.determined else None) or turns
        unbiased = replace(even, gyro=even.gyro - bias_beside(rough))
        offset = find_offset(unbiased, motion, near=offset.seconds if offset.determined else None)
    shifted = offset is not None and offset.significant(config.warn_offset)
    if offset is not None and shifted:
        even = _earlier(even, offset)
        turns = turns_over(even, motion, _TURN_SPAN) or turns
    forces = forces_over(even, motion, FORCE_SPAN)
    untouched = unbroken is batch and gyro_scale == alone.accel_scale == 1.0 and not shifted
    return replace(alone, gyro_scale=gyro_scale, offset=offset, turns=turns, forces=forces, as_recorded=untouched)


def _earlier(batch: ImuBatch, offset: Offset) -> ImuBatch:
    """Return the samples with stamps that match the LiDAR's."""
    return replace(batch, stamps_ns=batch.stamps_ns - round(1e9 * offset.seconds))


def _accel_scale(batch: ImuBatch) -> float:
    size = float(np.median(np.linalg.norm(batch.accel, axis=1))) / GRAVITY if len(batch) else 0.0
    return size if size > 0.0 and not 1.0 / _UNIT_FACTOR < size < _UNIT_FACTOR else 1.0


def _gyro_scale(batch: ImuBatch, motion: CheckedMotion) -> float:
    """Return by how much the gyroscope is faster than the LiDAR, from their speeds' spread: rotations would wrap."""
    stamps, T = motion.trajectory.stamps_ns, motion.trajectory.T_frame_body
    if len(stamps) < 3:
        return 1.0
    inside = np.flatnonzero((batch.stamps_ns >= stamps[0]) & (batch.stamps_ns <= stamps[-1]))
    if len(inside) < len(stamps) // 2:
        return 1.0
    steps = np.swapaxes(T[:-1, :3, :3], -1, -2) @ T[1:, :3, :3]
    cosine = (np.trace(steps, axis1=-2, axis2=-1) - 1.0) / 2.0
    seen = np.arccos(np.clip(cosine, -1.0, 1.0)) / (np.diff(stamps) * 1e-9)
    rates = batch.gyro[inside]
    felt: NDArray[np.float64] = np.linalg.norm(rates - np.median(rates, axis=0), axis=1)
    fast = float(np.quantile(seen, 0.9))
    ratio = float(np.quantile(felt, 0.9)) / fast if fast > 0.05 else 1.0
    return ratio if ratio > 0.0 and not 1.0 / _UNIT_FACTOR < ratio < _UNIT_FACTOR else 1.0


def _within(batch: ImuBatch, motion: CheckedMotion) -> ImuBatch:
    """Return the samples that can be compared, whatever the offset; a long recording has many more."""
    stamps, margin = motion.trajectory.stamps_ns, round(1e9 * (MAX_OFFSET + 1.0))
    if not len(stamps):
        return batch
    begin, end = np.searchsorted(batch.stamps_ns, [stamps[0] - margin, stamps[-1] + margin])
    return _part(batch, int(begin), int(end))


def _part(batch: ImuBatch, begin: int, end: int) -> ImuBatch:
    part = slice(begin, end)
    return replace(batch, stamps_ns=batch.stamps_ns[part], gyro=batch.gyro[part], accel=batch.accel[part])


def _unbroken(imu: ImuRecord, batch: ImuBatch) -> ImuBatch:
    """Return the longest stretch of the samples without a step of the clock."""
    steps = clock_steps(imu)[0] if imu.stamp == "header" else np.zeros(0, np.int64)
    if not len(steps):
        return batch
    cuts = [0, *np.searchsorted(batch.stamps_ns, imu.stamps_ns[steps]).tolist(), len(batch)]
    begin, end = max(pairwise(cuts), key=lambda piece: piece[1] - piece[0])
    return _part(batch, begin, end) if end - begin > 1 else batch
