"""What an IMU at rest tells: which way is down, the gyroscope's bias, the noise, and whether it really rested."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import freeze
from heliograph.config import ImuConfig
from heliograph.data import ImuBatch, ImuNoise
from heliograph.errors import DataError

__all__ = ["StaticStart", "assess_stillness"]

_MIN_BLOCKS = 4
_BLOCK_SHARE = 1.0 / 3.0  # of the spread at rest that means over blocks may show: they are quieter than samples
_BORDER_SHARE = 0.8


@dataclass(frozen=True, slots=True, kw_only=True)
class StaticStart:
    """Statistics of the first samples and the verdict on them.

    Parameters
    ----------
    still : bool
        Whether every channel is as quiet and as slow as an IMU at rest, vibration aside.
    vibrating : bool
        Whether it shakes without going anywhere, as on an idling engine: its spread is beyond that of rest, but the
        means over `ImuConfig.still_block` are not.
    biased : bool
        Whether it is calm, but with a mean rate or a mean force beyond what a usual bias explains: a very large bias,
        or a steady turn. Up to `ImuConfig.biased_rate` and `ImuConfig.biased_gravity_error` that may be rest.
    reason : str
        What spoke against stillness, with numbers; empty when still.
    statistic : float
        Largest finding as a share of its limit: one is the border of rest.
    grade : str
        ``"good"``, ``"fair"`` (vibrating, biased, short, or near the border of rest) or ``"poor"`` (not still).
    remark : str
        Numbers behind the grade.
    gyro_mean, accel_mean : (3,) float64
        [rad/s], [m/s^2].
    gyro_sigma, accel_sigma : (3,) float64
        Standard deviation of one sample [rad/s], [m/s^2].
    covariance : (6, 6) float64
        Covariance of the means of gyroscope and accelerometer by their own noise; a constant bias does not show in it.
    period : float
        Median distance between samples [s].
    duration : float
        [s].
    noise : ImuNoise
        Densities measured at rest, kept within the limits of the configuration; the configured ones when not still.
    """

    still: bool
    vibrating: bool
    biased: bool
    reason: str
    statistic: float
    grade: str
    remark: str
    gyro_mean: NDArray[np.float64]
    accel_mean: NDArray[np.float64]
    gyro_sigma: NDArray[np.float64]
    accel_sigma: NDArray[np.float64]
    covariance: NDArray[np.float64]
    period: float
    duration: float
    noise: ImuNoise

    def __post_init__(self) -> None:
        freeze(self)

    @property
    def doubtful(self) -> bool:
        """Whether only something else than the IMU, such as the LiDAR, can tell that this is rest."""
        return self.vibrating or self.biased


def assess_stillness(imu: ImuBatch, config: ImuConfig) -> StaticStart:
    """Judge whether the IMU rests throughout ``imu``, measure its noise, and say how well its means are known.

    At rest the gyroscope shows its bias and the accelerometer gravity, both constant up to white noise. Tested are the
    spread of each channel, the mean rate, the length of the mean force, and the change of the mean from the first to
    the second half, each against a limit of ``config``. On an idling engine the spread is large but averages out within
    a few periods, which no motion that goes anywhere does: there the means over blocks are tested in its place. A
    vehicle at constant speed on a smooth road passes all of these, and a steady turn looks like a bias: only the LiDAR
    can tell, so the filter asks it too.

    Raises
    ------
    DataError
        Fewer than two samples.
    """
    if len(imu) < 2:
        raise DataError(f"{len(imu)} IMU samples before the first scans; at least 2 are needed to start")
    period = float(np.median(np.diff(imu.stamps_ns))) * 1e-9
    duration = float(imu.stamps_ns[-1] - imu.stamps_ns[0]) * 1e-9
    samples = np.hstack([imu.gyro, imu.accel])
    sigma, blocks = samples.std(axis=0), _block_means(imu, samples, config.still_block)
    vibrating = _vibrates(sigma, blocks, config)
    slow = blocks if vibrating else samples
    mean, half = slow.mean(axis=0), len(slow) // 2
    drift = float(np.linalg.norm(slow[:half, 3:].mean(axis=0) - slow[half:, 3:].mean(axis=0)))
    spread = blocks.std(axis=0) / _BLOCK_SHARE if vibrating else sigma
    rate, force = float(np.linalg.norm(mean[:3])), abs(float(np.linalg.norm(mean[3:])) - config.gravity)
    biased = rate > config.still_rate or force > config.still_gravity_error
    findings = [
        ("gyro spread", float(spread[:3].max()), config.still_gyro_sigma, "rad/s"),
        ("accelerometer spread", float(spread[3:].max()), config.still_accel_sigma, "m/s^2"),
        ("mean rate", rate, config.biased_rate if biased else config.still_rate, "rad/s"),
        ("gravity error", force, config.biased_gravity_error if biased else config.still_gravity_error, "m/s^2"),
        ("force change", drift, config.still_accel_sigma, "m/s^2"),
    ]
    reasons = [f"{name} {value:.3g} > {limit:.3g} {unit}" for name, value, limit, unit in findings if value > limit]
    if duration < config.still_duration:
        reasons.append(f"only {duration:.2f} s < {config.still_duration:.2f} s of data")
    still, statistic = not reasons, max(value / limit for _, value, limit, _ in findings)
    doubts = [*(["vibrating"] if vibrating else []), *(["very large bias"] if biased else [])]
    grade, remark = _graded(still, doubts, statistic, duration, sigma, config)
    return StaticStart(
        still=still,
        vibrating=vibrating,
        biased=biased,
        reason=", ".join(reasons),
        statistic=statistic,
        grade=grade,
        remark=remark,
        gyro_mean=mean[:3],
        accel_mean=mean[3:],
        gyro_sigma=sigma[:3],
        accel_sigma=sigma[3:],
        covariance=_mean_covariance(samples, blocks, max(duration / period, 1.0), vibrating=vibrating),
        period=period,
        duration=duration,
        noise=_measured_noise(sigma[:3], sigma[3:], period, config) if still else configured_noise(config),
    )


def _block_means(imu: ImuBatch, samples: NDArray[np.float64], block: float) -> NDArray[np.float64]:
    """Return the means over blocks of ``block`` seconds that overlap by half, (B, 6), under Hann windows.

    A plain mean lets several percent of a vibration through, more or less by its frequency; the window's
    sidelobes are an order lower, from two periods a block on.
    """
    t = (imu.stamps_ns - imu.stamps_ns[0]) * (1e-9 / block)
    means = []
    # Only blocks with a sample in them: of a gap in the stamps there is any number.
    halves = np.unique(np.concatenate([np.floor(2.0 * t), np.floor(2.0 * t) - 1.0]))
    for begin in 0.5 * halves[(halves >= 0.0) & (0.5 * halves < float(t[-1]) - 1.0 + 1e-6)]:
        weight = np.where(np.abs(t - begin - 0.5) < 0.5, np.sin(np.pi * (t - begin)) ** 2, 0.0)
        if float(weight.sum()) > 0.0:
            means.append(weight @ samples / weight.sum())
    return np.stack(means) if means else samples[:1]


def _vibrates(sigma: NDArray[np.float64], blocks: NDArray[np.float64], config: ImuConfig) -> bool:
    """Whether the spread is beyond that of rest, within that of a vibration, and gone in the blocks' means."""
    rest = np.repeat([config.still_gyro_sigma, config.still_accel_sigma], 3)
    worst = np.repeat([config.vibration_gyro, config.vibration_accel], 3)
    if len(blocks) < _MIN_BLOCKS or bool((sigma <= rest).all()) or bool((sigma > worst).any()):
        return False
    return bool((blocks.std(axis=0) <= _BLOCK_SHARE * rest).all())


