"""Runs of the filter that begin with a wrong mounting and a wrong clock, and estimate both along."""

from dataclasses import dataclass, replace

import numpy as np

from heliograph.config import RunConfig
from heliograph.data import OnlineCalibration, Rig
from heliograph.data.error_layout import CALIBRATION
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
    """Errors (8,) of mounting rotation (lidar) [rad], lever arm (imu) [m], clock offset [s] and drift [s/s].

    At the start and at the end; the offset is that of the moment.
    """

    first_error: np.ndarray
    error: np.ndarray
    covariance: np.ndarray
    found: OnlineCalibration
    R_imu_lidar: np.ndarray
    odometry: FilterOdometry
    results: list

    @property
    def prior_sigma(self):
        return prior_sigma(CONFIG.filter)

    @property
    def nees(self):
        return float(self.error @ np.linalg.solve(self.covariance, self.error))


def prior_sigma(config):
    drift = 1e-6 * config.time_drift_sigma_ppm
    sigma = [config.mounting_rotation_sigma, config.mounting_lever_sigma, config.time_offset_sigma, drift]
    return np.repeat(sigma, [3, 3, 1, 1])


def scenario(kind, duration):
    """A recording of about so long: the course is given, so a long one walks it slowly, swaying as ever."""
    if kind == "rest":
        return SCENARIOS["room"].varied(walk={"rest": 60.0}).thinned(beams=16, columns=240, duration=duration)
    if kind == "straight":
        still = {"bounce": 0.0, "lateral": 0.0, "roll_deg": 0.0, "pitch_deg": 0.0, "yaw_deg": 0.0}
        straight = replace(SCENARIOS["warehouse"], place="aisles").varied(
            gait=still, walk={"speed": 1.2, "rest": 1.5, "ramp": 1.5}
        )
        return straight.thinned(beams=16, columns=240, duration=duration)
    speed = SCENARIOS[kind].walk.speed * min(1.0, 30.0 / duration)
    return SCENARIOS[kind].varied(walk={"speed": speed}).thinned(beams=16, columns=240, duration=duration)


def online_trial(kind, seed, *, duration, drawn=False, drift=0.0, config=CONFIG, local_map=None):
    """Run with errors of fixed size and drawn direction, or with ``drawn`` sizes as the prior says; ``drift`` [s/s]."""
    rng = np.random.default_rng([3, seed])
    turn, shift = rng.normal(size=(2, 3))
    offset = OFFSET
    if drawn:
        turn, shift = config.filter.mounting_rotation_sigma * turn, config.filter.mounting_lever_sigma * shift
        offset = config.filter.time_offset_sigma * rng.normal()
        drift = 1e-6 * config.filter.time_drift_sigma_ppm * rng.normal()
    else:
        turn, shift = ROTATION * turn / np.linalg.norm(turn), LEVER * shift / np.linalg.norm(shift)
    clock = {"clock_offset": float(offset), "clock_drift_ppm": 1e6 * float(drift)}
    simulation = simulate(scenario(kind, duration).varied(imu=clock), seed)
    true = simulation.rig.T_imu_lidar
    wrong = true.copy()
    wrong[:3, :3] = wrong[:3, :3] @ so3.exp(turn)
    wrong[:3, 3] += shift
    rig, both = Rig(T_imu_lidar=wrong, source="wrong"), frozenset({"lidar", "imu"})
    odometry = FilterOdometry(config, rig, sensors=both, local_map=local_map)
    results = [r for record in simulation for r in odometry.add(record)] + odometry.finish()
    found = results[-1].calibration
    late = float(simulation.clock.offset_at(np.int64(found.stamp_ns)))
    return OnlineTrial(
        first_error=_error(wrong, (0.0, 0.0), true, (offset, drift)),
        error=_error(found.T_imu_lidar, (found.imu_offset, found.imu_drift), true, (late, drift)),
        covariance=odometry.core.state.covariance[CALIBRATION, CALIBRATION],
        found=found,
        R_imu_lidar=true[:3, :3],
        odometry=odometry,
        results=results,
    )


def _error(T, clock, T_true, clock_true):
    mounting = [so3.log(T[:3, :3].T @ T_true[:3, :3]), T_true[:3, 3] - T[:3, 3]]
    return np.concatenate([*mounting, np.subtract(clock_true, clock)])
