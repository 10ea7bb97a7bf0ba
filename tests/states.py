"""Navigation states, inertial samples and clouds of planes that the tests of the estimation rooms share."""

import numpy as np

from heliograph.data import ImuBatch, ImuNoise, NavState
from heliograph.lie import se3, so3

NOISE = ImuNoise(gyro=2e-3, accel=2e-2, gyro_walk=1e-4, accel_walk=1e-3)
GRAVITY = 9.80665
START_NS = 1_700_000_000_000_000_000


def random_rotation(rng, angle=None):
    axis = rng.normal(size=3)
    return so3.exp((rng.uniform(0.5, 2.8) if angle is None else angle) * axis / np.linalg.norm(axis))


def random_pose(rng, reach=10.0):
    return se3.from_rotation_translation(random_rotation(rng), rng.uniform(-reach, reach, 3))


def random_covariance(rng, dim, scale=0.05):
    root = scale * rng.normal(size=(dim, dim))
    return root @ root.T + 1e-6 * np.eye(dim)


def random_state(rng, *, dim=17, stamp_ns=START_NS):
    """A state far from identity in every part, gravity 20 degrees off the vertical."""
    down = so3.exp(np.array([0.25, -0.25, 0.0])) @ np.array([0.0, 0.0, -GRAVITY])
    return NavState(
        stamp_ns=stamp_ns,
        R_odom_imu=random_rotation(rng),
        p_odom=rng.normal(scale=20.0, size=3),
        v_odom=rng.normal(scale=3.0, size=3),
        gyro_bias=rng.normal(scale=0.05, size=3),
        accel_bias=rng.normal(scale=0.2, size=3),
        g_odom=down,
        T_imu_lidar=random_pose(rng, 0.3),
        covariance=random_covariance(rng, dim),
        **({"imu_offset": 0.013, "imu_drift": -4e-4} if dim > 23 else {}),
    )


def rest_state(*, stamp_ns=START_NS, dim=17):
    return NavState(
        stamp_ns=stamp_ns,
        R_odom_imu=np.eye(3),
        p_odom=np.zeros(3),
        v_odom=np.zeros(3),
        gyro_bias=np.zeros(3),
        accel_bias=np.zeros(3),
        g_odom=np.array([0.0, 0.0, -GRAVITY]),
        T_imu_lidar=np.eye(4),
        covariance=np.zeros((dim, dim)),
    )


def random_imu(rng, *, duration=0.3, rate=100.0, before=0.02, jitter=0.2, start_ns=START_NS):
    """Smooth large signals sampled with jitter, from ``before`` the start to ``duration`` past it."""
    count = int((duration + before) * rate) + 2
    steps = (1.0 + jitter * rng.uniform(-1.0, 1.0, count)) / rate
    stamps = start_ns + ((np.cumsum(steps) - before) * 1e9).astype(np.int64)
    t = (stamps - start_ns)[:, None] * 1e-9
    w, phase = rng.uniform(3.0, 12.0, (2, 3)), rng.uniform(0.0, 6.0, (2, 3))
    gyro = 1.5 * np.sin(w[0] * t + phase[0])
    accel = np.array([0.0, 0.0, GRAVITY]) + 4.0 * np.sin(w[1] * t + phase[1])
    return ImuBatch(stamps_ns=stamps, gyro=gyro, accel=accel, received_ns=int(stamps[-1]))


def resting(seconds, rate=20.0):
    """Samples of an IMU at rest from a period before the start on."""
    stamps = START_NS + (np.arange(-1.0, rate * seconds + 2.0) * 1e9 / rate).astype(np.int64)
    still = np.zeros((len(stamps), 3))
    force = still + np.array([0.0, 0.0, GRAVITY])
    return ImuBatch(stamps_ns=stamps, gyro=still, accel=force, received_ns=0)


def wall(rng, normal, distance, count, *, half=4.0, sigma=0.01):
    """Points of a square of a plane, with noise across it, (count, 3) float32."""
    n = np.asarray(normal, dtype=np.float64) / np.linalg.norm(normal)
    u = np.cross(n, [0.31, 0.47, 0.83])
    u /= np.linalg.norm(u)
    a, b = rng.uniform(-half, half, (2, count))
    across = distance + sigma * rng.normal(size=count)
    return (a[:, None] * u + b[:, None] * np.cross(n, u) + across[:, None] * n).astype(np.float32)


def room_cloud(rng, count=4000, *, half=4.0, sigma=0.01):
    """Six walls around the origin, none aligned with an axis."""
    normals = random_rotation(np.random.default_rng(5))
    walls = [wall(rng, s * n, 0.8 * half, count // 6, half=half, sigma=sigma) for n in normals for s in (1.0, -1.0)]
    return np.ascontiguousarray(rng.permutation(np.concatenate(walls)))
