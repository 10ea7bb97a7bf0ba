"""A run while it goes on: a sink that shows each scan as the odometry has it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from heliograph.data import ScanResult
from heliograph.maps import VoxelMap
from heliograph.output import RunSummary, Sink
from heliograph.snapshots import Snapshot
from heliograph.viewer.screen import FAR, HEIGHT, RESIDUAL, Screen, colored

__all__ = ["LiveView"]

MAX_POINTS = 20_000
"""Points of a scan that are shown."""
SIGMAS = 3.0
"""Half axes of an ellipsoid, in one-sigmas."""
_MATCHED = 4_000  # points of a scan that are matched, as many as an odometry takes
_GATE = 0.25  # farthest plane of a match [m]
_PRUNE_AFTER = 5.0  # way after which the map lets go of what is far away [m]
_PATH = (90, 160, 250)
_LEVELS = {"error": "ERROR", "warning": "WARN"}


class LiveView(Sink):
    """Shows scans, matches, way, covariance, eigenvalues and biases in the odom frame as they come.

    A scan's matches are the planes that the scans before it make of the place, in a map of the view's own: so they are
    there whatever odometry runs, and are what the default one matches to.

    Parameters
    ----------
    screen : Screen
        It stays open: what the finished run has to show comes after.
    max_points : int
        How many points of a scan are shown; 0 shows all.
    residuals : bool
        Show matches, coloured by their residual.
    """

    def __init__(self, screen: Screen, *, max_points: int = MAX_POINTS, residuals: bool = True) -> None:
        self._screen, self._max_points = screen, max_points
        self._map = VoxelMap() if residuals else None
        self._last: NDArray[np.float64] | None = None
        self._pruned_at = np.zeros(3)

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
        self._show_matches(result)
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

    def _show_matches(self, result: ScanResult) -> None:
        """Show which points find a plane in the scans before, coloured by their distance to it; then take the scan."""
        if self._map is None or not len(result.points_imu):
            return
        T = result.T_odom_imu
        points = result.points_imu[:: -(-len(result.points_imu) // _MATCHED)]
        placed = points.astype(np.float64) @ T[:3, :3].T + T[:3, 3]
        planes = self._map.planes_at(placed, gate=_GATE)
        found = planes.source > 0
        off = np.abs(np.einsum("ij,ij->i", planes.normal.astype(np.float64), placed - planes.point))[found]
        if found.any():
            colors = colored(off, 0.0, FAR, RESIDUAL)
            self._screen.points("odom/imu/matches", points[found], colors=colors, size=3.0)
            self._screen.values("live/median_residual", [float(np.median(off))])
        self._map.insert(result.points_imu, T)
        if float(np.linalg.norm(T[:3, 3] - self._pruned_at)) > _PRUNE_AFTER:
            self._map.prune(T[:3, 3])
            self._pruned_at = T[:3, 3].copy()

    def restart(self) -> None:
        """Begin the way anew."""
        self._last = None
        if self._map is not None:
            self._map.clear()

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
