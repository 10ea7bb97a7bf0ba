"""A session's back-end: however messages and results come in, the same keyframes, loops and bits."""

import shutil
from dataclasses import replace

import numpy as np
import pytest
from tests.slam_worlds import drifting_walk

from heliograph.checkpoint import RECORDS
from heliograph.config import RunConfig
from heliograph.data import ImuBatch, Scan
from heliograph.odometry.pose_result import pose_result
from heliograph.slam import SlamSession
from heliograph.snapshots import packed, unpacked

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


def test_session_goes_on_from_its_state_to_the_same_bits_also_within_a_search(tmp_path, results):
    config = RunConfig()
    config = replace(config, slam=replace(config.slam, loop_pieces=2), loops=replace(config.loops, apart=15))
    first, kept = SlamSession(tmp_path / "first", config), {}
    for number, result in enumerate(results):
        first.add([result])
        within_a_search = first.back_end._query is not None
        if number > 20 and len(kept) < 2 and (within_a_search or number > 40) and number % 4 == 1:
            kept[number] = *packed(first.snapshot(), RECORDS), within_a_search
            shutil.copytree(tmp_path / "first", tmp_path / f"at {number}")
    assert any(searching for *_, searching in kept.values()) and first.back_end.closed
    first.finish([])
    first.close()
    for number, (tree, arrays, _) in kept.items():
        state = unpacked(tree, arrays, RECORDS)
        again = SlamSession(tmp_path / f"at {number}", config, keyframes=state["keyframes"])
        again.restore(state)
        for result in results[number + 1 :]:
            again.add([result])
        again.finish([])
        again.close()
        np.testing.assert_array_equal(again.back_end.T_map_imu, first.back_end.T_map_imu)
        assert again.events == first.events
        for name in ("loops.csv", "graph.g2o", "keyframes/journal.jsonl", "keyframes/descriptors.bin"):
            there = tmp_path / f"at {number}" / name
            assert not there.exists() or there.read_bytes() == (tmp_path / "first" / name).read_bytes(), name
        whole, taken = (np.load(tmp_path / run / "graph.npz") for run in ("first", f"at {number}"))
        assert whole.files == taken.files and all(np.array_equal(whole[n], taken[n]) for n in whole.files)
