"""A session's back-end: however messages and results come in, the same keyframes, loops and bits."""

from dataclasses import replace

import numpy as np
import pytest
from tests.slam_worlds import drifting_walk

from heliograph.config import RunConfig
from heliograph.data import ImuBatch, Scan
from heliograph.odometry.pose_result import pose_result
from heliograph.slam import SlamSession

RATE = 50


@pytest.fixture(scope="module")
def results():
    """Return what an odometry would have said of a walk, scan by scan."""
    made = []
    for keyframe in drifting_walk(laps=1.3).keyframes:
        stamp, count = keyframe.stamp_ns, len(keyframe.points_imu)
        scan = Scan(
            stamp_ns=stamp, header_stamp_ns=stamp, received_ns=stamp, end_ns=stamp, points=keyframe.points_imu,
            offsets_ns=np.zeros(count, np.int32), intensity=None, ring=None, has_point_times=False,
        )  # fmt: skip
        covariance = keyframe.index * np.diag([1e-3**2] * 3 + [0.01**2] * 3)
        before = made[-1] if made else None
        result = pose_result(scan, keyframe.index, keyframe.T_odom_imu, before=before, covariance=covariance)
        made.append(replace(result, lidar_information=1e8 * np.eye(6)))
    return made


def batches(results, size):
    """Return an IMU at rest, in batches of a size."""
    first, last = results[0].end_ns - 10**9, results[-1].end_ns
    stamps = np.arange(first, last + 10**9, 10**9 // RATE)
    gyro = 1e-3 * np.random.default_rng(1).standard_normal((len(stamps), 3))
    accel = gyro + np.array([0.0, 0.0, 9.8])
    for k in range(0, len(stamps), size):
        some = slice(k, k + size)
        yield ImuBatch(stamps_ns=stamps[some], gyro=gyro[some], accel=accel[some], received_ns=int(stamps[some][-1]))


def session(folder, results, *, samples, together, inertial):
    config = RunConfig()
    config = replace(config, loops=replace(config.loops, apart=15))
    run = SlamSession(folder, config)
    waiting = list(results)
    for batch in batches(results, samples):
        if inertial:
            run.observe(batch)
        ready = [result for result in waiting if result.end_ns <= batch.stamps_ns[-1]]
        if len(ready) >= together:
            run.add(ready)
            waiting = waiting[len(ready) :]
    run.finish(waiting)
    run.close()
    return run


@pytest.mark.parametrize("inertial", [False, True])
def test_live_stream_and_file_give_the_same_bits_loops_included(tmp_path, results, inertial):
    """With an IMU that rests while the odometry walks no loop agrees; its samples are what is looked at then."""
    results = results[:30] if inertial else results
    live = session(tmp_path / "live", results, samples=1, together=1, inertial=inertial)
    file = session(tmp_path / "file", results, samples=700, together=5, inertial=inertial)
    assert live.back_end.closed != inertial
    np.testing.assert_array_equal(live.back_end.T_map_imu, file.back_end.T_map_imu)
    for name in ("loops.csv", "graph.g2o"):
        assert (tmp_path / "live" / name).read_bytes() == (tmp_path / "file" / name).read_bytes()
