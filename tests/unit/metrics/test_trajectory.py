import numpy as np
import pytest

from heliograph.data import Trajectory
from heliograph.errors import ConfigError, DataError
from heliograph.lie import se3, so3
from heliograph.metrics import (
    absolute_trajectory_error,
    align,
    align_poses,
    associate,
    best_time_offset,
    change_body,
    path_length,
    relative_pose_error,
    start_end_gap,
)

START_NS = 1_700_000_000_000_000_000


def loop(n: int = 300, *, rate: float = 10.0, start_ns: int = START_NS) -> Trajectory:
    """A wavy figure with turns about every axis, 2 m/s or so."""
    t = np.arange(n) / rate
    position = np.stack([20 * np.sin(0.12 * t), 15 * np.sin(0.24 * t + 0.3), 0.8 * np.sin(0.5 * t)], axis=1)
    rotation = so3.exp(
        np.stack([0.2 * np.sin(0.7 * t), 0.1 * np.cos(0.9 * t), 0.3 * t + 0.4 * np.sin(0.6 * t)], axis=1)
    )
    stamps = start_ns + np.round(t * 1e9).astype(np.int64)
    return Trajectory(stamps_ns=stamps, T_frame_body=se3.from_rotation_translation(rotation, position))


def moved(trajectory: Trajectory, T: np.ndarray) -> Trajectory:
    return Trajectory(stamps_ns=trajectory.stamps_ns, T_frame_body=T @ trajectory.T_frame_body)


def noisy(trajectory: Trajectory, rng: np.random.Generator, sigma: float = 0.05) -> Trajectory:
    d = rng.normal(size=(len(trajectory), 6)) * sigma
    return Trajectory(stamps_ns=trajectory.stamps_ns, T_frame_body=se3.retract(trajectory.T_frame_body, d))


TILTED = se3.exp([0.4, -0.8, 2.0, 5.0, -7.0, 1.0])
LEVEL = se3.exp([0.0, 0.0, 2.0, 5.0, -7.0, 1.0])


@pytest.mark.parametrize(("mode", "T"), [("se3", TILTED), ("yaw", LEVEL), ("origin", TILTED), ("none", np.eye(4))])
def test_align_recovers_the_frame_change(mode, T):
    reference = loop()
    pair = associate(moved(reference, se3.inverse(T)), reference)
    np.testing.assert_allclose(align(pair.T_estimate, pair.T_reference, mode), T, atol=1e-9)
    error = absolute_trajectory_error(pair, mode=mode)
    assert error.rmse < 1e-9
    assert error.rotation_rmse_deg < 1e-6
    assert error.n == len(reference)


def test_align_yaw_leaves_a_tilt_to_be_seen():
    reference = loop()
    tilt = se3.exp([0.05, 0.0, 0.0, 0.0, 0.0, 0.0])
    pair = associate(moved(reference, tilt), reference)
    assert absolute_trajectory_error(pair, mode="yaw").rotation_rmse_deg == pytest.approx(np.rad2deg(0.05), rel=0.01)
    assert absolute_trajectory_error(pair, mode="se3").rmse < 1e-9


@pytest.mark.parametrize("mode", ["se3", "yaw"])
def test_align_is_a_minimum_of_the_squared_distance(mode, rng):
    reference = loop(60)
    pair = associate(noisy(moved(reference, TILTED), rng, 0.5), reference)
    T = align(pair.T_estimate, pair.T_reference, mode)

    def cost(transform):
        return np.sum((se3.act(transform, pair.T_estimate[:, :3, 3]) - pair.T_reference[:, :3, 3]) ** 2)

    free = np.eye(6) if mode == "se3" else np.eye(6)[2:]
    for direction in free:
        for step in (-1e-3, 1e-3):
            assert cost(se3.exp(step * direction) @ T) > cost(T)


def test_align_never_mirrors_a_flat_path(rng):
    reference = loop()
    flat = reference.T_frame_body.copy()
    flat[:, 2, 3] = 0.0
    T = align(flat, np.diag([1.0, -1.0, 1.0, 1.0]) @ flat, "se3")
    assert np.linalg.det(T[:3, :3]) == pytest.approx(1.0)


@pytest.mark.parametrize("mode", ["se3", "yaw"])
def test_align_refuses_what_the_path_leaves_open(mode):
    T = np.tile(np.eye(4), (20, 1, 1))
    if mode == "se3":
        T[:, 0, 3] = np.arange(20)
    with pytest.raises(DataError, match="origin"):
        align(T, T, mode)


