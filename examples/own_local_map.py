"""A local map of one's own, one plane a cube, in place of the built-in one: python own_local_map.py [SECONDS]."""

from __future__ import annotations

import sys

import numpy as np
from numpy.typing import NDArray

from heliograph.config import RunConfig
from heliograph.maps import PlaneMatches
from heliograph.odometry import FilterOdometry
from heliograph.sim import SCENARIOS, simulate


class CubeMap:
    """A `heliograph.maps.LocalMap`; `heliograph.testing.assert_local_map` checks such a class."""

    def __init__(self, edge: float = 0.5) -> None:
        self.edge = edge
        self.clear()

    def clear(self) -> None:
        self.keys, self.sums = np.array([-1]), np.ones((1, 13))  # an unused cube; count, sum 3, outer product 9

    def insert(self, points_body: NDArray[np.float32], T_odom_body: NDArray[np.float64]) -> float:
        p = points_body[np.isfinite(points_body).all(axis=1)] @ T_odom_body[:3, :3].T + T_odom_body[:3, 3]
        rows = np.hstack([np.ones((len(p), 1)), p, (p[:, :, None] * p[:, None, :]).reshape(-1, 9)])
        old, rows = self.keys, np.concatenate([self.sums, rows])
        self.keys, where = np.unique(np.concatenate([old, self._key(p)]), return_inverse=True)
        self.sums = np.stack([np.bincount(where, column, len(self.keys)) for column in rows.T], axis=1)
        return 1.0 - float(np.isin(np.unique(self._key(p)), old).mean()) if len(p) else 0.0

    def prune(self, centre_odom: NDArray[np.float64]) -> None:
        near = np.r_[True, np.linalg.norm(self.sums[1:, 1:4] / self.sums[1:, :1] - centre_odom, axis=1) < 100.0]
        self.keys, self.sums = self.keys[near], self.sums[near]

    def planes_at(self, points_odom: NDArray[np.float64], *, gate: float) -> PlaneMatches:
        key = self._key(points_odom)
        cube = np.searchsorted(self.keys, key).clip(max=len(self))
        n, mean = self.sums[cube, :1], self.sums[cube, 1:4] / self.sums[cube, :1]
        spread, axes = np.linalg.eigh((self.sums[cube, 4:] / n).reshape(-1, 3, 3) - mean[:, :, None] * mean[:, None])
        flat = (n[:, 0] >= 8) & (spread[:, 0] < 0.05**2) & (spread[:, 1] > (0.1 * self.edge) ** 2)
        near = np.abs(((points_odom - mean) * axes[:, :, 0]).sum(axis=1)) < gate
        source = (near & flat & (self.keys[cube] == key)).astype(np.uint8)
        normal, variance = np.float32(axes[:, :, 0]), np.float32(spread[:, 0].clip(min=1e-9) / n[:, 0])
        return PlaneMatches(normal=normal, point=mean, variance=variance, source=source)

    def __len__(self) -> int:
        return len(self.keys) - 1

    def _key(self, p: NDArray[np.float64]) -> NDArray[np.int64]:
        return (np.floor(p / self.edge).astype(np.int64) + (1 << 20)) @ np.array([1 << 42, 1 << 21, 1])


if __name__ == "__main__":
    simulation = simulate(SCENARIOS["room"].thinned(columns=256, duration=float([*sys.argv, "15"][1])), seed=1)
    odometry = FilterOdometry(RunConfig(), simulation.rig, sensors=frozenset({"lidar", "imu"}), local_map=CubeMap())
    results = [result for message in simulation for result in odometry.add(message)] + odometry.finish()
    print(f"{len(results)} scans, {results[-1].matches} matches in the last, ended at {results[-1].T_odom_imu[:3, 3]}")
