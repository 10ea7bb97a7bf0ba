"""Mounting and clock while the filter runs: taken as given, estimated freely, or estimated where motion excites them.

The filter asks the same questions of all three: with which mounting points are de-skewed and enter the map, what an
update must know, where a scan is inserted, whether the map has been bent by a mounting that is known better now.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from heliograph.arrays import Array, freeze
from heliograph.config import FilterConfig
from heliograph.data import NavState, OnlineCalibration, Rig
from heliograph.data.error_layout import (
    CALIBRATION,
    CLOCK,
    DRIFT,
    FULL_DIM,
    LEVER_ARM,
    MOUNTING,
    MOUNTING_ROTATION,
    NAV_DIM,
    POSE,
    POSE_DIM,
    POSITION,
    ROTATION,
)
from heliograph.imu import ErrorGrowth, ImuPath
from heliograph.lie import se3
from heliograph.odometry.filter.calibration_gate import CalibrationGate
from heliograph.odometry.filter.motion import rate_change
from heliograph.odometry.filter.remounting import anchoring, is_bent, widened
from heliograph.odometry.filter.update import Linearization
from heliograph.registration import MapMounting
from heliograph.snapshots import Stateful, array

__all__ = [
    "CalibrationTerms",
    "FixedCalibration",
    "FreeMounting",
    "GatedCalibration",
    "calibration_of",
    "uncertain_rig",
    "with_calibration",
]


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationTerms:
    """What an update must know of mounting and clock; all None where both are taken as given.

    Parameters
    ----------
    mounted : MapMounting or None
        Given where the mounting is estimated.
    rate_change : (3,) float64 or None
        Change of the body's rate within the sweep [rad/s^2]; given where the clock is a state.
    considered : (25, 25) float64 or None
        Projection onto the directions that must not move; given where mounting and clock are gated.
    """

    mounted: MapMounting | None = None
    rate_change: Array | None = None
    considered: Array | None = None

    def __post_init__(self) -> None:
        freeze(self)

    @property
    def motion(self) -> bool:
        """Whether matches tell about velocity and gyroscope bias; a mounting without a gate takes their place."""
        return self.mounted is None or self.considered is not None

    def map_pose_covariance(self, prior: NavState) -> Array:
        """Return the covariance (6, 6) of where the LiDAR stands on its map: rotation (body), position (odom).

        A gated mounting's error shifts pose and map together, so that the pose alone would look far less certain than
        the match.
        """
        if self.mounted is None or self.considered is None:
            return prior.covariance[POSE, POSE]
        R_first = self.mounted.T_odom_imu_first[:3, :3]
        B = np.eye(POSE_DIM, len(prior.covariance))
        turn = prior.R_odom_imu.T @ R_first
        B[ROTATION, MOUNTING_ROTATION] = (np.eye(3) - turn) @ prior.T_imu_lidar[:3, :3]
        B[POSITION, LEVER_ARM] = prior.R_odom_imu - R_first
        return np.asarray(B @ prior.covariance @ B.T)


class FixedCalibration(Stateful):
    """Mounting and clock as they were given.

    Parameters
    ----------
    T_imu_lidar : (4, 4) float64
        Mounting [m].
    """

    _STATE: ClassVar = {
        "T_imu_lidar": array(np.float64, 4, 4),
    }

    def __init__(self, T_imu_lidar: Array) -> None:
        self.T_imu_lidar = T_imu_lidar
        """Mounting that points are de-skewed and enter the map with, whatever is learnt of it meanwhile."""

    def grow(self, growth: ErrorGrowth) -> None:
        """Carry on what is kept beside the state over one prediction."""

    def learn(self, measurement: Linearization) -> None:
        """Take in what a scan tells."""

    def terms(self, path: ImuPath) -> CalibrationTerms:  # noqa: ARG002 - the sweep matters where the clock is a state
        """Return what the update with a scan swept along ``path`` must know."""
        return CalibrationTerms()

    def map_pose(self, state: NavState, *, first: bool) -> Array:  # noqa: ARG002 - the first pose matters to mountings
        """Return the pose (4, 4) at which to insert a scan, which is the ``first`` of its map or not."""
        return state.T_odom_imu

    def is_bent(self, state: NavState, scans: int) -> bool:  # noqa: ARG002 - a mounting as given bends nothing
        """Whether a map of ``scans`` scans should be begun anew, because the mounting is known better now."""
        return False

    def remounted(self, state: NavState) -> NavState:
        """Return the state with which a new map begins, exact in its pose, and use its mounting from now on."""
        return state

    def account(self, state: NavState) -> OnlineCalibration | None:  # noqa: ARG002 - nothing was estimated
        """Return what a state says of mounting and clock; None where they are not estimated under a gate."""
        return None


class FreeMounting(FixedCalibration):
    """A mounting that every scan may move; for a rough guess that only serves to find a better one."""

    _STATE: ClassVar = {**FixedCalibration._STATE, "_T_odom_imu_first": array(np.float64, 4, 4)}

    def __init__(self, T_imu_lidar: Array) -> None:
        super().__init__(T_imu_lidar)
        self._T_odom_imu_first = np.eye(4)

    def terms(self, path: ImuPath) -> CalibrationTerms:  # noqa: ARG002 - no clock
        """Return what an update must know: columns of the mounting in place of the motion's."""
        return CalibrationTerms(mounted=self._mounted())

    def map_pose(self, state: NavState, *, first: bool) -> Array:
        """Return the pose at which the map's points, made with the mounting of the start, fit those already there.

        As the mounting E is estimated now, the LiDAR stands at ``T E`` and the map, begun at the pose ``T_0`` with the
        mounting ``E_0``, is displaced by ``T_0 E (T_0 E_0)^-1``.
        """
        if first:
            self._T_odom_imu_first = state.T_odom_imu
        if self.T_imu_lidar is state.T_imu_lidar:
            return state.T_odom_imu
        T_odom_lidar_first = self._T_odom_imu_first @ self.T_imu_lidar
        change = se3.inverse(self.T_imu_lidar) @ state.T_imu_lidar
        displaced = T_odom_lidar_first @ se3.inverse(change) @ se3.inverse(T_odom_lidar_first)
        return np.asarray(displaced @ state.T_odom_imu @ state.T_imu_lidar @ se3.inverse(self.T_imu_lidar))

    def _mounted(self) -> MapMounting:
        return MapMounting(T_imu_lidar=self.T_imu_lidar, T_odom_imu_first=self._T_odom_imu_first)


