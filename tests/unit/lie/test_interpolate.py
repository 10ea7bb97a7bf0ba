import numpy as np
import pytest

from heliograph.errors import DataError
from heliograph.lie import interpolate_se3, se3

START = 1_700_000_000_000_000_000


def some_path(rng, n=6):
    stamps = START + np.cumsum(rng.integers(50_000_000, 150_000_000, size=n))
    return stamps, se3.exp(rng.normal(size=(n, 6)))


def test_interpolation_hits_the_given_poses_exactly(rng):
    stamps, T = some_path(rng)
    np.testing.assert_array_equal(interpolate_se3(stamps, T, stamps), T)


def test_interpolation_halfway_is_half_the_twist(rng):
    xi = rng.normal(size=6)
    T = interpolate_se3([0, 10], np.stack([np.eye(4), se3.exp(xi)]), [0, 5, 10])
    np.testing.assert_allclose(se3.log(T), [0.0 * xi, 0.5 * xi, xi], atol=1e-14)


def test_interpolation_keeps_nanoseconds_of_an_epoch_stamp():
    T = se3.exp(np.array([[0, 0, 0, 0, 0, 0], [0, 0, 0, 1.0, 0, 0]]))
    middle = interpolate_se3([START, START + 1000], T, START + 333)
    assert middle[0, 3] == pytest.approx(0.333, abs=1e-12)


def test_interpolation_commutes_with_a_change_of_both_frames(rng):
    stamps, T = some_path(rng)
    A, B = se3.exp(rng.normal(size=(2, 6)))
    query = rng.integers(stamps[0], stamps[-1], size=40)
    inside = A @ interpolate_se3(stamps, T, query) @ B
    np.testing.assert_allclose(interpolate_se3(stamps, A @ T @ B, query), inside, atol=1e-12)


def test_interpolation_on_a_circle_stays_on_it():
    angles = np.array([0.0, 1.0])
    T = se3.exp(np.outer(angles, [0, 0, 1.0, 2.0, 0, 0]))
    path = interpolate_se3([0, 1000], T, np.arange(0, 1001, 100))
    np.testing.assert_allclose(np.linalg.norm(path[:, :3, 3] - [0, 2.0, 0], axis=1), 2.0, atol=1e-14)


def test_interpolation_refuses_queries_outside_and_counts_them(rng):
    stamps, T = some_path(rng)
    with pytest.raises(DataError, match="2 of 3 queries"):
        interpolate_se3(stamps, T, [stamps[0] - 1, stamps[0], stamps[-1] + 1])


def test_extrapolation_continues_the_twist(rng):
    xi = 0.3 * rng.normal(size=6)
    T = se3.exp(np.outer([0.0, 1.0, 2.0], xi))
    out = interpolate_se3([0, 100, 200], T, [-100, 300], extrapolate=True)
    np.testing.assert_allclose(se3.log(out), [-xi, 3 * xi], atol=1e-14)


def test_interpolation_of_equal_stamps_takes_the_last(rng):
    T = se3.exp(rng.normal(size=(4, 6)))
    np.testing.assert_array_equal(interpolate_se3([0, 10, 10, 20], T, [10])[0], T[2])
    np.testing.assert_array_equal(interpolate_se3([0, 10, 10], T[:3], [10])[0], T[2])
    np.testing.assert_array_equal(interpolate_se3([0, 0, 10], T[:3], [0])[0], T[1])


def test_interpolation_of_a_single_pose(rng):
    T = se3.exp(rng.normal(size=(1, 6)))
    np.testing.assert_array_equal(interpolate_se3([5], T, 5), T[0])
    np.testing.assert_allclose(interpolate_se3([5], T, 9, extrapolate=True), T[0], atol=1e-15)
    with pytest.raises(DataError):
        interpolate_se3([5], T, 6)


def test_interpolation_takes_any_shape_of_queries(rng):
    stamps, T = some_path(rng)
    assert interpolate_se3(stamps, T, np.full((2, 3), stamps[0])).shape == (2, 3, 4, 4)
    assert interpolate_se3(stamps, T, stamps[0]).shape == (4, 4)
    assert interpolate_se3(stamps, T, np.zeros(0, dtype=np.int64)).shape == (0, 4, 4)


def test_interpolation_refuses_no_poses():
    with pytest.raises(DataError, match="at least one"):
        interpolate_se3([], np.zeros((0, 4, 4)), [0])
