"""The IMU's usable samples, and the turns and accelerations that it and the LiDAR saw over the same windows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import Array, Stamps, freeze
from heliograph.checks.records import CheckedMotion, ImuRecord
from heliograph.data import ImuBatch
from heliograph.lie import interpolate_se3, se3, so3

__all__ = [
    "MAX_VALUE",
    "Forces",
    "Turns",
    "forces_over",
    "lever_arm",
    "orientation_at",
    "period_s",
    "turns_over",
    "usable",
]


MAX_VALUE = 1e5  # in any unit; beyond it a message is damaged
_MAX_BUNDLE = 8  # samples that a driver may send at once
_MAX_GAP_S = 0.1  # of the IMU within a comparison [s]


@dataclass(frozen=True, slots=True, kw_only=True)
class Turns:
    """Rotations over the same windows as both sensors saw them.

    Parameters
    ----------
    imu, lidar : (N, 3) float64
        Rotation vectors, each in its sensor's own frame [rad].
    spans : (N,) float64
        Lengths of the windows [s].
    first : (N,) int64
        The scan that each begins with.
    overlap : int
        Windows that share each instant: one row in ``overlap`` is independent.
    """

    imu: Array
    lidar: Array
    spans: Array
    first: NDArray[np.int64]
    overlap: int

    def __post_init__(self) -> None:
        freeze(self)


@dataclass(frozen=True, slots=True, kw_only=True)
class Forces:
    """Accelerations over the same windows as both sensors saw them.

    A window is three scans; the LiDAR's part is the second difference of its positions, the IMU's the same difference
    of its twice integrated specific force, turned into the odom frame by the LiDAR's attitude. That is linear in the
    rotation between the sensors, which is therefore left open.

    Parameters
    ----------
    specific : (N, 3, 3, 3) float64
        ``f_odom[n, a] = sum_bc specific[n, a, b, c] R_lidar_imu[b, c]`` is the mean specific force [m/s^2].
    lidar : (N, 3) float64
        Mean acceleration of the LiDAR in odom [m/s^2].
    R_odom_lidar : (N, 3, 3) float64
        Second difference of the LiDAR's attitude in the same sense [1/s^2]; times the lever arm it adds to ``lidar``.
    half_span : (N,) float64
        Half the length of each window [s].
    first : (N,) int64
        The scan that each begins with.
    overlap : int
        Windows that share each instant.
    """

    specific: Array
    lidar: Array
    R_odom_lidar: Array
    half_span: Array
    first: NDArray[np.int64]
    overlap: int

    def __post_init__(self) -> None:
        freeze(self)

    def imu_acceleration(self, p_lidar_imu: Array) -> Array:
        """Return the LiDAR's view of the IMU's acceleration, (N, 3) in odom, for the lever arm in the lidar frame."""
        return np.asarray(self.lidar + self.R_odom_lidar @ p_lidar_imu)


def usable(imu: ImuRecord) -> ImuBatch:
    """Return the samples that an estimator would be given: finite, in SI units, with stamps that advance."""
    stamps = imu.stamps_ns if imu.stamp == "header" else imu.received_ns
    values = np.concatenate([imu.gyro, imu.accel], axis=1)
    whole = np.flatnonzero(np.all(np.abs(values) < MAX_VALUE, axis=1))  # NaN fails the comparison
    before = np.concatenate([[np.iinfo(np.int64).min], np.maximum.accumulate(stamps[whole])[:-1]])[: len(whole)]
    kept = whole[stamps[whole] > before]
    return ImuBatch(
        stamps_ns=stamps[kept],
        gyro=imu.gyro[kept] * imu.gyro_factor,
        accel=imu.accel[kept] * imu.accel_factor,
        received_ns=int(imu.received_ns[-1]) if len(imu) else 0,
    )


def period_s(batch: ImuBatch) -> float:
    """Return the usual distance of the samples [s]; 0 for fewer than two.

    The median over a few steps at a time, so that samples which come in bundles do not hide it.
    """
    many = min(_MAX_BUNDLE, len(batch) - 1)
    if many < 1:
        return 0.0
    return float(np.median(batch.stamps_ns[many:] - batch.stamps_ns[:-many])) * 1e-9 / many


def orientation_at(batch: ImuBatch, at_ns: Stamps) -> Array:
    """Return the gyroscope's own orientation at the stamps, from an arbitrary first one, (..., 3, 3).

    Trapezoidal: the rate between two samples is their mean. Outside the samples the nearest rate is held.
    """
    seconds = (batch.stamps_ns - batch.stamps_ns[0]) * 1e-9
    steps = so3.exp(0.5 * (batch.gyro[1:] + batch.gyro[:-1]) * np.diff(seconds)[:, None])
    R = np.concatenate([np.eye(3)[None], _running_product(steps)])
    at = (at_ns - batch.stamps_ns[0]) * 1e-9
    before = np.clip(np.searchsorted(seconds, at, side="right") - 1, 0, len(batch) - 2)
    rate = 0.5 * (batch.gyro[before] + batch.gyro[before + 1])
    return np.asarray(R[before] @ so3.exp(rate * (at - seconds[before])[..., None]))


def _running_product(steps: Array) -> Array:
    """Return the products of the first 1, 2, ... of some matrices, (N, 3, 3), each from the left to the right.

    Within blocks of about sqrt(N), all blocks at once; then each block is set upon the end of the one before it.
    """
    length = max(1, int(np.sqrt(len(steps))))
    blocks = -(-len(steps) // length)
    product = np.tile(np.eye(3), (blocks * length, 1, 1))
    product[: len(steps)] = steps
    product = product.reshape(blocks, length, 3, 3)
    for k in range(1, length):
        product[:, k] = product[:, k - 1] @ product[:, k]
    for b in range(1, blocks):
        product[b] = product[b - 1, -1] @ product[b]
    return np.asarray(product.reshape(-1, 3, 3)[: len(steps)])


def _windows(batch: ImuBatch, motion: CheckedMotion, span: int) -> NDArray[np.int64]:
    """Return the first scan of each window of ``span`` steps that both sensors cover without a break."""
    stamps, count = motion.trajectory.stamps_ns, len(motion) - span
    if count <= 0 or len(batch) < 2:
        return np.zeros(0, np.int64)
    first = np.arange(count)
    steps = np.diff(batch.stamps_ns)
    longest = max(_MAX_GAP_S, 1.5 * period_s(batch))
    torn = np.concatenate([[0], np.cumsum(steps > longest * 1e9)])
    index = np.clip(np.searchsorted(batch.stamps_ns, stamps), 1, len(batch) - 1)
    inside = (stamps >= batch.stamps_ns[0]) & (stamps <= batch.stamps_ns[-1]) & (steps[index - 1] <= longest * 1e9)
    lost = np.concatenate([[0], np.cumsum(~(motion.tracked & inside))])
    period = float(np.median(np.diff(stamps)))
    steady = stamps[span:] - stamps[:-span] < 1.5 * span * period
    whole = (lost[span + 1 :] - lost[: -span - 1] == 0) & (torn[index[span:]] == torn[index[:-span]])
    return np.asarray(first[steady & whole])


def turns_over(batch: ImuBatch, motion: CheckedMotion, span: int) -> Turns | None:
    """Return what both sensors turned over windows of ``span`` scans; None where there are too few."""
    first = _windows(batch, motion, span)
    if len(first) < 3 * span:
        return None
    stamps, R_odom_lidar = motion.trajectory.stamps_ns, motion.trajectory.T_frame_body[:, :3, :3]
    half = round(0.5e9 * motion.sweep)
    early, R_imu, late = orientation_at(batch, np.stack([stamps - half, stamps, stamps + half]))
    # A sweep shows the mean of its poses, which cuts the peaks of a fast sway: the IMU's side gets the same mean.
    back = np.swapaxes(R_imu, -1, -2)
    R_imu = R_imu @ so3.exp((so3.log(back @ early) + so3.log(back @ late)) / 6.0)
    turned = [so3.log(np.swapaxes(R[first], -1, -2) @ R[first + span]) for R in (R_imu, R_odom_lidar)]
    spans: Array = (stamps[first + span] - stamps[first]).astype(np.float64) * 1e-9
    return Turns(imu=turned[0], lidar=turned[1], spans=spans, first=first, overlap=span)


def forces_over(batch: ImuBatch, motion: CheckedMotion, span: int) -> Forces | None:
    """Return what both sensors accelerated over windows of twice ``span`` scans; None where there are too few."""
    first = _windows(batch, motion, 2 * span)
    if len(first) < 6 * span:
        return None
    stamps, T_odom_lidar = motion.trajectory.stamps_ns, motion.trajectory.T_frame_body
    seconds = (stamps - stamps[0]) * 1e-9
    margin = round(1e9 * motion.sweep)
    within = (batch.stamps_ns >= stamps[0] - margin) & (batch.stamps_ns <= stamps[-1] + margin)
    T = interpolate_se3(stamps, T_odom_lidar, batch.stamps_ns[within], extrapolate=True)
    turned = np.einsum("nab,nc->nabc", T[:, :3, :3], batch.accel[within]).reshape(-1, 27)
    around = (seconds - 0.5 * motion.sweep, seconds, seconds + 0.5 * motion.sweep)
    at = (batch.stamps_ns[within] - stamps[0]) * 1e-9
    early, middle, late = (_integrate_twice(at, turned, when) for when in around)
    twice = (early + 4.0 * middle + late) / 6.0  # the mean over a sweep, as the LiDAR's position is one

    def second_difference(values: Array) -> Array:
        a, b, c = (values[first + k * span] for k in range(3))
        before, after = (
            (seconds[first + (k + 1) * span] - seconds[first + k * span]).reshape(-1, *[1] * (values.ndim - 1))
            for k in range(2)
        )
        return np.asarray(((c - b) / after - (b - a) / before) / (0.5 * (before + after)))

    return Forces(
        specific=second_difference(twice).reshape(-1, 3, 3, 3),
        lidar=second_difference(T_odom_lidar[:, :3, 3]),
        R_odom_lidar=second_difference(T_odom_lidar[:, :3, :3]),
        half_span=0.5 * (seconds[first + 2 * span] - seconds[first]),
        first=first,
        overlap=2 * span,
    )


def _integrate_twice(seconds: Array, values: Array, at: Array) -> Array:
    """Return the second integral of sampled values at the times ``at``: piecewise linear values, exact between them."""
    step = np.diff(seconds)[:, None]
    slope = np.diff(values, axis=0) / step
    once = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(step * (values[1:] + values[:-1]) / 2, axis=0)])
    grown = step * once[:-1] + step**2 * values[:-1] / 2 + step**3 * slope / 6
    twice = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(grown, axis=0)])
    before = np.clip(np.searchsorted(seconds, at, side="right") - 1, 0, len(seconds) - 2)
    d = (at - seconds[before])[:, None]
    return np.asarray(twice[before] + d * once[before] + d**2 / 2 * values[before] + d**3 / 6 * slope[before])


def lever_arm(motion: CheckedMotion) -> Array:
    """Return where the IMU sits in the lidar frame, (3,) [m]; zero where nothing tells."""
    return np.asarray(se3.inverse(motion.rig.T_imu_lidar)[:3, 3]) if motion.rig.known else np.zeros(3)
