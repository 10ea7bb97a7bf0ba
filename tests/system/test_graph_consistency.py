"""The graph's covariance is true: NEES of keyframe poses over seeds lies in its band, before and after loops."""

from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2
from tests.unit.slam.slam_loops import loop

from heliograph.config import RunConfig
from heliograph.data import ImuBatch, Keyframe
from heliograph.lie import se3, so3
from heliograph.slam import BackEnd, KeyframeStore

COUNT, RADIUS, TURN = 60, 5.0, 0.2  # two laps at a metre a second [m], [rad/s]
STEP = np.repeat([np.radians(0.1), 0.01], 3)  # one-sigma of the odometry's step
LOOP = np.repeat([np.radians(0.1), 0.01], 3)  # and of a loop
AT = (20, 45, COUNT - 1)
RATE = 100
G = RunConfig().imu.gravity


def true_pose(t):
    a = TURN * t
    p = [RADIUS * np.cos(a), RADIUS * np.sin(a), 0.3 * np.sin(0.7 * t)]
    return se3.from_rotation_translation(so3.from_rpy(0.0, 0.0, a + np.pi / 2), p)


def measured(t, rng, biases):
    """Return what an IMU of the configured noise reads at times (N,), and the biases after them."""
    c = RunConfig().imu
    per_sample = np.repeat([c.gyro_noise, c.accel_noise], 3) * np.sqrt(RATE)
    walks = np.repeat([c.gyro_walk, c.accel_walk], 3) / np.sqrt(RATE)
    path = biases + np.cumsum(walks * rng.standard_normal((len(t), 6)), axis=0)
    clean = np.zeros((len(t), 6))
    clean[:, 2] = TURN
    clean[:, 4] = RADIUS * TURN**2
    clean[:, 5] = G - 0.3 * 0.49 * np.sin(0.7 * t)
    return clean + path + per_sample * rng.standard_normal((len(t), 6)), path[-1]


def keyframes(rng, inertial):
    """Yield keyframes of an odometry that drifts by `STEP`, and whose level is off by what the graph is told."""
    config = RunConfig()
    sigma = np.repeat([config.imu.gyro_bias_sigma, config.imu.accel_bias_sigma], 3)
    biases, T = 0.2 * sigma * rng.standard_normal(6), true_pose(0.0)
    tilt = np.zeros(6)
    if inertial:
        tilt[:2] = np.radians(config.slam.level_sigma_deg) * rng.standard_normal(2)
        biases = sigma * rng.standard_normal(6)
    T_odom_world = T @ se3.exp(np.concatenate([T[:3, :3].T @ tilt[:3], tilt[3:]])) @ se3.inverse(T)
    T = T_odom_world @ T
    known = biases
    for index in range(COUNT):
        imu = ImuBatch.joined([])
        if index:
            T = T @ se3.inverse(true_pose(index - 1.0)) @ true_pose(float(index)) @ se3.exp(STEP * rng.normal(size=6))
        if inertial:
            t = np.arange(0, RATE + 1)[index == 0 :] / RATE + index - 1.0
            rows, biases = measured(t, rng, biases)
            imu = ImuBatch(
                stamps_ns=np.round(1e9 * (t + 100.0)).astype(np.int64),
                gyro=np.ascontiguousarray(rows[:, :3]), accel=np.ascontiguousarray(rows[:, 3:]), received_ns=0,
            )  # fmt: skip
        now = true_pose(float(index))[:3, :3]
        v = now @ [RADIUS * TURN, 0.0, 0.0] + [0.0, 0.0, 0.21 * np.cos(0.7 * index)]
        yield Keyframe(
            index=index, stamp_ns=round(1e9 * (index + 100.0)), T_odom_imu=np.ascontiguousarray(T),
            v_odom=T_odom_world[:3, :3] @ v, gyro_bias=known[:3] * 0.0, accel_bias=known[3:] * 0.0,
            g_odom=T_odom_world[:3, :3] @ [0.0, 0.0, -G] * inertial,
            step_covariance=np.diag(STEP**2) * (index > 0), lidar_information=1e12 * np.eye(6),
            points_imu=np.zeros((1, 3), np.float32), intensity=None, imu=imu,
        )  # fmt: skip


def nees_of(back_end):
    """Return the squared errors of some keyframes in the graph's own covariance."""
    T = back_end.T_map_imu
    found = []
    for index in AT:
        d = se3.local(T[index], true_pose(float(index)))
        found.append(d @ np.linalg.solve(back_end.covariance(index), d))
    return found


def nees_before_and_after(seed, inertial, path):
    rng = np.random.default_rng([41, seed])
    back_end = BackEnd(RunConfig(), KeyframeStore.create(path / f"{seed}_{inertial}"))
    for keyframe in keyframes(rng, inertial):
        back_end.add(keyframe)
    back_end.store.close()
    before = nees_of(back_end)
    T_true = [true_pose(float(k)) for k in range(COUNT)]
    for query in range(34, COUNT, 4):
        back_end.ledger.add_by_hand(loop(query, query - 31, T_true, noise=rng, sigma=LOOP))
    assert back_end._enforce() == []  # none is taken back
    return before, nees_of(back_end)


def assert_in_band(nees):
    """Assert that means over seeds (seeds, 2, keyframes) lie in their 99.9 % band: twelve of them are looked at."""
    seeds = len(nees)
    low, high = chi2.ppf([0.0005, 0.9995], 6 * seeds) / seeds
    mean = np.mean(nees, axis=0)
    assert (low <= mean).all() and (mean <= high).all(), f"{mean} outside of {low:.2f} to {high:.2f}"


@pytest.mark.parametrize("inertial", [False, True])
def test_poses_lie_within_their_covariance_before_and_after_loops(tmp_path, inertial):
    assert_in_band([nees_before_and_after(seed, inertial, tmp_path) for seed in range(6)])


@pytest.mark.slow
@pytest.mark.parametrize("inertial", [False, True])
def test_poses_of_many_seeds_lie_within_their_covariance(tmp_path, inertial):
    assert_in_band([nees_before_and_after(seed, inertial, tmp_path) for seed in range(100, 120)])


@pytest.mark.parametrize("inertial", [False, True])
def test_benchmark_measures_the_same(monkeypatch, inertial):
    """`benchmarks.graph_sigmas` solves graphs anew out of keyframes: errors as large as their covariance says."""
    monkeypatch.syspath_prepend(str(Path(__file__).resolve().parents[2]))
    from benchmarks.graph_sigmas import graph_nees

    T_true = np.array([true_pose(float(k)) for k in range(COUNT)])
    some = [list(keyframes(np.random.default_rng([43, seed]), inertial)) for seed in range(2)]
    nees = [graph_nees(walk, (), T_true, RunConfig(), inertial=inertial, every=20)[0] for walk in some]
    assert np.shape(nees) == (2, 3, 2)
    whole, place = np.mean(nees, axis=(0, 1))
    assert 1.5 < whole < 14.0 and 0.7 < place < 8.0  # six and three expected, of numbers that hang together