def _graded(
    still: bool, doubts: list[str], statistic: float, duration: float, sigma: NDArray[np.float64], config: ImuConfig
) -> tuple[str, str]:
    numbers = (
        f"{duration:.1f} s, largest test at {statistic:.0%} of its limit, spread {sigma[:3].max():.2g} rad/s and "
        f"{sigma[3:].max():.2g} m/s^2"
    )
    if not still:
        return "poor", numbers
    doubts = [
        *doubts,
        *(["short"] if duration < 0.9 * config.start_window else []),
        *(["near the border of rest"] if statistic > _BORDER_SHARE else []),
    ]
    return ("fair", f"{', '.join(doubts)}; {numbers}") if doubts else ("good", numbers)


def _mean_covariance(
    samples: NDArray[np.float64], blocks: NDArray[np.float64], count: float, *, vibrating: bool
) -> NDArray[np.float64]:
    """Return the covariance of the mean of ``count`` samples, (6, 6); vibration is not white, its blocks nearly are."""
    white = np.cov(samples, rowvar=False, bias=True) / count
    if not vibrating:
        return np.asarray(white)
    slow = np.cov(blocks, rowvar=False) / (0.5 * (len(blocks) + 1))  # they overlap by half
    return np.asarray(slow if np.trace(slow[3:, 3:]) > np.trace(white[3:, 3:]) else white)


def configured_noise(config: ImuConfig) -> ImuNoise:
    """Return the densities that are assumed of an IMU that was never seen at rest."""
    return ImuNoise(
        gyro=config.gyro_noise, accel=config.accel_noise, gyro_walk=config.gyro_walk, accel_walk=config.accel_walk
    )


def _measured_noise(
    gyro_sigma: NDArray[np.float64], accel_sigma: NDArray[np.float64], period: float, config: ImuConfig
) -> ImuNoise:
    # White noise of density n sampled each T seconds has a standard deviation of n / sqrt(T). Rest shows neither scale
    # errors nor vibration, so the density is not taken below a floor, and never above what is assumed of an unknown
    # IMU.
    root = float(np.sqrt(period))
    gyro = float(np.clip(gyro_sigma.mean() * root, config.gyro_noise_floor, config.gyro_noise))
    accel = float(np.clip(accel_sigma.mean() * root, config.accel_noise_floor, config.accel_noise))
    return ImuNoise(gyro=gyro, accel=accel, gyro_walk=config.gyro_walk, accel_walk=config.accel_walk)
