"""Steps that have left the window: what stays of them holds the poses, in less memory and to the safe side."""

import shutil
from dataclasses import replace

import numpy as np
import pytest

from heliograph.checkpoint import RECORDS
from heliograph.config import RunConfig
from heliograph.data import ImuBatch, Keyframe
from heliograph.lie import se3
from heliograph.slam.back_end import BackEnd
from heliograph.slam.store import KeyframeStore
from heliograph.snapshots import packed, unpacked

COUNT, WINDOW, SECOND = 60, 15, 10**9


def keyframes(count, blind=()):
    """Yield keyframes on a circle at 1 m/s, with an IMU between them; some see nothing along the way."""
    rng = np.random.default_rng(3)
    rate, slack = 0.05, np.repeat([np.radians(0.01), 1e-3], 3)  # each step has slack for slips beside its own
    step = np.diag([1e-4**2] * 3 + [2e-3**2] * 3) + np.diag(slack**2)
    for k in range(count):
        stamps = np.arange((k - 1) * SECOND - SECOND // 50, k * SECOND + SECOND // 50 + 1, SECOND // 50)
        noise = rng.standard_normal((2, len(stamps), 3))
        T = se3.exp(k * np.array([0.0, 0.0, rate, 1.0, 0.0, 0.0]))
        information = np.diag([1e8] * 3 + [1e6] * 3)
        if k in blind:
            information[3] = information[:, 3] = 0.0
        yield Keyframe(
            index=k, stamp_ns=k * SECOND, T_odom_imu=T @ se3.exp(1e-3 * rng.standard_normal(6)), v_odom=T[:3, 0].copy(),
            gyro_bias=np.zeros(3), accel_bias=np.zeros(3), g_odom=np.array([0.0, 0.0, -9.80665]),
            step_covariance=step if k else np.zeros((6, 6)), lidar_information=information,
            points_imu=np.zeros((1, 3), np.float32), intensity=None,
            imu=ImuBatch(
                stamps_ns=stamps, gyro=np.array([0.0, 0.0, rate]) + 1e-3 * noise[0],
                accel=np.array([0.0, rate, 9.80665]) + 1e-2 * noise[1], received_ns=int(stamps[-1]),
            ),
        )  # fmt: skip


def back_end(folder, window, given, keyframes_there=None):
    config = RunConfig()
    config = replace(config, slam=replace(config.slam, loops=False, window=window))
    there = KeyframeStore.create(folder) if keyframes_there is None else KeyframeStore.cut(folder, keyframes_there)
    made = BackEnd(config, there)
    for keyframe in given:
        made.add(keyframe)
    there.close()  # which a later one opens again
    return made


@pytest.mark.parametrize("blind", [(), range(20, 32)])
def test_old_steps_hold_the_poses_in_less_memory_and_to_the_safe_side(tmp_path, blind):
    given = list(keyframes(COUNT, blind))
    whole, short = back_end(tmp_path / "whole", 0, given), back_end(tmp_path / "short", WINDOW, given)
    off = se3.local(whole.T_map_imu, short.T_map_imu)
    for index in (WINDOW, COUNT // 2, COUNT - 1):
        sigmas = [np.sqrt(np.diag(made.covariance(index))) for made in (whole, short)]
        assert (np.abs(off[index]) < 0.8 * sigmas[1]).all()
        assert (sigmas[1] > 0.95 * sigmas[0]).all()  # nothing seems to be known better than it is
        np.testing.assert_allclose(sigmas[1][2], sigmas[0][2], rtol=0.02)  # the heading is the LiDAR's
    graph, values = short.graph()
    assert len(whole.graph()[1]) == 2 * COUNT and len(values) == COUNT + WINDOW + 1 + 2  # up and a bias hold the level
    assert set(values.keys().tolist()) == {key for record in graph for key in record.keys.ravel().tolist()}
    assert np.isfinite(graph.error(values))


def test_window_goes_on_from_its_state_to_the_same_bits(tmp_path):
    given = list(keyframes(40))
    first = back_end(tmp_path / "first", WINDOW, given[:30])
    tree, arrays = packed(first.snapshot(), RECORDS)
    arrays = [array.copy() for array in arrays]
    shutil.copytree(tmp_path / "first", tmp_path / "again")
    again = back_end(tmp_path / "again", WINDOW, (), keyframes_there=30)
    again.restore(unpacked(tree, arrays, RECORDS))
    for made in (first, again):
        for keyframe in given[30:]:
            made.add(keyframe)
        made.store.close()
        made.release()
    np.testing.assert_array_equal(first.T_map_imu, again.T_map_imu)
    assert first.graph()[0].error(first.graph()[1]) == again.graph()[0].error(again.graph()[1])
