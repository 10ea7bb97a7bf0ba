"""Levels by long windows: what the factors of a walk say, and what the graph makes of poses that drift."""

from dataclasses import replace
from itertools import pairwise

import numpy as np

from heliograph.config import RunConfig
from heliograph.data import ImuBatch, Keyframe
from heliograph.lie import se3, so3
from heliograph.slam import BackEnd, KeyframeStore
from heliograph.slam.levelling import Levelling

NS, RATE, G = 10**9, 100, 9.80665
BIAS = np.array([0.04, -0.03, 0.05])


class Walk:
    """A winding walk of a keyframe a second: true poses, and the samples of an IMU with biases and noise."""

    def __init__(self, seconds, rng):
        dt = 1.0 / RATE
        t = np.arange(-3 * RATE, (seconds + 3) * RATE) * dt
        yaw = 1.5 * np.sin(2 * np.pi * t / 40.0)
        roll, pitch = 0.05 * np.sin(2 * np.pi * 0.9 * t), 0.04 * np.sin(2 * np.pi * 1.3 * t)
        heading = np.cumsum(np.column_stack([np.cos(yaw), np.sin(yaw), np.zeros(len(t))]), axis=0) * dt
        p = heading + np.column_stack([0 * t, 0 * t, 0.05 * np.sin(2 * np.pi * 1.8 * t) + np.sin(2 * np.pi * t / 60.0)])
        R = so3.exp(yaw[:, None] * [0.0, 0.0, 1.0]) @ so3.exp(np.column_stack([roll, pitch, 0 * t]))
        gyro = so3.log(np.swapaxes(R[:-2], 1, 2) @ R[2:]) / (2 * dt)
        a = (p[2:] - 2 * p[1:-1] + p[:-2]) / dt**2
        force = np.einsum("nji,nj->ni", R[1:-1], a + np.array([0.0, 0.0, G]))
        noise = rng.standard_normal((2, *gyro.shape))
        self.stamps = np.round(t[1:-1] * NS).astype(np.int64)
        self.gyro, self.accel = gyro + 0.002 + 1e-3 * noise[0], force + BIAS + 1e-2 * noise[1]
        at = np.searchsorted(t, np.arange(seconds) - 1e-9)
        self.T = se3.from_rotation_translation(R[at], p[at])

    def keyframes(self, T_odom, sigma):
        for k, T in enumerate(T_odom):
            last = (k - 1) * NS if k else 0
            near = slice(*np.searchsorted(self.stamps, [last - NS // RATE, k * NS + NS // RATE + 1]))
            imu = ImuBatch(
                stamps_ns=self.stamps[near], gyro=self.gyro[near], accel=self.accel[near], received_ns=k * NS
            )
            yield Keyframe(
                index=k, stamp_ns=k * NS, T_odom_imu=np.ascontiguousarray(T), v_odom=np.zeros(3),
                gyro_bias=np.zeros(3), accel_bias=np.zeros(3), g_odom=np.zeros(3),
                step_covariance=np.diag(sigma**2) if k else np.zeros((6, 6)), lidar_information=np.zeros((6, 6)),
                points_imu=np.zeros((1, 3), np.float32), intensity=None, imu=imu,
            )  # fmt: skip


def drifting(T_true, sigma, rng, frame):
    T = [frame @ T_true[0]]
    for before, after in pairwise(T_true):
        T.append(T[-1] @ se3.inverse(before) @ after @ se3.exp(sigma * rng.standard_normal(6)))
    return np.stack(T)


SIGMA = np.repeat([np.radians(0.3), 0.03], 3)
FRAME = se3.exp(np.array([1.2, -0.3, 0.4, 5.0, 2.0, -1.0]))  # the other system's frame: no axis of it is up


def settings(window):
    config = RunConfig()
    return replace(config, slam=replace(config.slam, loops=False, level_window=window))


def test_a_window_tells_up_with_its_sigma(rng):
    walk, errors = Walk(300, rng), []
    odometry = drifting(walk.T, SIGMA, rng, np.eye(4))
    levels = Levelling(settings(20.0).slam, settings(20.0).imu, up_known=True)
    before = None
    for keyframe in walk.keyframes(odometry, SIGMA):
        if before is not None:
            levels.add(before, keyframe)
        before = keyframe
    assert len(levels._keys.all) == 14
    for (index, _), z, M, S in zip(
        levels._keys.all, levels._forces.all, levels._turnings.all, levels._covariances.all, strict=True
    ):
        off = z - M @ BIAS - walk.T[index, :3, :3].T @ [0.0, 0.0, G]
        errors.append(off @ np.linalg.solve(S, off))
        assert np.linalg.norm(off) < 0.3
    assert 1.0 < np.mean(errors) < 5.5  # 3 where the sigmas are true


def test_a_long_walk_stays_level_where_poses_alone_do_not(rng, tmp_path):
    walk, off = Walk(250, rng), {}
    odometry = drifting(walk.T, SIGMA, rng, FRAME)
    for window in (0.0, 20.0):
        with_store = KeyframeStore.create(tmp_path / f"{window}")
        back_end = BackEnd(settings(window), with_store)
        for keyframe in walk.keyframes(odometry, SIGMA):
            back_end.add(keyframe)
        T = se3.inverse(FRAME) @ back_end.T_map_imu
        up = np.einsum("nij,nkj->nik", T[:, :3, :3], walk.T[:, :3, :3])[:, 2, 2]
        tilt = np.degrees(np.arccos(np.clip(up, -1.0, 1.0)))
        z = T[:, 2, 3] - walk.T[:, 2, 3]
        off[window] = (np.sqrt(np.mean(tilt**2)), np.sqrt(np.mean(z**2)))
        graph, values = back_end.graph()
        assert 2.0 * graph.error(values) < 6.0 * len(T)
        with_store.close()
        back_end.release()
    assert off[20.0][0] < 0.5 * off[0.0][0] and off[20.0][0] < 1.5
    assert off[20.0][1] < 0.6 * off[0.0][1]


def test_levelling_goes_on_to_the_bit(rng):
    walk = Walk(50, rng)
    keyframes = list(walk.keyframes(walk.T, SIGMA))

    def make():
        return Levelling(settings(10.0).slam, settings(10.0).imu, up_known=False)

    whole, first = make(), make()
    for k in range(1, 50):
        whole.add(keyframes[k - 1], keyframes[k])
        if k <= 27:
            first.add(keyframes[k - 1], keyframes[k])
    again = make()
    again.restore(first.snapshot())
    for k in range(28, 50):
        again.add(keyframes[k - 1], keyframes[k])
    for name in ("_keys", "_forces", "_turnings", "_covariances", "_ups"):
        np.testing.assert_array_equal(getattr(again, name).all, getattr(whole, name).all)
