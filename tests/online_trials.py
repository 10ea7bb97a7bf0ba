"""Runs of the filter that begin with a wrong mounting and a wrong clock, and estimate both along."""

from dataclasses import dataclass, replace

import numpy as np

from heliograph.config import RunConfig
from heliograph.data import OnlineCalibration, Rig
from heliograph.lie import so3
from heliograph.odometry import FilterOdometry
from heliograph.sim import SCENARIOS, simulate

ROTATION, LEVER, OFFSET = np.radians(3.0), 0.1, 0.015
CONFIG = RunConfig(
    cloud=replace(RunConfig().cloud, target_points=2000),
    filter=replace(RunConfig().filter, estimate_mounting=True, estimate_time_offset=True),
)


@dataclass(frozen=True)
class OnlineTrial:
    """Errors (7,) of mounting rotation (lidar) [rad], lever arm (imu) [m], clock [s]: at the start and at the end."""

    first_error: np.ndarray
    error: np.ndarray
    covariance: np.ndarray
    found: OnlineCalibration
    R_imu_lidar: np.ndarray
    odometry: FilterOdometry

    @property
    def prior_sigma(self):
        config = CONFIG.filter
        return np.repeat(
            [config.mounting_rotation_sigma, config.mounting_lever_sigma, config.time_offset_sigma], [3, 3, 1]
        )

    @property
    def nees(self):
        return float(self.error @ np.linalg.solve(self.covariance, self.error))


def scenario(kind, duration):
    if kind == "rest":
        return SCENARIOS["room"].varied(walk={"rest": 60.0}).thinned(beams=16, columns=240, duration=duration)
    if kind == "straight":
        still = {"bounce": 0.0, "lateral": 0.0, "roll_deg": 0.0, "pitch_deg": 0.0, "yaw_deg": 0.0}
        straight = replace(SCENARIOS["warehouse"], place="aisles").varied(
            gait=still, walk={"speed": 1.2, "rest": 1.5, "ramp": 1.5}
        )
        return straight.thinned(beams=16, columns=240, duration=duration)
    return SCENARIOS[kind].thinned(beams=16, columns=240, duration=duration)


def online_trial(kind, seed, *, duration, drawn=False, config=CONFIG):
    """Run with errors of fixed size and drawn direction, or with ``drawn`` sizes as the prior says."""
    rng = np.random.default_rng([3, seed])
    turn, shift = rng.normal(size=(2, 3))
    offset = OFFSET
    if drawn:
        turn, shift = config.filter.mounting_rotation_sigma * turn, config.filter.mounting_lever_sigma * shift
        offset = config.filter.time_offset_sigma * rng.normal()
    else:
        turn, shift = ROTATION * turn / np.linalg.norm(turn), LEVER * shift / np.linalg.norm(shift)
    simulation = simulate(scenario(kind, duration).varied(imu={"clock_offset": float(offset)}), seed)
    true = simulation.rig.T_imu_lidar
    wrong = true.copy()
    wrong[:3, :3] = wrong[:3, :3] @ so3.exp(turn)
    wrong[:3, 3] += shift
    odometry = FilterOdometry(config, Rig(T_imu_lidar=wrong, source="wrong"), sensors=frozenset({"lidar", "imu"}))
    results = [r for record in simulation for r in odometry.add(record)] + odometry.finish()
    found = results[-1].calibration
    return OnlineTrial(
        first_error=_error(wrong, 0.0, true, offset),
        error=_error(found.T_imu_lidar, found.imu_offset, true, offset),
        covariance=odometry.core.state.covariance[17:, 17:],
        found=found,
        R_imu_lidar=true[:3, :3],
        odometry=odometry,
    )


def _error(T, offset, T_true, offset_true):
    return np.concatenate([so3.log(T[:3, :3].T @ T_true[:3, :3]), T_true[:3, 3] - T[:3, 3], [offset_true - offset]])
