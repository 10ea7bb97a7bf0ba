"""A walk in the aisles: its first lap makes a map, and on the second somebody wakes up."""

from functools import cache

import numpy as np
from tests.slam_worlds import drifting_walk

from heliograph.data import Scan
from heliograph.lie import se3, so3
from heliograph.localization import map_of_keyframes, map_of_points
from heliograph.maps import transformed
from heliograph.odometry.pose_result import pose_result

SECONDS = 0.8
LAP = 2 / 3  # of the walk


@cache
def walk():
    return drifting_walk(laps=1.5, spacing=1.0)


def mapped():
    """Return clouds and poses of the first lap, by the truth."""
    some = walk()
    lap = int(LAP * len(some.keyframes))
    return [keyframe.points_imu for keyframe in some.keyframes[:lap]], some.T_true[:lap]


@cache
def saved_map():
    return map_of_keyframes(*mapped())


@cache
def bare_map():
    clouds, T = mapped()
    points = np.concatenate([transformed(cloud, pose) for cloud, pose in zip(clouds, T, strict=True)])
    return map_of_points(np.ascontiguousarray(points, dtype=np.float32))


@cache
def twin_map():
    """Return a map that holds everything twice, 200 m apart."""
    clouds, T = mapped()
    away = T.copy()
    away[:, 0, 3] += 200.0
    return map_of_keyframes(clouds * 2, np.concatenate([T, away]))


def woken(first, count, *, seed=0, clouds=None):
    """Return the results of an odometry that begins at a keyframe of the second lap, and the true poses."""
    some = walk()
    rng = np.random.default_rng([seed, first])
    T_odom = se3.from_rotation_translation(so3.from_rpy(0.0, 0.0, rng.uniform(-3.0, 3.0)), rng.normal(size=3))
    results = []
    for k in range(first, first + count):
        if k > first:
            T_odom = T_odom @ se3.inverse(some.T_true[k - 1]) @ some.T_true[k]
        points = some.keyframes[k].points_imu if clouds is None else clouds[k - first]
        stamp = round(1e9 * SECONDS * (k + 1))
        scan = Scan(
            stamp_ns=stamp, end_ns=stamp, received_ns=stamp, header_stamp_ns=stamp, points=points,
            offsets_ns=np.zeros(len(points), np.int32),
        )  # fmt: skip
        before = results[-1] if results else None
        results.append(pose_result(scan, k - first, np.ascontiguousarray(T_odom), before=before))
    return results, some.T_true[first : first + count]


def off(T, T_true):
    return float(np.linalg.norm(T[:3, 3] - T_true[:3, 3]))
