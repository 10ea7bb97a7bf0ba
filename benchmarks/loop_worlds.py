"""Keyframes for the benchmark of loops: simulated walks with exact truth, real sets, and odometry that drifts."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import Array, Points, freeze
from heliograph.config import LoopConfig
from heliograph.data import ImuBatch, Keyframe
from heliograph.io.files.clouds import read_cloud
from heliograph.lie import se3, so3
from heliograph.registration import prepare_cloud
from heliograph.sim.places import PLACES
from heliograph.sim.revisits import STOREYS_HEIGHT, STOREYS_LENGTH, STOREYS_PITCH, storeys_world
from heliograph.sim.sensors import LidarModel, measure_ranges
from heliograph.sim.world import SimulatedWorld, box, rectangle
from heliograph.slam.loops import loop_align_config

__all__ = ["WORLDS", "DriftingOdometry", "KeyframeSet", "corridors", "partners", "read_keyframes"]


@dataclass(frozen=True, slots=True, kw_only=True)
class KeyframeSet:
    """Clouds in their body frames and the poses that they are judged by.

    Parameters
    ----------
    name : str
    clouds : tuple of (N, 3) float32
    T_world_imu : (K, 4, 4) float64
        Truth, or another system's poses.
    """

    name: str
    clouds: tuple[Points, ...]
    T_world_imu: Array

    def __post_init__(self) -> None:
        freeze(self)

    def __len__(self) -> int:
        return len(self.clouds)


class DriftingOdometry:
    """True poses spoilt by a seeded random walk, with the covariance that this walk really has.

    Parameters
    ----------
    keyframes : KeyframeSet
    step, step_deg : float
        One-sigma of the walk, an axis and a keyframe [m], [deg].
    seed : int
    """

    def __init__(self, keyframes: KeyframeSet, step: float, step_deg: float, seed: int) -> None:
        rng = np.random.default_rng([7, seed])
        self.keyframes = keyframes
        sigma = np.repeat([np.radians(step_deg), step], 3)
        truth = keyframes.T_world_imu
        T = [truth[0]]
        for before, after in pairwise(truth):
            T.append(T[-1] @ se3.inverse(before) @ after @ se3.exp(sigma * rng.standard_normal(6)))
        self.T = np.array(T)
        self._step = np.diag(sigma**2)

    def as_keyframes(self) -> Iterator[Keyframe]:
        """Yield what a run would keep of the walk: no IMU, and steps with the walk's covariance."""
        for index, cloud in enumerate(self.keyframes.clouds):
            yield Keyframe(
                index=index, stamp_ns=10**9 * (index + 1), T_odom_imu=np.ascontiguousarray(self.T[index]),
                v_odom=np.zeros(3), gyro_bias=np.zeros(3), accel_bias=np.zeros(3), g_odom=np.zeros(3),
                step_covariance=self._step if index else np.zeros((6, 6)), lidar_information=np.zeros((6, 6)),
                points_imu=cloud, intensity=None, imu=ImuBatch.joined([]),
            )  # fmt: skip


def read_keyframes(folder: Path) -> KeyframeSet:
    """Read a folder of keyframes; the files' names are the rows of their poses."""
    files = sorted((folder / "Scans").glob("*.pcd"))
    rows = np.loadtxt(folder / "optimized_poses.txt").reshape(-1, 3, 4)[[int(file.stem) for file in files]]
    T = se3.from_rotation_translation(so3.project(rows[:, :, :3]), rows[:, :, 3])
    return KeyframeSet(
        name=folder.name, clouds=tuple(np.ascontiguousarray(read_cloud(f).points) for f in files), T_world_imu=T
    )


def partners(keyframes: KeyframeSet, apart: int, *, reach: float = 12.0) -> NDArray[np.float32]:
    """Return the two-way overlap of each keyframe with each more than ``apart`` before it, at the true pose, (K, K)."""
    config = loop_align_config(LoopConfig())
    single = [prepare_cloud(cloud, config).native for cloud in keyframes.clouds]
    T, K = keyframes.T_world_imu, len(keyframes)
    out = np.zeros((K, K), dtype=np.float32)
    for i in range(K):
        near = np.linalg.norm(T[: max(0, i - apart), :3, 3] - T[i, :3, 3], axis=1) < reach
        for j in np.flatnonzero(near).tolist():
            T_j_i = np.ascontiguousarray(se3.inverse(T[j]) @ T[i])
            there = single[j].overlap(1, single[i], 1, T_j_i, 0.5, 1)
            back = single[i].overlap(1, single[j], 1, np.ascontiguousarray(se3.inverse(T_j_i)), 0.5, 1)
            out[i, j] = min(there, back)
    return out


def _walk(name: str, world: SimulatedWorld, way: Array, lidar: LidarModel, rng: np.random.Generator) -> KeyframeSet:
    """Look round from each row of ``way`` (K, 4): position and heading; a little tilt comes from the gait."""
    directions = lidar.directions()
    clouds, poses = [], []
    for x, y, z, heading in way:
        R = so3.from_rpy(*rng.normal(0.0, 0.02, 2), heading + rng.normal(0.0, 0.05))
        T = se3.from_rotation_translation(R, [x, y, z])
        exact = world.cast(
            directions, np.tile(T, (lidar.columns, 1, 1)), min_range=lidar.min_range, max_range=lidar.max_range
        )
        ranges = measure_ranges(exact, lidar, rng)
        seen = ranges > 0.0
        clouds.append(_thinned((directions * ranges[..., None])[seen].astype(np.float32)))
        poses.append(T)
    return KeyframeSet(name=name, clouds=tuple(clouds), T_world_imu=np.array(poses))


