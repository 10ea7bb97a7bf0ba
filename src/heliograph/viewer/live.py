"""A run while it goes on: a sink that shows each scan as the odometry has it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from heliograph.data import ScanResult
from heliograph.output import RunSummary, Sink
from heliograph.snapshots import Snapshot
from heliograph.viewer.screen import HEIGHT, Screen, colored

__all__ = ["LiveView"]

MAX_POINTS = 20_000
"""Points of a scan that are shown."""
SIGMAS = 3.0
"""Half axes of an ellipsoid, in one-sigmas."""
_PATH = (90, 160, 250)
_LEVELS = {"error": "ERROR", "warning": "WARN"}


class LiveView(Sink):
    """Shows scans, way, covariance, eigenvalues and biases in the odom frame as they come.

    Parameters
    ----------
    screen : Screen
        It stays open: what the finished run has to show comes after.
    max_points : int
        How many points of a scan are shown; 0 shows all.
    """

    def __init__(self, screen: Screen, *, max_points: int = MAX_POINTS) -> None:
        self._screen, self._max_points = screen, max_points
        self._last: NDArray[np.float64] | None = None

    def add(self, result: ScanResult) -> None:
        """Show one scan."""
        screen, T = self._screen, result.T_odom_imu
        screen.at(result.end_ns)
        screen.pose("odom/imu", T)
        every = max(-(-len(result.points_imu) // self._max_points), 1) if self._max_points else 1
        points = result.points_imu[::every]
        heights = points @ T[2, :3].astype(np.float32) + np.float32(T[2, 3])
        low, high = np.percentile(heights, [2.0, 98.0]) if len(heights) else (0.0, 1.0)
        screen.points("odom/imu/scan", points, colors=colored(heights, float(low), float(high), HEIGHT))
        screen.ellipsoid("odom/sigma", T[:3, 3], result.pose_covariance[3:, 3:], SIGMAS)
        if self._last is not None:
            screen.lines("odom/way", [np.stack([self._last, T[:3, 3]])], _PATH)
        self._last = T[:3, 3].copy()
        for place, values in (
            ("live/eigenvalues/translation", result.eigenvalues_translation),
            ("live/eigenvalues/rotation", result.eigenvalues_rotation),
            ("live/gyro_bias", result.gyro_bias),
            ("live/accel_bias", result.accel_bias),
            ("live/speed", [float(np.linalg.norm(result.v_odom))]),
            ("live/rms", [result.rms]),
        ):
            screen.values(place, values)
        for event in result.events:
            screen.say("events", f"{event.code}: {event.message}", _LEVELS.get(event.severity, "INFO"))

    def restart(self) -> None:
        """Begin the way anew."""
        self._last = None

    def snapshot(self) -> Snapshot:
        """Return nothing: a run that goes on shows what comes."""
        return {}

    def restore(self, snapshot: Snapshot) -> None:  # noqa: ARG002 - the protocol's
        """Show what comes."""
        self._last = None

    def close(self, summary: RunSummary) -> None:
        """Say how it ended."""
        for reason in summary.reasons:
            self._screen.say("events", f"{summary.status}: {reason}", "WARN")
