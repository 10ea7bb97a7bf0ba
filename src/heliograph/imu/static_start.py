"""What an IMU at rest tells: which way is down, the gyroscope's bias, the noise, and whether it really rested."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph.config import ImuConfig
from heliograph.data import ImuBatch, ImuNoise
from heliograph.errors import DataError

__all__ = ["StaticStart", "assess_stillness"]


@dataclass(frozen=True, slots=True, kw_only=True)
class StaticStart:
    """Statistics of the first samples and the verdict on them.

    Parameters
    ----------
    still : bool
        Whether every channel is as quiet and as slow as an IMU at rest.
    reason : str
        What spoke against stillness, with numbers; empty when still.
    gyro_mean, accel_mean : (3,) float64
        [rad/s], [m/s^2].
    gyro_sigma, accel_sigma : (3,) float64
        Standard deviation of one sample [rad/s], [m/s^2].
    period : float
        Median distance between samples [s].
    duration : float
        [s].
    noise : ImuNoise
        Densities measured at rest, kept within the limits of the configuration; the configured ones when not still.
    """

    still: bool
    reason: str
    gyro_mean: NDArray[np.float64]
    accel_mean: NDArray[np.float64]
    gyro_sigma: NDArray[np.float64]
    accel_sigma: NDArray[np.float64]
    period: float
    duration: float
    noise: ImuNoise


def assess_stillness(imu: ImuBatch, config: ImuConfig) -> StaticStart:
    """Judge whether the IMU rests throughout ``imu`` and measure its noise.

    At rest the gyroscope shows its bias and the accelerometer gravity, both constant up to white noise. Tested are the
    spread of each channel, the mean rate, the length of the mean force, and the change of the mean from the first to
    the second half, each against a limit of ``config``. A vehicle at constant speed on a smooth road passes all of
    these: only the LiDAR can tell, so the filter asks it too.

    Raises
    ------
    DataError
        Fewer than two samples.
    """
    if len(imu) < 2:
        raise DataError(f"{len(imu)} IMU samples before the first scans; at least 2 are needed to start")
    period = float(np.median(np.diff(imu.stamps_ns))) * 1e-9
    duration = float(imu.stamps_ns[-1] - imu.stamps_ns[0]) * 1e-9
    gyro_mean, accel_mean = imu.gyro.mean(axis=0), imu.accel.mean(axis=0)
    gyro_sigma, accel_sigma = imu.gyro.std(axis=0), imu.accel.std(axis=0)
    half = len(imu) // 2
    drift = float(np.linalg.norm(imu.accel[:half].mean(axis=0) - imu.accel[half:].mean(axis=0)))
    findings = [
        ("gyro spread", float(gyro_sigma.max()), config.still_gyro_sigma, "rad/s"),
        ("accelerometer spread", float(accel_sigma.max()), config.still_accel_sigma, "m/s^2"),
        ("mean rate", float(np.linalg.norm(gyro_mean)), config.still_rate, "rad/s"),
        ("gravity error", abs(float(np.linalg.norm(accel_mean)) - config.gravity), config.still_gravity_error, "m/s^2"),
        ("force change", drift, config.still_accel_sigma, "m/s^2"),
    ]
    reasons = [f"{name} {value:.3g} > {limit:.3g} {unit}" for name, value, limit, unit in findings if value > limit]
    if duration < config.still_duration:
        reasons.append(f"only {duration:.2f} s < {config.still_duration:.2f} s of data")
    still = not reasons
    return StaticStart(
        still=still,
        reason=", ".join(reasons),
        gyro_mean=gyro_mean,
        accel_mean=accel_mean,
        gyro_sigma=gyro_sigma,
        accel_sigma=accel_sigma,
        period=period,
        duration=duration,
        noise=_measured_noise(gyro_sigma, accel_sigma, period, config) if still else configured_noise(config),
    )


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
