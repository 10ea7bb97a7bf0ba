"""Placing each scan again in a map of all of them; the IMU only says how the sensor moved within the scan."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import Array, Points, Stamps, freeze
from heliograph.calibration.plane_map import PlaneMap, turn_against
from heliograph.calibration.states import CalibrationMotion, CalibrationState, LidarPoses
from heliograph.cloud import deskew, range_gate, voxel_downsample
from heliograph.config import ImuConfig, RunConfig
from heliograph.data import ImuBatch, ImuNoise, NavState, Scan
from heliograph.errors import CalibrationError
from heliograph.imu import propagate
from heliograph.lie import interpolate_se3, se3, so3
from heliograph.odometry.filter.motion import corrected_path
from heliograph.registration import MatchSettings

__all__ = ["LidarPath", "Placer", "lidar_path"]


_MAX_STEPS, _ROTATION_TOLERANCE, _POSITION_TOLERANCE = 8, 5e-6, 2e-5
_WEAK_INFORMATION = 1e-3  # information that keeps a direction which no plane holds where it was [1/rad^2], [1/m^2]
_CUBE_SETS, _MIN_MATCHES = 3, 100  # of cubes; matches with one


@dataclass(frozen=True, slots=True, kw_only=True)
class LidarPath:
    """The LiDAR's motion as the last solution has it, at the inertial samples' instants.

    Parameters
    ----------
    stamps_ns : (M,) int64
        In the LiDAR's clock [ns].
    T_odom_lidar : (M, 4, 4) float64
        [m].
    """

    stamps_ns: Stamps
    T_odom_lidar: Array

    def __post_init__(self) -> None:
        freeze(self)

    def around(self, begin_ns: int, middle_ns: int, end_ns: int) -> tuple[Stamps, Array, int]:
        """Return the part that covers an interval, with the middle among its stamps, and the middle's index."""
        first = max(int(np.searchsorted(self.stamps_ns, begin_ns, side="right")) - 1, 0)
        last = int(np.searchsorted(self.stamps_ns, end_ns, side="left")) + 1
        stamps, T = self.stamps_ns[first:last], self.T_odom_lidar[first:last]
        k = int(np.searchsorted(stamps, middle_ns))
        middle = interpolate_se3(stamps, T, np.array([middle_ns]))
        return np.insert(stamps, k, middle_ns), np.concatenate([T[:k], middle, T[k:]]), k


def lidar_path(
    motion: CalibrationMotion, state: CalibrationState, imu: ImuBatch, noise: ImuNoise, config: ImuConfig
) -> LidarPath:
    """Fill in the motion between the states of a solution with the inertial samples."""
    stamps: list[Stamps] = []
    poses: list[Array] = []
    for k in range(len(motion) - 1):
        begin, end = _state(motion, k, state), _state(motion, k + 1, state)
        first = max(int(np.searchsorted(imu.stamps_ns, begin.stamp_ns, side="right")) - 1, 0)
        last = int(np.searchsorted(imu.stamps_ns, end.stamp_ns, side="left")) + 1
        part = replace(imu, stamps_ns=imu.stamps_ns[first:last], gyro=imu.gyro[first:last], accel=imu.accel[first:last])
        _, path = propagate(begin, part, end.stamp_ns, noise=noise, config=config)
        path = corrected_path(path, end)
        stamps.append(path.stamps_ns[:-1])
        poses.append(se3.from_rotation_translation(path.R_odom_imu[:-1], path.p_odom[:-1]))
    return LidarPath(
        stamps_ns=state.clock.lidar_time(np.concatenate(stamps)),
        T_odom_lidar=np.concatenate(poses) @ state.T_imu_lidar,
    )


def _state(motion: CalibrationMotion, k: int, state: CalibrationState) -> NavState:
    X, bias = motion.X_odom_imu[k], motion.bias[k]
    return NavState(
        stamp_ns=int(motion.stamps_ns[k]),
        R_odom_imu=X[:3, :3].copy(),
        p_odom=X[:3, 3].copy(),
        v_odom=X[:3, 4].copy(),
        gyro_bias=bias[:3].copy(),
        accel_bias=bias[3:].copy(),
        g_odom=state.g_odom,
        T_imu_lidar=state.T_imu_lidar,
        covariance=np.zeros((17, 17)),
    )


@dataclass(frozen=True, slots=True)
class _Swept:
    """A scan de-skewed to the mean time of its points, where an error of the motion within it cancels best."""

    points: Points
    middle_ns: int
    T_odom_lidar: Array

    def __post_init__(self) -> None:
        freeze(self)


