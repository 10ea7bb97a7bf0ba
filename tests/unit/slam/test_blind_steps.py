"""Keyframes with an IMU: along what the LiDAR does not see the IMU carries the graph, elsewhere it does not bend it."""

from dataclasses import replace

import numpy as np
import pytest

from heliograph.config import RunConfig
from heliograph.data import ImuBatch, Keyframe
from heliograph.lie import se3
from heliograph.slam import BackEnd, KeyframeStore

G = 9.80665
STEP_S, RATE = 1.0, 200


def moving(t):
    """Return position, velocity and acceleration along x, and along z, of a body that never turns."""
    p = np.stack([t + 0.5 * np.sin(0.8 * t), np.zeros_like(t), 0.2 * np.sin(0.5 * t)], axis=-1)
    v = np.stack([1.0 + 0.4 * np.cos(0.8 * t), np.zeros_like(t), 0.1 * np.cos(0.5 * t)], axis=-1)
    a = np.stack([-0.32 * np.sin(0.8 * t), np.zeros_like(t), -0.05 * np.sin(0.5 * t)], axis=-1)
    return p, v, a


def keyframes(count, *, blind=(), off=0.0, tilt=0.0, seed=0):
    """Return keyframes; between the blind ones the odometry's step along x is off by ``off`` [m] each."""
    rng = np.random.default_rng(seed)
    slip, made = 0.0, []
    T_odom_world = se3.exp(np.array([0.0, tilt, 0.0, 0.0, 0.0, 0.0]))
    for index in range(count):
        t1 = STEP_S * index
        p, v, _ = moving(np.array(t1))
        slip += off if index in blind else 0.0
        T = se3.from_rotation_translation(np.eye(3), p + np.array([slip, 0.0, 0.0]))
        stamps = np.arange(-1, round(STEP_S * RATE) + 1) / RATE + t1 - STEP_S
        accel = moving(stamps)[2] + np.array([0.0, 0.0, G]) + 0.01 * rng.standard_normal((len(stamps), 3))
        imu = ImuBatch(
            stamps_ns=np.round(1e9 * (stamps + 100.0)).astype(np.int64),
            gyro=1e-3 * rng.standard_normal((len(stamps), 3)),
            accel=accel,
            received_ns=0,
        )
        information = np.diag([1e8] * 3 + [1e7] * 3)
        if index in blind:
            information[3, 3] = 0.0
        made.append(
            Keyframe(
                index=index, stamp_ns=round(1e9 * (t1 + 100.0)), T_odom_imu=T_odom_world @ T,
                v_odom=T_odom_world[:3, :3] @ v, gyro_bias=np.zeros(3), accel_bias=np.zeros(3),
                g_odom=T_odom_world[:3, :3] @ [0.0, 0.0, -G],
                step_covariance=np.diag([1e-4**2] * 3 + [1e-3**2] * 3) * (index > 0),
                lidar_information=information, points_imu=np.zeros((1, 3), np.float32), intensity=None, imu=imu,
            )
        )  # fmt: skip
    return made


def graph_of(frames, path):
    store = KeyframeStore.create(path)
    back_end = BackEnd(RunConfig(), store)
    for keyframe in frames:
        back_end.add(keyframe)
    store.close()
    return back_end


def truth(count):
    return moving(STEP_S * np.arange(count))[0]


def test_imu_does_not_bend_what_the_lidar_saw(tmp_path):
    back_end = graph_of(keyframes(20), tmp_path)
    np.testing.assert_allclose(back_end.T_map_imu[:, :3, 3], truth(20), atol=0.01)


@pytest.mark.parametrize("off", [0.2, -0.4])
def test_imu_carries_the_blind_direction(tmp_path, off):
    blind = range(8, 13)
    frames = keyframes(20, blind=blind, off=off)
    slipped = frames[12].T_odom_imu[0, 3] - truth(20)[12, 0]
    back_end = graph_of(frames, tmp_path)
    error = back_end.T_map_imu[12, 0, 3] - truth(20)[12, 0]
    assert abs(slipped) > 0.9
    assert abs(error) < 0.25 * abs(slipped)
    sigma = np.sqrt(back_end.covariance(12)[3, 3])
    assert abs(error) < 3.0 * sigma
    assert sigma > 0.02 > np.sqrt(back_end.covariance(12)[4, 4])  # and it says that it does not know x as it knows y


def test_graph_puts_the_map_level(tmp_path):
    tilt = np.radians(0.5)
    back_end = graph_of(keyframes(25, tilt=tilt), tmp_path)
    up = back_end.T_map_imu[-1, :3, 2]
    assert np.degrees(np.arccos(np.clip(up[2], -1.0, 1.0))) < 0.2


def test_gap_of_the_imu_leaves_a_graph(tmp_path):
    frames = keyframes(12)
    empty = {name: getattr(frames[6], name) for name in Keyframe.__slots__} | {"imu": ImuBatch.joined([])}
    frames[6] = Keyframe(**empty)
    back_end = graph_of(frames, tmp_path)
    np.testing.assert_allclose(back_end.T_map_imu[:, :3, 3], truth(12), atol=0.02)


def test_errors_of_scans_do_not_add_up(tmp_path):
    """Each pose is off by its own scan's noise: the sigmas say that, far along the way as at its beginning."""
    sigma, slack = np.repeat([1e-4, 1e-3], 3), np.repeat([np.radians(0.01), 1e-3], 3)
    rng, count, nees, spread = np.random.default_rng(4), 80, [], []
    frames = []
    for frame in keyframes(count):
        off = sigma * rng.standard_normal(6)
        frames.append(replace(
            frame, T_odom_imu=frame.T_odom_imu @ se3.exp(off), lidar_information=np.diag(sigma**-2) * (frame.index > 0),
            step_covariance=np.diag(slack**2) * (frame.index > 0),
        ))  # fmt: skip
    back_end = graph_of(frames, tmp_path)
    p = truth(count)
    for index in range(10, count, 10):
        T_true = se3.from_rotation_translation(np.eye(3), p[index])
        d, P = se3.local(back_end.T_map_imu[index], T_true)[3:5], back_end.covariance(index)[3:5, 3:5]
        nees.append(d @ np.linalg.solve(P, d))
        spread.append(np.sqrt(np.diag(P)).max())
    assert 0.1 < np.mean(nees) < 6.0  # two expected, of errors that hang together; 0.02 where they add up
    assert max(spread) < 0.02  # and 0.08
