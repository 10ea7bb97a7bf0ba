"""Keyframes of a simulated walk with an odometry that drifts: seconds where a run takes minutes."""

from dataclasses import dataclass

import numpy as np

from heliograph.data import ImuBatch, Keyframe
from heliograph.lie import se3
from heliograph.sim.places import PLACES
from heliograph.sim.sensors import LidarModel

LIDAR = LidarModel(beams=24, columns=240, elevation_deg=(-30.0, 30.0), min_range=0.4, max_range=40.0)


@dataclass(frozen=True)
class DriftingWalk:
    """Keyframes as an odometry would make them, and the truth."""

    keyframes: tuple
    T_true: np.ndarray

    def error(self, T_map_imu, index=-1):
        """Return how far a pose is off when the first ones are laid on each other [m]."""
        T = self.T_true[0] @ se3.inverse(T_map_imu[0]) @ T_map_imu
        return float(np.linalg.norm(T[index, :3, 3] - self.T_true[index, :3, 3]))

    def rmse(self, T_map_imu):
        """Return the absolute trajectory error with the first poses laid on each other [m]."""
        T = self.T_true[0] @ se3.inverse(T_map_imu[0]) @ T_map_imu
        return float(np.sqrt(np.mean(np.sum((T[:, :3, 3] - self.T_true[:, :3, 3]) ** 2, axis=1))))


def drifting_walk(*, place="aisles", laps=1.5, spacing=1.0, seed=0, position=0.01, rotation_deg=0.1, noise=0.01):
    """Return a walk of some laps of a place's course; each step of its odometry is off by the sigmas given."""
    rng = np.random.default_rng(seed)
    place = PLACES[place](np.random.default_rng(1))
    samples, _ = place.course.sample(spacing)
    around = samples[:-1]
    count = int(laps * len(around))
    way = np.array([around[k % len(around)] for k in range(count)])
    T_true = np.stack([_pose(row) for row in way])
    step = np.diag([np.radians(rotation_deg) ** 2] * 3 + [position**2] * 3)
    T_odom, keyframes = T_true[0], []
    for index in range(count):
        if index:
            moved = se3.inverse(T_true[index - 1]) @ T_true[index]
            T_odom = T_odom @ moved @ se3.exp(rng.multivariate_normal(np.zeros(6), step))
        keyframes.append(_keyframe(index, T_odom, _seen(place.world, T_true[index], noise, rng), step))
    return DriftingWalk(keyframes=tuple(keyframes), T_true=T_true)


def _pose(row):
    x, y, z, yaw = row
    c, s = np.cos(yaw), np.sin(yaw)
    T = np.eye(4)
    T[:2, :2], T[:3, 3] = [[c, -s], [s, c]], [x, y, z]
    return T


def _seen(world, T_world_imu, noise, rng):
    directions = LIDAR.directions()
    poses = np.broadcast_to(T_world_imu, (LIDAR.columns, 4, 4)).copy()
    returns = world.cast(directions, poses, min_range=LIDAR.min_range, max_range=LIDAR.max_range)
    hit = returns.range > 0.0
    ranges = returns.range[hit] + noise * rng.standard_normal(int(hit.sum()))
    return (directions[hit] * ranges[:, None]).astype(np.float32)


def _keyframe(index, T_odom_imu, points, step):
    return Keyframe(
        index=index,
        stamp_ns=10**9 * (index + 1),
        T_odom_imu=np.ascontiguousarray(T_odom_imu),
        v_odom=np.zeros(3),
        gyro_bias=np.zeros(3),
        accel_bias=np.zeros(3),
        g_odom=np.zeros(3),
        step_covariance=step if index else np.zeros((6, 6)),
        lidar_information=np.eye(6) * 1e6,
        points_imu=points,
        intensity=None,
        imu=ImuBatch.joined([]),
    )
