"""An odometry of one's own, scan to map by point-to-plane steps: heliograph run DRIVE --odometry own_odometry:make."""

import numpy as np

from heliograph.cloud import voxel_downsample
from heliograph.config import RunConfig
from heliograph.data import Message, Rig, Scan, ScanResult
from heliograph.lie import se3
from heliograph.maps import VoxelMap
from heliograph.odometry import Odometry, pose_result
from heliograph.registration.linearize import MatchSettings, linearize


class ScanToMap(Odometry):
    """Carries the last motion on, then fits the scan to the map; `heliograph.testing.assert_odometry` checks it."""

    def __init__(self, config: RunConfig, rig: Rig) -> None:
        self.events, self.count, self.last = [], 0, None
        self.map, self.T_imu_lidar, self.step = VoxelMap(config.map), rig.T_imu_lidar, np.zeros(6)
        self.match = MatchSettings(gate=0.5, kernel=0.2, sigma=config.filter.sigma)

    def add(self, message: Message) -> list[ScanResult]:
        if not isinstance(message, Scan):
            return []  # an IMU could tell which way is up, and how the sensor turns
        before = np.eye(4) if self.last is None else self.last.T_odom_imu
        T = se3.retract(before, self.step)
        points_imu = np.float32(se3.act(self.T_imu_lidar, message.points[voxel_downsample(message.points, 0.5)]))
        for _ in range(10 if self.last else 0):
            normal = linearize(self.map, points_imu, T, self.match)
            d = -np.linalg.solve(normal.information + 1e-9 * np.eye(6), normal.gradient)
            T = se3.retract(T, [*d[:3], *T[:3, :3].T @ d[3:]])
        self.last = pose_result(message, self.count, T, before=self.last, T_imu_lidar=self.T_imu_lidar)
        self.map.insert(self.last.points_imu, T)
        self.step, self.count = se3.local(before, T), self.count + 1
        return [self.last]


def make(config: RunConfig, rig: Rig, *_: object) -> Odometry:  # what sensors there are, how many threads
    return ScanToMap(config, rig)