class Placer:
    """Places scans against the map of all of them.

    The points to match with are picked the first time and kept, and which of them lie on planes of both sizes from the
    second time on, where the map is no longer the odometry's own; so rounds differ only by what was learnt.

    Parameters
    ----------
    scans : sequence of Scan
    config : RunConfig
    threads : int
    """

    def __init__(self, scans: Sequence[Scan], config: RunConfig, *, threads: int = 1) -> None:
        self._scans = [_in_range(scan, config) for scan in scans]
        self._config, self._threads = config, threads
        self._leaf = 0.2
        self._picks: dict[int, NDArray[np.int32]] = {}
        self._masks: dict[int, tuple[NDArray[np.bool_], ...]] = {}
        self._placed = False
        self._R_cubes_odom: Array | None = None

    def place(self, path: LidarPath) -> LidarPoses:
        """Return the poses of the scans that lie inside the path, at the mean times of their points.

        Raises
        ------
        CalibrationError
            Too few of them match the map.
        """
        inside = [k for k, scan in enumerate(self._scans) if _covers(path, scan)]
        swept = [self._deskew(self._scans[k], path) for k in inside]
        swept, local_map = self._build_map(swept)
        found = [
            self._register(scan, self._chosen(k, scan, local_map), local_map)
            for k, scan in zip(inside, swept, strict=True)
        ]
        self._placed = True
        good = [(scan, *fit) for scan, fit in zip(swept, found, strict=True) if fit is not None]
        if len(good) < 3 or 2 * len(good) < len(swept):
            raise CalibrationError(
                f"only {len(good)} of {len(swept)} scans match the map that all of them make: the surroundings hold "
                "too few planes, or most of them move; record before walls and floors"
            )
        return LidarPoses(
            stamps_ns=np.array([scan.middle_ns for scan, _, _ in good], dtype=np.int64),
            T_odom_lidar=np.stack([T for _, T, _ in good]),
            covariance=np.stack([covariance for _, _, covariance in good]),
        )

    def _build_map(self, swept: Sequence[_Swept]) -> tuple[list[_Swept], PlaneMap]:
        """Return the scans with their noise across the surfaces, and the map of them.

        Its cubes are turned against the walls that the first one finds.
        """
        if self._R_cubes_odom is None:
            self._R_cubes_odom = turn_against(*self._insert_all(swept, np.eye(3)[None]).normals(), _CUBE_SETS)
        rough = self._insert_all(swept, self._R_cubes_odom[:1])
        gate = self._config.calibration.plane_gate
        swept = [replace(scan, points=rough.across_planes(scan.points, scan.T_odom_lidar, gate)) for scan in swept]
        return swept, self._insert_all(swept, self._R_cubes_odom)

    def _insert_all(self, swept: Sequence[_Swept], R_cubes_odom: Array) -> PlaneMap:
        local_map = PlaneMap(self._config.map, R_cubes_odom)
        for scan in swept:
            local_map.insert(scan.points, scan.T_odom_lidar)
        return local_map

    def _deskew(self, scan: Scan, path: LidarPath) -> _Swept:
        middle_ns = scan.stamp_ns + int(np.rint(scan.offsets_ns.mean()))
        stamps, T, k = path.around(scan.stamp_ns, middle_ns, scan.end_ns)
        points = deskew(
            scan.points,
            scan.offsets_ns,
            stamp_ns=scan.stamp_ns,
            path_stamps_ns=stamps,
            R_odom_body=np.ascontiguousarray(T[:, :3, :3]),
            p_odom=np.ascontiguousarray(T[:, :3, 3]),
            T_body_lidar=np.eye(4),
            reference=k,
            threads=self._threads,
        )
        return _Swept(points, middle_ns, T[k])

    def _pick(self, k: int, scan: _Swept) -> Points:
        """Return about as many points of a scan as are wanted, spread evenly."""
        if k not in self._picks:
            wanted = self._config.calibration.matches
            for _ in range(4):
                picked = voxel_downsample(scan.points, self._leaf)
                ratio = len(picked) / wanted
                if 0.8 < ratio < 1.25:
                    break
                self._leaf = float(np.clip(self._leaf * np.clip(np.sqrt(ratio), 0.5, 2.0), 0.02, 2.0))
            self._picks[k] = picked
        return np.ascontiguousarray(scan.points[self._picks[k]])

    def _chosen(self, k: int, scan: _Swept, local_map: PlaneMap) -> list[Points]:
        """Return the points to place a scan with for each set of cubes, the same ones from the second time on."""
        points = self._pick(k, scan)
        masks = self._masks.get(k) or local_map.agreeing_points(
            points, scan.T_odom_lidar, self._config.calibration.plane_gate
        )
        if self._placed:
            self._masks[k] = masks
        return [np.ascontiguousarray(points[mask]) for mask in masks]

    def _register(self, scan: _Swept, chosen: Sequence[Points], local_map: PlaneMap) -> tuple[Array, Array] | None:
        """Return the pose and its covariance (right perturbation) by the planes alone, or None without enough."""
        planes = self._config.calibration
        settings = MatchSettings(  # the size of the noise is found from the poses afterwards
            gate=planes.plane_gate,
            kernel=planes.plane_kernel,
            sigma=planes.plane_sigma,
            fallback_stride=0,
            threads=self._threads,
        )
        T = scan.T_odom_lidar
        for _ in range(_MAX_STEPS):
            information, gradient, matches = local_map.linearize(chosen, T, settings)
            if matches < _MIN_MATCHES:
                return None
            information += _WEAK_INFORMATION * np.eye(6)
            step = -np.linalg.solve(information, gradient)
            T = se3.from_rotation_translation(T[:3, :3] @ so3.exp(step[:3]), T[:3, 3] + T[:3, :3] @ step[3:])
            if np.linalg.norm(step[:3]) < _ROTATION_TOLERANCE and np.linalg.norm(step[3:]) < _POSITION_TOLERANCE:
                break
        scatter = local_map.scatter(chosen, T, settings) + _WEAK_INFORMATION * np.eye(6)
        inverse = np.linalg.inv(information)
        return T, np.asarray(inverse @ scatter @ inverse, dtype=np.float64)


def _covers(path: LidarPath, scan: Scan) -> bool:
    return bool(len(scan) > 0 and scan.stamp_ns >= int(path.stamps_ns[0]) and scan.end_ns <= int(path.stamps_ns[-1]))


def _in_range(scan: Scan, config: RunConfig) -> Scan:
    keep = range_gate(scan.points, config.cloud.min_range, config.cloud.max_range)
    return replace(
        scan,
        points=np.ascontiguousarray(scan.points.take(keep, axis=0)),
        offsets_ns=np.ascontiguousarray(scan.offsets_ns.take(keep)),
    )
