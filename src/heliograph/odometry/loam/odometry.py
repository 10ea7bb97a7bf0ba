"""LOAM as an `Odometry`: messages in, results out."""

from __future__ import annotations

from heliograph.config import RunConfig
from heliograph.data import Event, NavState, Rig, WheelSpeeds
from heliograph.errors import ConfigError
from heliograph.odometry.filter.motion import MotionModel
from heliograph.odometry.filter.odometry import FilterOdometry
from heliograph.odometry.loam.core import LoamCore

__all__ = ["LoamOdometry"]


class LoamOdometry(FilterOdometry):
    """LOAM as an `Odometry`. It gathers messages, and finds its start, as the filter does.

    Parameters
    ----------
    config : RunConfig
    rig : Rig
        Mounting; LOAM takes it as given.
    sensors : frozenset of str
        ``"lidar"``, ``"imu"`` or both; the IMU alone is dead reckoned.
    threads : int
        Threads of the native loops; the results do not depend on them.

    Raises
    ------
    ConfigError
        Mounting or clock are to be estimated along, which only the filter does.
    """

    def __init__(self, config: RunConfig, rig: Rig, *, sensors: frozenset[str], threads: int = 1) -> None:
        if config.filter.estimate_mounting or config.filter.estimate_time_offset:
            raise ConfigError(
                "loam takes mounting and clock as given; use --odometry filter to estimate them along, or set "
                "filter.estimate_mounting and filter.estimate_time_offset to false"
            )
        super().__init__(config, rig, sensors=sensors, threads=threads)
        if not rig.known and {"lidar", "imu"} <= sensors:
            text = (
                "the mounting is not known, and loam does not estimate it; run heliograph calibrate and give its "
                "result with --extrinsic, or use --odometry filter"
            )
            self.events.append(Event(code="mounting-uncertain", message=text))

    def observe_speeds(self, speeds: WheelSpeeds) -> None:
        """Take nothing: what LOAM estimates has no place for a speed."""

    def _make_core(self, state: NavState, motion: MotionModel) -> LoamCore:
        return LoamCore(state, motion, self._config, events=self.events, threads=self._threads)
