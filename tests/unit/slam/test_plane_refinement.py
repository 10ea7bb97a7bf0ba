"""Bundle adjustment over planes: derivatives against the slow twin, walls that become thin, and what is left alone."""

import numpy as np
import pytest

from heliograph.lie import se3
from heliograph.slam.plane_refinement import PlaneBundle, StepsBetween, _bundle, refine_planes

SIGMA = np.repeat([np.radians(0.3), 0.03], 3)


def hall(rng, count=10, noise=0.01, points=2500):
    """Clouds of a hall of 10 m by 6 m by 4 m from poses along it, and the poses."""
    T = se3.exp(np.column_stack([0.1 * rng.standard_normal((count, 3)), np.zeros((count, 3))]))
    T[:, :3, 3] = np.column_stack([np.linspace(-3.0, 3.0, count), 0.3 * rng.standard_normal((count, 2))])
    half, clouds = np.array([5.3, 3.3, 2.3]), []
    for pose in T:
        p = rng.uniform(-1.0, 1.0, (points, 3)) * half
        axis, side = rng.integers(0, 3, points), rng.choice([-1.0, 1.0], points)
        p[np.arange(points), axis] = side * half[axis] + noise * rng.standard_normal(points)
        clouds.append(((p - pose[:3, 3]) @ pose[:3, :3]).astype(np.float32))
    return clouds, T


def chain(count):
    return StepsBetween(
        first=np.arange(count - 1), second=np.arange(1, count), covariance=np.tile(np.diag(SIGMA**2), (count - 1, 1, 1))
    )


def jittered(T, rng):
    moved = T @ se3.exp(np.repeat([np.radians(0.2), 0.02], 3) * rng.standard_normal((len(T), 6)))
    moved[0] = T[0]
    return moved


def test_gradient_is_that_of_the_slow_twin(rng):
    """Eigenvalues of covariances summed point by point, and central differences of them."""
    clouds, T = hall(rng, count=4, points=4000)
    T = jittered(T, rng)
    bundle = _bundle(clouds, T)
    gradient = 2.0 * bundle.linearised(T)[0]
    for k in range(4):
        for axis in range(6):
            d = np.zeros((4, 6))
            d[k, axis] = 1e-6
            slope = (bundle.cost(T @ se3.exp(d)) - bundle.cost(T @ se3.exp(-d))) / 2e-6
            assert gradient[k, axis] == pytest.approx(slope, rel=1e-4, abs=1e-4)


def test_cost_is_the_sum_of_squared_distances(rng):
    q = rng.standard_normal((2, 30, 3)) * [1.0, 1.0, 0.02]
    T = se3.exp(0.01 * rng.standard_normal((2, 6)))
    one = np.zeros(2, dtype=np.int64)
    bundle = PlaneBundle(np.arange(2), one, np.full(2, 30.0), q.sum(axis=1), np.einsum("kni,knj->kij", q, q))
    p = np.concatenate([q[k] @ T[k, :3, :3].T + T[k, :3, 3] for k in range(2)])
    normal = np.linalg.svd(p - p.mean(axis=0))[2][-1]
    assert bundle.cost(T) == pytest.approx(np.sum(((p - p.mean(axis=0)) @ normal) ** 2), rel=1e-9)


def test_hessian_is_that_of_the_points(rng):
    """Rows of single points and of their plane, multiplied out: what the moments must come to."""
    q = rng.standard_normal((3, 20, 3)) * [1.0, 1.0, 0.02] + [0.0, 0.0, 2.0]
    T = se3.exp(0.05 * rng.standard_normal((3, 6)))
    plane = np.zeros(3, dtype=np.int64)
    bundle = PlaneBundle(np.arange(3), plane, np.full(3, 20.0), q.sum(axis=1), np.einsum("kni,knj->kij", q, q))
    _, own, shared, planes = bundle.linearised(T)
    _, centre, _, vectors = bundle.spread(T)
    total = np.zeros((3, 3))
    for k in range(3):
        R, n = T[k, :3, :3], vectors[0][:, 0]
        p = q[k] @ R.T + T[k, :3, 3]
        rows = np.column_stack([np.cross(q[k], R.T @ n), np.tile(R.T @ n, (20, 1))])
        tilts = np.column_stack([(p - centre[0]) @ vectors[0][:, 1:], -np.ones(20)])
        np.testing.assert_allclose(own[k], rows.T @ rows, atol=1e-9)
        np.testing.assert_allclose(shared[k], rows.T @ tilts, atol=1e-9)
        total += tilts.T @ tilts
    np.testing.assert_allclose(planes[0], total, atol=1e-9)


def test_walls_become_thin_and_poses_true(rng):
    clouds, T = hall(rng)
    start = jittered(T, rng)
    found = refine_planes(clouds, start, chain(len(T)))
    assert found.refined and found.reason == "walls are thinner"
    assert found.thickness_after < 0.65 * found.thickness_before and found.thickness_after < 0.0125
    off = [np.linalg.norm(se3.local(T, poses)[1:, 3:], axis=1).mean() for poses in (start, found.T_map_imu)]
    assert off[1] < 0.25 * off[0]


def test_true_poses_and_clouds_without_planes_are_left_alone(rng):
    clouds, T = hall(rng)
    found = refine_planes(clouds, T, chain(len(T)))
    assert not found.refined and "thinner" in found.reason
    np.testing.assert_array_equal(found.T_map_imu, T)
    fog = [rng.uniform(-5.0, 5.0, (400, 3)).astype(np.float32) for _ in T]
    found = refine_planes(fog, T, chain(len(T)))
    assert not found.refined
    np.testing.assert_array_equal(found.T_map_imu, T)
