"""Stand-ins that tests of the outer rooms share: results, a recording, an odometry."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from heliograph.data import Event, GnssFix, ImuBatch, Rig, Scan, ScanResult, Trajectory

PERIOD_NS = 100_000_000
START_NS = 1_700_000_000_000_000_000
IMU_STEP_NS = 10_000_000


def pose(x: float, y: float = 0.0, z: float = 0.0) -> np.ndarray:
    T = np.eye(4)
    T[:3, 3] = x, y, z
    return T


def make_result(index: int, *, status: str = "tracked", points: int = 50, events: tuple[Event, ...] = (), **changes):
    """One scan's result on a straight drive along x at 1 m/s."""
    stamp = START_NS + index * PERIOD_NS
    stamps = np.arange(stamp, stamp + PERIOD_NS + 1, IMU_STEP_NS)
    poses = np.tile(np.eye(4), (len(stamps), 1, 1))
    poses[:, 0, 3] = (stamps - START_NS) * 1e-9
    cloud = np.random.default_rng(index).uniform(-5, 5, (points, 3)).astype(np.float32)
    values = {
        "index": index,
        "stamp_ns": stamp,
        "header_stamp_ns": stamp,
        "end_ns": stamp + PERIOD_NS,
        "T_odom_imu": pose(0.1 * (index + 1)),
        "v_odom": np.array([1.0, 0.0, 0.0]),
        "gyro_bias": np.array([1e-3, 2e-3, 3e-3]),
        "accel_bias": np.array([1e-2, 2e-2, 3e-2]),
        "g_odom": np.array([0.0, 0.0, -9.80665]),
        "T_imu_lidar": np.eye(4),
        "pose_covariance": np.diag(np.arange(1.0, 7.0) ** 2) * 1e-6,
        "covariance": np.diag(np.arange(1.0, 19.0) ** 2) * 1e-6,
        "path": Trajectory(stamps_ns=stamps, T_frame_body=poses),
        "T_odom_imu_header": pose(0.1 * index),
        "points_imu": cloud,
        "intensity": np.full(points, 7.0, dtype=np.float32),
        "status": status,
        "matches": 40,
        "queries": 50,
        "iterations": 3,
        "rms": 0.01,
        "eigenvalues_rotation": np.array([0.1, 0.2, 0.3]),
        "eigenvalues_translation": np.array([0.2, 0.3, 0.5]),
        "weak_direction": np.array([1.0, 0.0, 0.0]),
        "timings": {"match": 2.0, "update": 1.0},
        "events": events,
    }
    return ScanResult(**(values | changes))


def make_scan(index: int) -> Scan:
    stamp = START_NS + index * PERIOD_NS
    return Scan(
        stamp_ns=stamp,
        header_stamp_ns=stamp,
        received_ns=stamp + PERIOD_NS,
        end_ns=stamp + PERIOD_NS,
        points=np.ones((4, 3), dtype=np.float32),
        offsets_ns=np.zeros(4, dtype=np.int32),
    )


def make_batch(index: int) -> ImuBatch:
    stamp = START_NS + index * PERIOD_NS
    stamps = np.arange(stamp, stamp + PERIOD_NS, IMU_STEP_NS)
    return ImuBatch(
        stamps_ns=stamps, gyro=np.zeros((len(stamps), 3)), accel=np.zeros((len(stamps), 3)), received_ns=int(stamps[-1])
    )


class FakeRecording:
    """A recording of ``scans`` scans with IMU batches between them."""

    repeatable = True

    def __init__(self, scans: int, *, sensors: frozenset[str] = frozenset({"lidar", "imu"})) -> None:
        self.scans, self.sensors = scans, sensors
        self.rig = Rig(T_imu_lidar=np.eye(4), source="test")
        self.events: list[Event] = []
        self.closed = False

    def stream(self) -> Iterator[Scan | ImuBatch | GnssFix]:
        try:
            for index in range(self.scans):
                if "imu" in self.sensors:
                    yield make_batch(index)
                if "lidar" in self.sensors:
                    yield make_scan(index)
        finally:
            self.closed = True

    def close(self) -> None:
        self.closed = True


class FakeOdometry:
    """Gives one result a scan, one scan late, as a causal filter does; the last comes from `finish`."""

    start = None

    def __init__(
        self, *, T_leveled_odom: np.ndarray | None = None, fail_at: int = -1, error: BaseException | None = None
    ):
        self.events: list[Event] = []
        self.seen: list[object] = []
        self._T = np.eye(4) if T_leveled_odom is None else T_leveled_odom
        self._waiting: list[int] = []
        self._count = 0
        self._fail_at, self._error = fail_at, error

    def add(self, message: Scan | ImuBatch | GnssFix) -> list[ScanResult]:
        self.seen.append(message)
        if not isinstance(message, Scan):
            return []
        if self._count == self._fail_at and self._error is not None:
            raise self._error
        ready = [make_result(i, status="first" if i == 0 else "tracked") for i in self._waiting]
        self._waiting = [self._count]
        self._count += 1
        return ready

    def finish(self) -> list[ScanResult]:
        return [make_result(i) for i in self._waiting]

    def leveling(self) -> np.ndarray:
        return self._T