def _thinned(points: Points, edge: float = 0.2) -> Points:
    """Keep the first point of each cube, as a store of keyframes does."""
    cells = np.floor(points / np.float32(edge)).astype(np.int64) + 2**20
    keys = (cells[:, 0] << 42) | (cells[:, 1] << 21) | cells[:, 2]
    return np.ascontiguousarray(points[np.sort(np.unique(keys, return_index=True)[1])])


def _along(corners: Sequence[tuple[float, float, float]], spacing: float = 1.0) -> Array:
    """Return positions and headings (K, 4) along straight legs; upright legs keep the heading."""
    rows: list[tuple[float, ...]] = []
    heading = 0.0
    for a, b in pairwise(np.array(corners)):
        way = b - a
        heading = float(np.arctan2(way[1], way[0])) if np.hypot(way[0], way[1]) > 0.1 else heading
        count = max(1, round(float(np.linalg.norm(way)) / spacing))
        rows += [(*(a + way * k / count), heading) for k in range(count)]
    return np.array(rows)


def building(seed: int) -> KeyframeSet:
    """Walk two identical storeys of three identical corridors, and then the lower one again, both ways."""
    rng = np.random.default_rng([1, seed])
    a, b, c = (k * STOREYS_PITCH for k in range(3))
    low, high, left, right = 1.2, 1.2 + STOREYS_HEIGHT, -1.2, STOREYS_LENGTH + 1.2
    first = [(left, a), (right, a), (right, b), (left, b), (left, c), (right, c)]
    corners = [(x, y, low) for x, y in first] + [(x, y, high) for x, y in reversed(first)]
    corners += [(left, a, low), (right, a, low), (right, b, low), (left, b, low), (left, a, low), (right, a, low)]
    corners += [(right, c, low), (left, c, low)]
    world = SimulatedWorld(list(storeys_world(rng)))
    return _walk("building", world, _along(corners), LidarModel(beams=32, columns=256, max_range=60.0), rng)


def corridors(seed: int) -> KeyframeSet:
    """Walk a corridor, its twin back, and the first once more: the same way, or the other way for odd seeds."""
    rng = np.random.default_rng([5, seed])
    a, b, low, left, right = 0.0, STOREYS_PITCH, 1.2, -1.2, STOREYS_LENGTH + 1.2
    corners = [(left, a, low), (right, a, low), (right, b, low), (left, b, low)]
    corners += [(right, b, low), (right, a, low), (left, a, low)] if seed % 2 else [(left, a, low), (right, a, low)]
    world = SimulatedWorld(list(storeys_world(rng)))
    return _walk("corridors", world, _along(corners), LidarModel(beams=32, columns=256, max_range=60.0), rng)


def warehouse_laps(seed: int) -> KeyframeSet:
    """Walk two laps of the warehouse with 16 beams, the second 0.5 m beside the first."""
    rng = np.random.default_rng([2, seed])
    place = PLACES["warehouse"](rng)
    lap = place.course.sample(1.0)[0]
    beside = lap + 0.5 * np.column_stack(
        [-np.sin(lap[:, 3]), np.cos(lap[:, 3]), np.zeros(len(lap)), np.zeros(len(lap))]
    )
    return _walk("warehouse", place.world, np.vstack([lap, beside]), LidarModel(beams=16, columns=512), rng)


def street_and_back(seed: int) -> KeyframeSet:
    """Walk a street of 120 m, and back against the first way, 3 m beside it."""
    rng = np.random.default_rng([3, seed])
    place = PLACES["street"](rng)
    out = place.course.sample(1.0)[0]
    out = out[(out[:, 0] > 20.0) & (out[:, 0] < 140.0) & (out[:, 1] < 5.0)]
    back = out[::-1] + np.array([0.0, 3.0, 0.0, np.pi])
    return _walk("street", place.world, np.vstack([out, back]), LidarModel(beams=32, columns=512), rng)


def campus_laps(seed: int) -> KeyframeSet:
    """Walk the figure of eight of the campus, 1.1 km, and again 1 m beside it."""
    rng = np.random.default_rng([6, seed])
    place = PLACES["campus"](rng)
    lap = place.course.sample(1.0)[0]
    beside = lap + np.column_stack([-np.sin(lap[:, 3]), np.cos(lap[:, 3]), np.zeros((len(lap), 2))])
    return _walk("campus", place.world, np.vstack([lap, beside]), LidarModel(beams=32, columns=512), rng)


def facade(seed: int) -> KeyframeSet:
    """Walk along a front with a pillar every 4 m, seen by a narrow view, and never back: there is no loop."""
    rng = np.random.default_rng([4, seed])
    parts = [rectangle((60.0, 0.0, 0.0), (200.0, 60.0), np.eye(3)), box((60.0, 8.2, 4.0), (160.0, 0.4, 8.0))]
    parts += [box((x, 7.7, 3.0), (0.8, 0.8, 6.0)) for x in np.arange(-18.0, 140.0, 4.0)]
    way = np.column_stack(
        [np.arange(0.0, 120.0), np.zeros(120), np.full(120, 1.4), np.pi / 2 + 0.2 * np.sin(np.arange(120))]
    )
    ahead = _walk("facade", SimulatedWorld(parts), way, LidarModel(beams=32, columns=512), rng)
    view = np.radians(34.0)
    clouds = tuple(np.ascontiguousarray(c[np.abs(np.arctan2(c[:, 1], c[:, 0])) < view]) for c in ahead.clouds)
    return KeyframeSet(name="facade", clouds=clouds, T_world_imu=ahead.T_world_imu)


WORLDS = {"building": building, "warehouse": warehouse_laps, "street": street_and_back, "facade": facade}
"""Simulated sets by name: seed -> `KeyframeSet`."""
