"""What every odometry does, and the one place that makes one."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from heliograph.config import RunConfig
from heliograph.data import Event, GnssFix, ImuBatch, Rig, Scan, ScanResult
from heliograph.errors import ConfigError, closest
from heliograph.odometry.filter.odometry import FilterOdometry

__all__ = ["Odometry", "make_odometry"]


class Odometry(Protocol):
    """Causal estimation: messages go in as they were received, results come out when they are ready."""

    events: list[Event]

    def add(self, message: Scan | ImuBatch | GnssFix) -> list[ScanResult]:
        """Take one message and return the results that it made ready, in time order; often none."""
        ...

    def finish(self) -> list[ScanResult]:
        """Return the results still waiting: the stream has ended."""
        ...

    def leveling(self) -> NDArray[np.float64]:
        """Return ``T_leveled_odom`` (4, 4): the rotation that puts z up by all that was learnt about gravity."""
        ...


def make_odometry(config: RunConfig, rig: Rig, sensors: frozenset[str], threads: int) -> Odometry:
    """Return the odometry that ``config.odometry`` names.

    Parameters
    ----------
    config : RunConfig
    rig : Rig
        Mounting of the LiDAR on the IMU.
    sensors : frozenset of str
        What to use of ``"lidar"`` and ``"imu"``.
    threads : int
        Of the native loops; the result does not depend on it.

    Raises
    ------
    ConfigError
        Unknown name, or no usable sensor.
    """
    if config.odometry != "filter":
        raise ConfigError(f"odometry '{config.odometry}' is not one of 'filter'{closest(config.odometry, ['filter'])}")
    if not sensors & {"lidar", "imu"}:
        raise ConfigError("neither a LiDAR nor an IMU to work with; see --sensors")
    return FilterOdometry(config, rig, sensors=sensors, threads=threads)
