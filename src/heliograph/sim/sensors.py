"""Models of a spinning LiDAR and an IMU: parameters, and how they turn truth into samples."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import freeze
from heliograph.config_checks import check_range
from heliograph.sim.world import Returns

__all__ = ["ImuErrors", "ImuModel", "LidarModel", "measure_ranges"]


@dataclass(frozen=True, slots=True, kw_only=True)
class LidarModel:
    """A spinning LiDAR: all beams of a column fire at one instant, columns at equal intervals, clockwise from the rear.

    Parameters
    ----------
    beams, columns : int
        Rays a column, columns a turn.
    rate : float
        Turns a second [Hz].
    elevation_deg : (float, float)
        Lowest and highest beam [deg].
    min_range, max_range : float
        Nothing outside is returned [m].
    range_noise : float
        One-sigma of the range [m].
    dropout : float
        Probability that a return is lost.
    """

    beams: int = 64
    columns: int = 1024
    rate: float = 10.0
    elevation_deg: tuple[float, float] = (-22.5, 22.5)
    min_range: float = 0.5
    max_range: float = 120.0
    range_noise: float = 0.02
    dropout: float = 0.01

    def __post_init__(self) -> None:
        check_range(self, "beams", "columns", low=1, high=100_000)
        check_range(self, "rate", low=0.01, high=1000.0)
        check_range(self, "elevation_deg", low=-90.0, high=90.0)
        check_range(self, "min_range", "max_range", "range_noise", low=0.0, high=1e6)
        check_range(self, "dropout", low=0.0, high=1.0)

    @property
    def period_ns(self) -> int:
        """Duration of a turn [ns]."""
        return round(1e9 / self.rate)

    @property
    def column_offsets_ns(self) -> NDArray[np.int64]:
        """Firing time of each column since the start of the turn, (columns,) [ns]."""
        return np.round(np.arange(self.columns) * (self.period_ns / self.columns)).astype(np.int64)

    def directions(self) -> NDArray[np.float64]:
        """Return unit vectors of all rays in the lidar frame, (beams, columns, 3); row 0 is the highest beam."""
        azimuth = np.pi - 2.0 * np.pi * np.arange(self.columns) / self.columns
        elevation = np.radians(np.linspace(self.elevation_deg[1], self.elevation_deg[0], self.beams))
        directions = np.empty((self.beams, self.columns, 3))
        directions[..., 0] = np.cos(elevation)[:, None] * np.cos(azimuth)
        directions[..., 1] = np.cos(elevation)[:, None] * np.sin(azimuth)
        directions[..., 2] = np.sin(elevation)[:, None]
        return directions


@dataclass(frozen=True, slots=True, kw_only=True)
class ImuModel:
    """Noise of an IMU; densities are continuous.

    Parameters
    ----------
    rate : float
        Samples a second [Hz].
    gyro_noise : float
        [rad/s/sqrt(Hz)].
    accel_noise : float
        [m/s^2/sqrt(Hz)].
    gyro_walk : float
        Random walk of the gyroscope's bias [rad/s^2/sqrt(Hz)].
    accel_walk : float
        Random walk of the accelerometer's bias [m/s^3/sqrt(Hz)].
    gyro_bias : float
        One-sigma of the constant bias drawn for each axis [rad/s].
    accel_bias : float
        One-sigma of the constant bias drawn for each axis [m/s^2].
    clock_offset : float
        What the IMU's clock shows more than the LiDAR's, which is the true one, at the recording's first instant [s].
    clock_drift_ppm : float
        How much faster it runs [1e-6].
    """

    rate: float = 200.0
    gyro_noise: float = 2e-4
    accel_noise: float = 2e-3
    gyro_walk: float = 1e-5
    accel_walk: float = 1e-4
    gyro_bias: float = 0.01
    accel_bias: float = 0.05
    clock_offset: float = 0.0
    clock_drift_ppm: float = 0.0

    def __post_init__(self) -> None:
        check_range(self, "rate", low=0.1, high=100_000.0)
        names = ("gyro_noise", "accel_noise", "gyro_walk", "accel_walk", "gyro_bias", "accel_bias")
        check_range(self, *names, low=0.0, high=1e3)
        check_range(self, "clock_offset", low=-1e9, high=1e9)
        check_range(self, "clock_drift_ppm", low=-1e5, high=1e5)


def measure_ranges(exact: Returns, model: LidarModel, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return noisy ranges [m], (beams, columns), 0 where there is no return or it was lost."""
    noise = rng.standard_normal(exact.range.shape)
    lost = rng.random(exact.range.shape, dtype=np.float32) < model.dropout
    noisy = exact.range + model.range_noise * noise
    noisy[(exact.primitive < 0) | lost | (noisy < model.min_range)] = 0.0
    return noisy


@dataclass(frozen=True, slots=True, kw_only=True)
class ImuErrors:
    """What an IMU adds to the truth, sample by sample.

    Parameters
    ----------
    gyro_bias, accel_bias : (M, 3) float64
        Bias at each sample: constant part and random walk [rad/s], [m/s^2].
    gyro_noise, accel_noise : (M, 3) float64
        White noise [rad/s], [m/s^2].
    """

    gyro_bias: NDArray[np.float64]
    accel_bias: NDArray[np.float64]
    gyro_noise: NDArray[np.float64]
    accel_noise: NDArray[np.float64]

    def __post_init__(self) -> None:
        freeze(self)

    @classmethod
    def draw(cls, model: ImuModel, count: int, rng: np.random.Generator) -> ImuErrors:
        """Draw the errors of ``count`` samples.

        Notes
        -----
        A density ``n`` sampled at rate ``f`` has sigma ``n sqrt(f)``; a walk ``w`` takes steps of sigma ``w / sqrt(f)``
        (J. Crassidis, Sigma-point Kalman filtering for integrated GPS and inertial navigation, 2006).
        """
        root = float(np.sqrt(model.rate))

        def bias(constant: float, walk: float) -> NDArray[np.float64]:
            steps = walk / root * rng.standard_normal((count, 3))
            return constant * rng.standard_normal(3) + np.cumsum(steps, axis=0)

        return cls(
            gyro_bias=bias(model.gyro_bias, model.gyro_walk),
            accel_bias=bias(model.accel_bias, model.accel_walk),
            gyro_noise=model.gyro_noise * root * rng.standard_normal((count, 3)),
            accel_noise=model.accel_noise * root * rng.standard_normal((count, 3)),
        )