def test_align_names_the_modes():
    with pytest.raises(ConfigError, match="did you mean 'yaw'"):
        align(np.eye(4)[None], np.eye(4)[None], "yav")


def test_associate_uses_covered_stamps_only():
    reference = loop(100)
    estimate = Trajectory(
        stamps_ns=np.delete(reference.stamps_ns, slice(40, 61))[5:-5] + 1_000_000,
        T_frame_body=np.delete(reference.T_frame_body, slice(40, 61), axis=0)[5:-5],
    )
    pair = associate(estimate, reference)
    used = np.searchsorted(reference.stamps_ns, pair.stamps_ns)
    assert used.tolist() == [*range(6, 40), *range(62, 95)]
    assert len(associate(estimate, reference, max_gap_s=3.0)) == 6 + 83


def test_associate_uses_an_exact_hit_beside_a_gap():
    reference = loop(100)
    sparse = Trajectory(stamps_ns=reference.stamps_ns[::20], T_frame_body=reference.T_frame_body[::20])
    assert len(associate(sparse, reference)) == 5


def test_associate_measures_distance_over_what_it_leaves_out():
    reference = loop(100)
    sparse = Trajectory(stamps_ns=reference.stamps_ns[::20], T_frame_body=reference.T_frame_body[::20])
    whole = associate(reference, reference)
    np.testing.assert_array_equal(associate(sparse, reference).distance, whole.distance[::20])


def test_associate_adds_the_offset_to_the_estimate():
    reference = loop(100)
    late = Trajectory(stamps_ns=reference.stamps_ns - 30_000_000, T_frame_body=reference.T_frame_body)
    pair = associate(late, reference, time_offset=0.03)
    np.testing.assert_allclose(pair.T_estimate, pair.T_reference, atol=1e-12)
    assert len(pair) == 100


def test_associate_without_overlap_names_both_spans():
    with pytest.raises(DataError, match="same clock"):
        associate(loop(10, start_ns=0), loop(10))


def test_relative_error_pairs_are_the_first_far_enough(rng):
    reference, delta = loop(200), 7.0
    pair = associate(noisy(reference, rng), reference)
    translation, rotation, percent = [], [], []
    for i in range(200):
        for j in range(i + 1, 200):
            if pair.distance[j] >= pair.distance[i] + delta:
                Q = np.linalg.inv(pair.T_reference[i]) @ pair.T_reference[j]
                P = np.linalg.inv(pair.T_estimate[i]) @ pair.T_estimate[j]
                E = np.linalg.inv(Q) @ P
                translation.append(np.linalg.norm(E[:3, 3]))
                percent.append(100 * translation[-1] / (pair.distance[j] - pair.distance[i]))
                rotation.append(np.rad2deg(np.linalg.norm(so3.log(E[:3, :3]))))
                break
    result = relative_pose_error(pair, delta=delta)
    assert result.n == len(translation) > 50
    assert result.translation_rmse == pytest.approx(np.sqrt(np.mean(np.square(translation))))
    assert result.rotation_rmse_deg == pytest.approx(np.sqrt(np.mean(np.square(rotation))))
    assert result.translation_rmse_percent == pytest.approx(np.sqrt(np.mean(np.square(percent))))
    assert result.rotation_max_deg == pytest.approx(max(rotation))


def test_relative_error_pair_may_be_exactly_delta_apart():
    T = np.tile(np.eye(4), (6, 1, 1))
    T[:, 0, 3] = np.arange(6.0)
    straight = Trajectory(stamps_ns=np.arange(6), T_frame_body=T)
    assert relative_pose_error(associate(straight, straight), delta=3.0).n == 3


def test_relative_error_ignores_the_fixed_frame(rng):
    reference = loop()
    estimate = noisy(reference, rng)
    one = relative_pose_error(associate(estimate, reference))
    other = relative_pose_error(associate(moved(estimate, TILTED), reference))
    assert one.translation_rmse == pytest.approx(other.translation_rmse, rel=1e-9)


def test_relative_error_of_a_scale_error_is_that_percentage():
    reference = loop()
    T = reference.T_frame_body.copy()
    T[:, :3, 3] *= 1.02
    result = relative_pose_error(
        associate(Trajectory(stamps_ns=reference.stamps_ns, T_frame_body=T), reference), delta=1
    )
    assert result.translation_rmse_percent == pytest.approx(2.0, rel=0.02)


