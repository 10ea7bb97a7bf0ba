"""What the noise of normals feigns: its expectation against sampling, and what is left of an information without it."""

from dataclasses import replace

import numpy as np
import pytest
from test_linearize import CONFIG, SETTINGS, AnyMap, scene

from heliograph.config import MapConfig
from heliograph.maps import VoxelMap
from heliograph.registration import MatchSettings, NormalEquations, linearize, true_share
from reference.matching import feigned_slowly
from states import random_pose

AXIS, SIDE, UP = np.eye(3)
HALF = 2.1  # off the borders of the map's cubes


def tube(rng, count, *, noise=0.02, ends=False):
    """Points on the walls of a tube along x, 30 m long, and on its ends if there are any; noise across them."""
    a, b = rng.uniform(-15.0, 15.0, count), rng.uniform(-HALF, HALF, count)
    side = rng.integers(0, 4, count)
    y, z = HALF * (2 * side - 1), HALF * (2 * side - 5)
    points = np.stack([a, np.where(side < 2, y, b), np.where(side < 2, b, z)], axis=1)
    normal = np.where(side < 2, 1, 2)
    if ends:
        some = rng.random(count) < 0.02
        points[some] = np.stack([np.full(some.sum(), 15.0), *rng.uniform(-HALF, HALF, (2, some.sum()))], axis=1)
        normal = np.where(some, 0, normal)
    points[np.arange(count), normal] += noise * rng.standard_normal(count)
    return points.astype(np.float32)


def tube_equations(seed, **kinds):
    rng = np.random.default_rng(seed)
    local_map = VoxelMap(MapConfig())
    for _ in range(6):
        local_map.insert(tube(rng, 15_000, **kinds), np.eye(4))
    points = tube(rng, 6000, **kinds)
    before_end = rng.uniform(0.0, 0.1, len(points)).astype(np.float32)
    settings = MatchSettings(gate=0.15, kernel=0.06, sigma=0.02, fallback_stride=0)
    return linearize(local_map, points, np.eye(4), settings, before_end=before_end)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("motion", [False, True])
def test_feigned_sums_equal_brute_force(seed, motion):
    rng = np.random.default_rng(seed)
    fast, slow, T, points = scene(rng)
    before_end = rng.uniform(0.0, 0.1, len(points)).astype(np.float32) if motion else None
    F, square = feigned_slowly(slow, points, T, gate=0.25, kernel=0.1, sigma=0.03, before_end=before_end)
    scale = np.sqrt(np.diag(F))
    for some in (fast, AnyMap(fast)):
        got = linearize(some, points, T, SETTINGS, before_end=before_end)
        np.testing.assert_allclose(got.feigned / np.outer(scale, scale), F / np.outer(scale, scale), atol=2e-3)
        assert got.feigned_square == pytest.approx(square, rel=1e-2)


def test_feigned_sums_do_not_depend_on_threads(rng):
    fast, _, T, points = scene(rng, points=6000, queries=6000)
    one, two = (linearize(fast, points, T, replace(SETTINGS, threads=n, fallback_stride=2)) for n in (1, 2))
    np.testing.assert_array_equal(one.feigned, two.feigned)
    assert one.feigned_square == two.feigned_square


def test_the_mounting_s_columns_feign_nothing(rng):
    from heliograph.registration import MapMounting

    fast, _, T, points = scene(rng)
    mounted = MapMounting(T_imu_lidar=random_pose(rng, 0.3), T_odom_imu_first=random_pose(rng, 1.0))
    for some in (fast, AnyMap(fast)):
        got = linearize(some, points, T, SETTINGS, mounted=mounted)
        assert got.feigned.shape == got.information.shape
        assert got.feigned[:6, :6].any()
        assert not got.feigned[6:].any()