class GatedCalibration(FreeMounting):
    """Mounting and clock under a `CalibrationGate`.

    Parameters
    ----------
    start : NavState
        With the errors of both; one of them may be known exactly.
    config : FilterConfig
    """

    _STATE: ClassVar = {**FreeMounting._STATE, "_gate": CalibrationGate}

    def __init__(self, start: NavState, config: FilterConfig) -> None:
        super().__init__(start.T_imu_lidar)
        self._gate = CalibrationGate.at_start(start, config)
        self._moves_mounting = bool(start.covariance[MOUNTING, MOUNTING].any())

    def grow(self, growth: ErrorGrowth) -> None:
        """Carry the gate's covariance on as the state's is."""
        self._gate = self._gate.predicted(growth)

    def learn(self, measurement: Linearization) -> None:
        """Let the gate take in what a scan tells."""
        self._gate = self._gate.updated(measurement)

    def terms(self, path: ImuPath) -> CalibrationTerms:
        """Return what an update must know: mounting where it is estimated, the clock, and what must not move."""
        return CalibrationTerms(
            mounted=self._mounted() if self._moves_mounting else None,
            rate_change=rate_change(path),
            considered=self._gate.considered(),
        )

    def is_bent(self, state: NavState, scans: int) -> bool:
        """Whether the mounting has changed by enough for a map of ``scans`` scans to show it."""
        return is_bent(self.T_imu_lidar, state, scans)

    def remounted(self, state: NavState) -> NavState:
        """Return the state in the frame of a new map, with what the bent one leaves uncertain of the mounting."""
        M = anchoring(state)
        state = widened(state, self.T_imu_lidar, self._gate.considered())
        state = replace(state, covariance=M @ state.covariance @ M.T)
        self._gate = self._gate.moved(M)
        self.T_imu_lidar = state.T_imu_lidar
        return state

    def account(self, state: NavState) -> OnlineCalibration:
        """Return what a state says of mounting and clock, and which directions the motion has not excited."""
        return self._gate.account(state)


def calibration_of(start: NavState, config: FilterConfig) -> FixedCalibration:
    """Return how a filter that begins with ``start`` treats mounting and clock: as the start's covariance has them."""
    size = len(start.covariance)
    if size == FULL_DIM or (size > FULL_DIM and start.covariance[CALIBRATION, CALIBRATION].any()):
        return GatedCalibration(start, config)
    if size > NAV_DIM and start.covariance[MOUNTING, MOUNTING].any():
        return FreeMounting(start.T_imu_lidar)
    return FixedCalibration(start.T_imu_lidar)


def uncertain_rig(rig: Rig, config: FilterConfig) -> Rig:
    """Return the mounting that the start uses: one to be estimated is no more than a good guess."""
    if not (rig.known and config.estimate_mounting):
        return rig
    return replace(
        rig,
        known=False,
        sigma_rotation=config.mounting_rotation_sigma,
        sigma_translation=config.mounting_lever_sigma,
    )


def with_calibration(state: NavState, config: FilterConfig) -> NavState:
    """Return a start with the errors of mounting and clock; one that is not estimated is known exactly."""
    if not (config.estimate_mounting or config.estimate_time_offset):
        return state
    covariance, size = np.zeros((FULL_DIM, FULL_DIM)), len(state.covariance)
    covariance[:size, :size] = state.covariance
    if config.estimate_time_offset:
        covariance[CLOCK, CLOCK] = config.time_offset_sigma**2
        covariance[DRIFT, DRIFT] = (1e-6 * config.time_drift_sigma_ppm) ** 2
    return replace(state, covariance=covariance)