def test_relative_error_of_a_short_path_has_no_pairs():
    result = relative_pose_error(associate(loop(5), loop(5)), delta=1000.0)
    assert result.n == 0
    assert np.isnan(result.translation_rmse)


def test_relative_error_refuses_a_delta_of_zero():
    with pytest.raises(DataError, match="positive delta"):
        relative_pose_error(associate(loop(5), loop(5)), delta=0.0)


@pytest.mark.parametrize("shift_ms", [-41.0, 0.0, 12.5, 57.3])
def test_best_time_offset_finds_the_shift(shift_ms, rng):
    reference = loop(300, rate=10.0)
    fine = loop(3000, rate=100.0)
    early = Trajectory(stamps_ns=fine.stamps_ns - round(shift_ms * 1e6), T_frame_body=fine.T_frame_body)
    estimate = noisy(early, rng, 1e-4)
    assert best_time_offset(estimate, reference) * 1e3 == pytest.approx(shift_ms, abs=0.2)


def test_best_time_offset_stays_within_the_limit():
    reference = loop(300)
    early = Trajectory(stamps_ns=reference.stamps_ns - 200_000_000, T_frame_body=reference.T_frame_body)
    assert 0.059 < best_time_offset(early, reference, limit_s=0.06) <= 0.06


def test_best_time_offset_of_a_short_path_asks_for_a_smaller_delta():
    with pytest.raises(DataError, match="smaller delta"):
        best_time_offset(loop(20), loop(20))


def test_change_body_keeps_the_relation_of_the_frames():
    T_imu_lidar = se3.exp([0.1, 0.2, 0.3, 0.05, 0.0, 0.1])
    lidar = change_body(loop(10), T_imu_lidar, body="lidar")
    assert lidar.body == "lidar"
    np.testing.assert_allclose(lidar.T_frame_body[3], loop(10).T_frame_body[3] @ T_imu_lidar)


def test_path_length_and_gap_of_a_square():
    corners = np.tile(np.eye(4), (5, 1, 1))
    corners[:, :2, 3] = [[0, 0], [2, 0], [2, 2], [0, 2], [0, 0.5]]
    square = Trajectory(stamps_ns=np.arange(5), T_frame_body=corners)
    assert path_length(square) == pytest.approx(7.5)
    assert start_end_gap(square) == pytest.approx(0.5)


@pytest.mark.parametrize("path", ["rest", "straight", "round"])
def test_poses_align_where_positions_alone_leave_the_rotation_open(path, rng):
    s = np.linspace(0.0, 2.0 * np.pi, 200)
    p = {
        "rest": np.zeros((200, 3)),
        "straight": np.stack([10.0 * s, 0.0 * s, 0.0 * s], axis=-1),
        "round": np.stack([20.0 * np.cos(s), 20.0 * np.sin(s), np.sin(s)], axis=-1),
    }[path]
    T_reference = se3.from_rotation_translation(so3.exp(np.stack([0.0 * s, 0.1 * np.sin(s), s], axis=-1)), p)
    T_truth = se3.exp([0.3, -0.4, 2.0, 5.0, -7.0, 1.0])
    noise = np.concatenate([1e-4 * rng.standard_normal((200, 3)), 2e-3 * rng.standard_normal((200, 3))], axis=1)
    T_estimate = se3.inverse(T_truth) @ T_reference @ se3.exp(noise)
    off = se3.local(T_truth, align_poses(T_estimate, T_reference))
    assert np.linalg.norm(off[:3]) < 1e-4
    if path == "round":  # long positions tell more than orientations, and are listened to
        np.testing.assert_allclose(align_poses(T_estimate, T_reference), align(T_estimate, T_reference), atol=1e-3)
    exact = align_poses(se3.inverse(T_truth) @ T_reference, T_reference)
    np.testing.assert_allclose(exact, T_truth, atol=1e-7)


def test_poses_that_do_not_pair_are_refused():
    poses = np.tile(np.eye(4), (3, 1, 1))
    for bad in (poses[:2], poses[:, :3], np.full((3, 4, 4), np.nan)):
        with pytest.raises(DataError, match="T_reference"):
            align_poses(poses, bad)
    with pytest.raises(DataError, match="no poses"):
        align_poses(poses[:0], poses[:0])
