"""A stretch of simulated motion seen by an IMU and by a LiDAR with independent pose errors, and its alignment."""

from dataclasses import replace

import numpy as np

from heliograph.config import ImuConfig
from heliograph.data import ImuBatch, Trajectory
from heliograph.imu import align_motion
from heliograph.lie import s2, se3, so3
from heliograph.sim import SCENARIOS, simulate
from states import GRAVITY

# The simulator's samples are exact at their instants and its noise is known, so nothing is added for what is not.
CONFIG = replace(ImuConfig(), curvature=0.0)
STEADY = {
    "gyro_walk": 0.0,
    "accel_walk": 0.0,
    "gyro_bias": CONFIG.gyro_bias_sigma,
    "accel_bias": CONFIG.accel_bias_sigma,
}
ROOM = SCENARIOS["room"].thinned(beams=2, columns=8).varied(imu=STEADY)
ROAD = SCENARIOS["start-constant"].thinned(beams=2, columns=8).varied(imu=STEADY)
SIGMA_ROTATION, SIGMA_POSITION = 5e-4, 5e-3


class Trial:
    """A simulated stretch seen by a LiDAR with independent pose errors, aligned, and its true errors.

    ``scale`` multiplies what the accelerometer shows, ``quiet`` takes the sensors' noise away.
    """

    def __init__(self, seed, scenario=ROOM, *, begin=6.0, seconds=3.0, body="lidar", quiet=1.0, scale=1.0, **options):
        rng = np.random.default_rng(seed)
        sim = simulate(scenario.varied(walk={"begin": begin, "duration": seconds + 0.3}), seed)
        gyro, accel = sim.imu()
        errors = sim.imu_errors
        gyro = gyro - (1.0 - quiet) * errors.gyro_noise
        accel = scale * (accel - errors.accel_bias) + errors.accel_bias - (1.0 - quiet) * errors.accel_noise
        self.imu = ImuBatch(stamps_ns=sim.imu_stamps_ns, gyro=gyro, accel=accel, received_ns=0)
        self.stamps = sim.imu_stamps_ns[0] + 100_000_000 + np.arange(0, int(seconds * 1e9), 100_000_000)
        self.T_imu_lidar, self.noise = sim.rig.T_imu_lidar, sim.imu_noise
        odom = se3.exp(rng.normal(size=6))  # the LiDAR's odometry begins anywhere
        exact = odom @ (sim.truth.lidar_pose(self.stamps) if body == "lidar" else sim.truth.pose(self.stamps))
        T = exact.copy()
        T[:, :3, :3] = T[:, :3, :3] @ so3.exp(quiet * SIGMA_ROTATION * rng.normal(size=(len(T), 3)))
        T[:, :3, 3] += quiet * SIGMA_POSITION * rng.normal(size=(len(T), 3))
        self.poses = Trajectory(stamps_ns=self.stamps, T_frame_body=T, body=body)
        told = max(quiet, 0.02) * np.repeat([SIGMA_ROTATION, SIGMA_POSITION], 3)
        self.covariance = np.tile(np.diag(told**2), (len(T), 1, 1))
        self.begin_ns = int(self.stamps[0]) - 90_000_000
        self.found = self.align(**options)
        at = sim.truth.motion(np.array([self.begin_ns]))
        R, f = odom[:3, :3], self.found
        self.R, self.v, self.up_imu = R @ at.R_world_body[0], R @ at.v_world[0], at.R_world_body[0, 2]
        self.error = np.concatenate([
            so3.log(f.R_odom_imu[0].T @ self.R),
            R @ at.p_world[0] + odom[:3, 3] - f.p_odom[0],
            self.v - f.v_odom[0],
            errors.gyro_bias[0] - f.gyro_bias,
            errors.accel_bias[0] - f.accel_bias,
            s2.local(f.g_odom / GRAVITY, -odom[:3, 2]),
            [np.log(scale / f.accel_scale)],
        ])  # fmt: skip

    def align(self, *, imu=None, poses=None, config=CONFIG, **options):
        arguments = {"noise": self.noise, "config": config, "begin_ns": self.begin_ns, "T_imu_lidar": self.T_imu_lidar}
        return align_motion(
            self.poses if poses is None else poses,
            self.covariance,
            self.imu if imu is None else imu,
            **{**arguments, **options},
        )

    def nees(self, part):
        e, P = self.error[part], self.found.covariance[part, part]
        return float(e @ np.linalg.solve(P, e))
