"""Which odometries there are by name, and the one place that makes one."""

from __future__ import annotations

from collections.abc import Callable

from heliograph.config import RunConfig
from heliograph.data import Rig
from heliograph.errors import ConfigError
from heliograph.odometry.filter.odometry import FilterOdometry
from heliograph.odometry.loam.odometry import LoamOdometry
from heliograph.odometry.protocol import Odometry
from heliograph.plugins import call_plugin, check_plugin, find_plugin, plugin_names

__all__ = ["ODOMETRIES", "OdometryFactory", "find_odometry", "make_odometry", "odometry_names", "register_odometry"]

OdometryFactory = Callable[[RunConfig, Rig, frozenset[str], int], Odometry]
"""Called as ``factory(config, rig, sensors, threads)``; see `make_odometry`."""

GROUP = "heliograph.odometry"


def _filter(config: RunConfig, rig: Rig, sensors: frozenset[str], threads: int) -> Odometry:
    return FilterOdometry(config, rig, sensors=sensors, threads=threads)


def _loam(config: RunConfig, rig: Rig, sensors: frozenset[str], threads: int) -> Odometry:
    return LoamOdometry(config, rig, sensors=sensors, threads=threads)


ODOMETRIES: dict[str, OdometryFactory | str] = {"filter": _filter, "loam": _loam}
"""Name -> factory, or ``"module:name"`` of one; `register_odometry` adds to it. Packages add theirs as entry points of
the group ``heliograph.odometry``."""


def register_odometry(name: str, factory: OdometryFactory | str) -> None:
    """Let an odometry be chosen by name: in ``config.odometry``, and with ``--odometry``.

    Parameters
    ----------
    name : str
        A name that stands already is taken over.
    factory : callable or str
        Called as ``factory(config, rig, sensors, threads)``, or ``"module:name"`` of such a callable, which is imported
        when it is needed.

    Raises
    ------
    ConfigError
        A name that is empty or holds a colon.
    """
    if not name or ":" in name:
        raise ConfigError(f"'{name}' cannot name an odometry; give a word without a colon")
    ODOMETRIES[name] = factory


def odometry_names() -> list[str]:
    """Return the names of all odometries, registered and installed."""
    return plugin_names(ODOMETRIES, GROUP)


def find_odometry(name: str) -> OdometryFactory:
    """Return the factory that a name stands for.

    Parameters
    ----------
    name : str
        As registered, of an entry point, or ``"module:name"``.

    Raises
    ------
    ConfigError
        An unknown name (the message names the nearest), or a module that cannot be imported.
    """
    factory: OdometryFactory = find_plugin("odometry", name, ODOMETRIES, GROUP)
    if not callable(factory):
        raise ConfigError(f"odometry '{name}' is no function that makes one, but a {type(factory).__name__}")
    return factory


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
        How many the native loops may use; the result does not depend on it.

    Raises
    ------
    ConfigError
        Unknown name, no usable sensor, or a user's factory that fails or makes no odometry.
    """
    factory = find_odometry(config.odometry)
    if not sensors & {"lidar", "imu"}:
        raise ConfigError("neither a LiDAR nor an IMU to work with; see --sensors")
    odometry: Odometry = call_plugin("odometry", config.odometry, factory, config, rig, sensors, threads)
    check_plugin("odometry", config.odometry, odometry, Odometry)
    return odometry
