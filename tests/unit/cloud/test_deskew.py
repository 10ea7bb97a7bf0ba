"""De-skewing against its twin and the textbook's numbers."""

import numpy as np
import pytest

from heliograph.cloud import deskew
from heliograph.config import ImuConfig
from heliograph.data import ImuBatch
from heliograph.errors import DataError
from heliograph.imu import propagate
from heliograph.lie import so3
from reference.clouds import deskew_slowly
from states import GRAVITY, NOISE, START_NS, random_pose, random_rotation, rest_state

SWEEP_NS = 100_000_000


def random_path(rng, knots, *, turn=0.4):
    stamps = START_NS + np.sort(rng.choice(SWEEP_NS, knots, replace=False)).astype(np.int64)
    R = [random_rotation(rng)]
    for _ in range(knots - 1):
        R.append(R[-1] @ so3.exp(rng.normal(scale=turn / knots, size=3)))
    return stamps, np.stack(R), 1000.0 + np.cumsum(rng.normal(scale=0.3 / knots, size=(knots, 3)), axis=0)


def straight_path(v, *, duration=0.1):
    """From rest at the origin along x at v, two poses."""
    stamps = START_NS + np.array([0, int(duration * 1e9)], dtype=np.int64)
    return {
        "stamp_ns": START_NS,
        "path_stamps_ns": stamps,
        "R_odom_body": np.tile(np.eye(3), (2, 1, 1)),
        "p_odom": np.array([[0.0, 0.0, 0.0], [v * duration, 0.0, 0.0]]),
        "T_body_lidar": np.eye(4),
    }


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("knots", [1, 2, 3, 21, 400])
def test_deskew_equals_its_twin(seed, knots):
    rng = np.random.default_rng(seed)
    stamps, R, p = random_path(rng, knots)
    points = rng.uniform(-40.0, 40.0, (300, 3)).astype(np.float32)
    offsets = rng.integers(0, SWEEP_NS, 300).astype(np.int32)
    case = {
        "stamp_ns": START_NS,
        "path_stamps_ns": stamps,
        "R_odom_body": R,
        "p_odom": p,
        "T_body_lidar": random_pose(rng, 0.5),
        "reference": int(rng.choice([0, -1, knots // 2])),
    }
    np.testing.assert_allclose(deskew(points, offsets, **case), deskew_slowly(points, offsets, **case), atol=4e-5)


@pytest.mark.parametrize("turn", [1e-9, 1e-4, 3.0, np.pi - 1e-4])
def test_deskew_follows_the_geodesic_for_small_and_large_turns(rng, turn):
    axis = np.array([0.6, 0.0, 0.8])
    R = np.stack([np.eye(3), so3.exp(turn * axis)])
    points = rng.uniform(-5.0, 5.0, (50, 3)).astype(np.float32)
    offsets = np.linspace(0, SWEEP_NS, 50).astype(np.int32)
    moved = deskew(points, offsets, stamp_ns=0, path_stamps_ns=np.array([0, SWEEP_NS]), R_odom_body=R,
                   p_odom=np.zeros((2, 3)), T_body_lidar=np.eye(4), reference=0)  # fmt: skip
    s = (offsets / SWEEP_NS)[:, None]
    np.testing.assert_allclose(moved, np.einsum("kij,kj->ki", so3.exp(s * turn * axis), points), atol=2e-5)


def test_textbook_point_at_3_m_after_80_ms_at_1_5_m_s_lies_at_3_12_m_in_the_start_frame():
    point, offset = np.array([[3.0, 0.0, 0.0]], np.float32), np.array([80_000_000], np.int32)
    moved = deskew(point, offset, **straight_path(1.5), reference=0)
    np.testing.assert_allclose(moved, [[3.12, 0.0, 0.0]], atol=1e-6)


@pytest.mark.parametrize(("speed", "misplaced"), [(1.5, 0.15), (2.0, 0.20)])
def test_textbook_last_point_of_a_sweep_is_misplaced_by_speed_times_its_duration(speed, misplaced):
    point, offset = np.array([[10.0, 4.0, 1.0]], np.float32), np.array([100_000_000], np.int32)
    moved = deskew(point, offset, **straight_path(speed), reference=0)
    assert np.linalg.norm(moved - point) == pytest.approx(misplaced, abs=1e-6)


def test_the_first_point_stays_in_the_start_frame_and_the_last_in_the_end_frame():
    points, offsets = np.ones((2, 3), np.float32), np.array([0, 100_000_000], np.int32)
    path = straight_path(2.0)
    assert deskew(points, offsets, **path, reference=0)[0] == pytest.approx(points[0])
    assert deskew(points, offsets, **path, reference=-1)[1] == pytest.approx(points[1])


def test_deskew_of_a_static_scan_is_the_mounting(rng):
    points, offsets = rng.normal(size=(20, 3)).astype(np.float32), np.arange(20, dtype=np.int32)
    T = random_pose(rng, 0.2)
    moved = deskew(points, offsets, **(straight_path(0.0) | {"T_body_lidar": T}))
    np.testing.assert_allclose(moved, points @ T[:3, :3].T + T[:3, 3], atol=1e-6)


def test_points_outside_the_path_take_its_nearest_pose():
    points, path = np.ones((1, 3), np.float32), straight_path(1.0)
    late = deskew(points, np.array([300_000_000], np.int32), **path, reference=0)
    np.testing.assert_allclose(late, [[1.1, 1.0, 1.0]], atol=1e-6)
    early = deskew(points, np.array([0], np.int32), **(path | {"stamp_ns": START_NS - 10**8}), reference=0)
    np.testing.assert_allclose(early, points, atol=1e-6)


def test_deskew_does_not_depend_on_threads_nor_on_where_in_the_world_it_is(rng):
    stamps, R, p = random_path(rng, 40)
    points = rng.uniform(-40.0, 40.0, (20_000, 3)).astype(np.float32)
    offsets = rng.integers(0, SWEEP_NS, 20_000).astype(np.int32)
    case = {"stamp_ns": START_NS, "path_stamps_ns": stamps, "T_body_lidar": np.eye(4)}
    one = deskew(points, offsets, **case, R_odom_body=R, p_odom=p, threads=1)
    np.testing.assert_array_equal(one, deskew(points, offsets, **case, R_odom_body=R, p_odom=p, threads=2))
    far, turned = p @ random_rotation(rng).T, random_rotation(rng)
    assert far.shape == p.shape
    moved = deskew(points, offsets, **case, R_odom_body=turned @ R, p_odom=p @ turned.T + 1e4, threads=1)
    np.testing.assert_allclose(moved, one, atol=3e-5)


def test_empty_and_nan_points_pass(rng):
    path = straight_path(1.0)
    assert deskew(np.zeros((0, 3), np.float32), np.zeros(0, np.int32), **path).shape == (0, 3)
    points = np.array([[np.nan, 0.0, 0.0], [1.0, 2.0, 3.0]], np.float32)
    moved = deskew(points, np.array([0, 100_000_000], np.int32), **path)
    np.testing.assert_allclose(moved[1], [1.0, 2.0, 3.0], atol=1e-6)


def test_deskew_refuses_lengths_that_differ():
    path = straight_path(1.0)
    with pytest.raises(DataError, match="2 points but 1 time offsets"):
        deskew(np.ones((2, 3), np.float32), np.zeros(1, np.int32), **path)
    with pytest.raises(DataError, match="2 stamps, 2 rotations, 1 positions"):
        deskew(np.ones((1, 3), np.float32), np.zeros(1, np.int32), **(path | {"p_odom": np.zeros((1, 3))}))


def ablation_errors(rate):
    """Worst misplacement [m] of points at 10 m on a swaying, turning sweep: off, constant velocity, IMU at the rate."""
    t = np.arange(0.0, 0.3 + 1e-9, 1.0 / rate)
    stamps = START_NS + np.round(t * 1e9).astype(np.int64)
    # Yaw 0.9 sin(5 t): up to 4.5 rad/s, and no constant rate fits it over a sweep.
    gyro = np.stack([0 * t, 0 * t, 0.9 * 5.0 * np.cos(5.0 * t)], axis=1)
    imu = ImuBatch(stamps_ns=stamps, gyro=gyro, accel=np.tile([0, 0, GRAVITY], (len(t), 1)), received_ns=0)
    begin, end = START_NS + 100_000_000, START_NS + 200_000_000
    yaw = 0.9 * np.sin(5.0 * np.linspace(0.1, 0.2, 101))
    offsets = np.linspace(0, SWEEP_NS, 101).astype(np.int32)
    points = np.tile(np.array([10.0, 0.0, 0.0], np.float32), (101, 1))
    case = {"stamp_ns": begin, "T_body_lidar": np.eye(4), "reference": 0}
    turn = np.zeros((101, 3))
    turn[:, 2] = yaw - yaw[0]
    truth = np.einsum("kij,kj->ki", so3.exp(turn), points)
    start = rest_state(stamp_ns=begin)
    _, path = propagate(start, imu, end, noise=NOISE, config=ImuConfig())
    by_imu = deskew(
        points, offsets, **case, path_stamps_ns=path.stamps_ns, R_odom_body=path.R_odom_imu, p_odom=path.p_odom
    )
    before = np.array([0.0, 0.0, yaw[0] / 0.1])  # the last sweep's mean rate, held
    held = {"path_stamps_ns": np.array([begin, end]), "p_odom": np.zeros((2, 3))}
    by_rate = deskew(points, offsets, **case, **held, R_odom_body=so3.exp(np.array([0 * before, 0.1 * before])))
    return [float(np.linalg.norm(moved - truth, axis=1).max()) for moved in (points, by_rate, by_imu)]


def test_ablation_imu_beats_constant_velocity_beats_none_and_faster_is_better():
    errors = {rate: ablation_errors(rate) for rate in (10.0, 50.0, 200.0)}
    for off, constant, imu in errors.values():
        assert imu < 0.7 * constant < 0.7 * off
    assert errors[200.0][2] < 0.3 * errors[50.0][2] < 0.1 * errors[10.0][2]
    assert errors[200.0][2] < 0.002
    assert errors[200.0][0] > 2.0