@pytest.mark.parametrize("seed", range(4))
def test_along_a_tube_all_information_is_what_was_expected_of_noise(seed):
    equations = tube_equations(seed)
    ratio = equations.feigned[3, 3] / equations.information[3, 3]
    assert 0.7 < ratio < 1.4
    pose = true_share(equations, equations.columns_of("pose"))
    assert (pose.share == 0.0).sum() == 1
    np.testing.assert_allclose(pose.blind()[3:, 3:] @ AXIS, AXIS, atol=2e-2)
    assert np.abs(pose.blind()[3:, 3:] @ SIDE).max() < 2e-2
    np.testing.assert_allclose(pose.blind() @ pose.blind(), pose.blind(), atol=1e-9)
    whole = true_share(equations)
    left = whole.information()
    assert left[3, 3] < 1e-2 * equations.information[3, 3]  # position ...
    assert left[6, 6] < 1e-2 * equations.information[6, 6]  # ... and velocity along the axis
    np.testing.assert_allclose(
        np.diag(left)[[0, 1, 2, 4, 5]], np.diag(equations.information)[[0, 1, 2, 4, 5]], rtol=0.1
    )


def test_a_few_returns_that_face_the_axis_are_believed():
    equations = tube_equations(1, ends=True)
    pose = true_share(equations, equations.columns_of("pose"))
    assert pose.share.min() > 0.9
    assert not pose.blind().any() or np.abs(pose.blind()).max() < 1e-9


def test_gradient_and_covariance_of_the_true_part_are_honest(rng):
    """Regression on noisy rows: the raw solution is pulled to zero along the weak axis, the true part's is not."""
    d, sigma, tilt, count = np.array([0.0, 0.0, 0.0, 0.05, 0.0, 0.0]), 0.02, 0.03, 3000
    raw, mended, told = [], [], []
    for _ in range(300):
        n = rng.normal(size=(count, 3)) * [0.025, 1.0, 1.0]
        n /= np.linalg.norm(n, axis=1)[:, None]
        p = rng.uniform(-5.0, 5.0, (count, 3))
        true = np.hstack([np.cross(p, n), n])
        seen = n + tilt * np.cross(n, rng.standard_normal((count, 3)))
        J = np.hstack([np.cross(p, seen), seen])
        r = true @ d + sigma * rng.standard_normal(count)
        F = np.zeros((6, 6))
        for axis in np.eye(3):
            across = axis - (n @ axis)[:, None] * n  # three of these make the projection across n
            row = np.hstack([np.cross(p, across), across])
            F += tilt**2 * row.T @ row / sigma**2
        equations = NormalEquations(
            information=J.T @ J / sigma**2, gradient=J.T @ r / sigma**2, feigned=F, feigned_square=0.0,
            blocks=("pose",), weight=count / sigma**2, robust_weight=count, square=0.0, cost=0.0,
            matches=count, fallback_matches=0, queries=count,
        )  # fmt: skip
        share = true_share(equations)
        raw.append(np.linalg.solve(equations.information, equations.gradient))
        mended.append(np.linalg.solve(share.information(), share.gradient(equations.gradient)))
        told.append(np.linalg.inv(share.information())[3, 3])
    assert np.mean(raw, axis=0)[3] < 0.75 * d[3]
    assert np.mean(mended, axis=0)[3] == pytest.approx(d[3], rel=0.03)
    assert np.var(mended, axis=0)[3] == pytest.approx(np.mean(told), rel=0.3)


def test_nothing_matched_is_all_blind():
    empty = linearize(VoxelMap(CONFIG), np.ones((3, 3), np.float32), np.eye(4), SETTINGS)
    share = true_share(empty)
    assert not share.share.any()
    assert not share.information().any()
    np.testing.assert_array_equal(share.blind(), np.eye(6))


def test_a_map_that_does_not_tell_its_tilts_is_taken_at_its_word(rng):
    fast, _, T, points = scene(rng)

    class Silent(AnyMap):
        def planes_at(self, points_odom, *, gate):
            return replace(self.inner.planes_at(points_odom, gate=gate), tilt=None)

    got = linearize(Silent(fast), points, T, SETTINGS)
    share = true_share(got)
    np.testing.assert_allclose(share.information(), got.information, rtol=1e-9, atol=1e-6 * got.information.max())


def test_spread_of_a_gradient_as_noisy_as_the_sums_say_is_the_covariance():
    equations = tube_equations(2)
    found = true_share(equations, equations.columns_of("pose"))
    H = equations.information[:6, :6]
    np.testing.assert_allclose(found.spread(H), found.covariance(), rtol=1e-6, atol=1e-9 * found.covariance().max())
    np.testing.assert_allclose(found.spread(4.0 * H), 4.0 * found.covariance(), rtol=1e-6, atol=1e-8)
