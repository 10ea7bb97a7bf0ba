"""The native registration kernel against its slow twin, and the surfaces it works on."""

import numpy as np
import pytest
from tests import scenes
from tests.reference.icp import elements_of, icp_sums

from heliograph import _core
from heliograph.lie import se3
from heliograph.registration import estimate_covariances, estimate_normals

RESIDUALS = {"point": 0, "plane": 1, "edge": 2, "distribution": 3}


def _clouds(voxel, levels=3):
    rng = np.random.default_rng(2)
    line = np.stack([np.zeros(300), np.full(300, 0.5), rng.uniform(-1, 1, 300)], axis=1)
    clouds = [np.concatenate([scenes.corner_room(rng, 12), line]).astype(np.float32) for _ in range(2)]
    return [_core.SurfaceCloud(c, voxel, levels if voxel else 1, 0.05, 6, 1) for c in clouds]


@pytest.mark.parametrize("voxel", [0.0, 0.4])
@pytest.mark.parametrize("residual", RESIDUALS)
def test_sums_agree_with_the_twin(voxel, residual):
    target, source = _clouds(voxel)
    T = np.ascontiguousarray(se3.exp([0.03, -0.02, 0.05, 0.1, -0.05, 0.02]))
    H, g, cost, weight, _, _, matches = _core.Matcher(target, 0, source, 0).sums(
        T, RESIDUALS[residual], False, 0.8, 0.2, 0.01, 0.5, False, False, 3
    )
    twin = icp_sums(elements_of(target, 0), elements_of(source, 0), T, residual, gate=0.8, kernel=0.2, sigma=0.01,
                    min_cosine=0.5, edge=voxel)  # fmt: skip
    assert matches == twin[4] > 3
    np.testing.assert_allclose(H, twin[0], rtol=2e-4, atol=1e-4 * np.abs(H).max())
    np.testing.assert_allclose(g, twin[1], rtol=2e-4, atol=1e-4 * np.abs(twin[1]).max())
    np.testing.assert_allclose([cost, weight], twin[2:4], rtol=1e-4)


def test_gradient_is_the_slope_of_the_cost():
    target, source = _clouds(0.4)
    T = np.ascontiguousarray(se3.exp([0.03, -0.02, 0.05, 0.1, -0.05, 0.02]))
    matcher = _core.Matcher(target, 0, source, 0)
    more = (RESIDUALS["point"], False, 0.8, 0.3, 0.01, 0.0, False)
    _, g, *_ = matcher.sums(T, *more, False, 1)
    step = 1e-4
    for i, direction in enumerate(np.eye(6)):
        near = (np.ascontiguousarray(se3.retract(T, sign * step * direction)) for sign in (1, -1))
        after, before = (matcher.sums(pose, *more, True, 1)[2] for pose in near)
        assert (after - before) / (2 * step) == pytest.approx(g[i], rel=0.01, abs=0.01 * np.abs(g).max())


def test_cubes_find_the_partner_that_holds_the_element():
    target, source = _clouds(0.4)
    rows = _core.Matcher(target, 0, source, 0).matches(np.eye(4), 3, True, 0.8, 0.2, 0.01, 0.0, False, 1)
    t, s = elements_of(target, 0)["mean"], elements_of(source, 0)["mean"]
    cubes = np.floor(t[rows[:, 12].astype(int)] / 0.4), np.floor(s[rows[:, 11].astype(int)] / 0.4)
    np.testing.assert_array_equal(*cubes)
    assert len(rows) > 0.5 * len(s)


def test_every_third_element_is_matched_as_it_is_among_all():
    target, source = _clouds(0.4)
    more = (np.eye(4), 3, False, 0.8, 0.2, 0.01, 0.0, False)
    everything, some = (_core.Matcher(target, 0, source, 0, stride).matches(*more, 1) for stride in (1, 3))
    np.testing.assert_array_equal(some, everything[everything[:, 11] % 3 == 0])
    sums = _core.Matcher(target, 0, source, 0, 3).sums(*more, False, 2)
    assert sums[6] == len(some) < 0.4 * len(everything)
    with pytest.raises(ValueError, match="stride"):
        _core.Matcher(target, 0, source, 0, 0)


def test_cubes_of_all_levels_hold_all_points():
    cloud = scenes.corner_room(np.random.default_rng(0), 20)
    native = _core.SurfaceCloud(cloud, 0.3, 4, 0.05, 6, 1)
    for level in range(4):
        e = elements_of(native, level)
        assert e["count"].sum() == len(cloud)
        np.testing.assert_allclose(
            (e["mean"] * e["count"][:, None]).sum(axis=0) / len(cloud), cloud.mean(axis=0), atol=1e-4
        )
        cubes = np.floor(e["mean"] / (0.3 * 2**level))
        assert len(np.unique(cubes, axis=0)) == len(cubes)


def test_normals_of_a_plane_and_a_sphere():
    rng = np.random.default_rng(4)
    ground = scenes.plane(rng, 2000, 0.0).astype(np.float32)
    np.testing.assert_allclose(estimate_normals(ground), np.tile([0.0, 0.0, 1.0], (2000, 1)), atol=1e-4)
    ball = scenes.sphere(rng, 6000, 0.0, centre=(0, 0, 0)).astype(np.float32)
    out = estimate_normals(ball)  # towards the origin: inwards
    cosine = -np.einsum("ij,ij->i", out, ball) / 2.5
    assert np.quantile(cosine, 0.01) > 0.99


def test_normals_turn_towards_the_viewpoint_and_skip_nan():
    ground = scenes.plane(np.random.default_rng(4), 500, 0.0).astype(np.float32)
    ground[7] = np.nan
    below = estimate_normals(ground, viewpoint=np.array([0.0, 0.0, -9.0]))
    assert np.isnan(below[7]).all()
    assert (np.delete(below, 7, axis=0)[:, 2] < -0.99).all()


def test_covariances_agree_with_numpy():
    cloud = scenes.corner_room(np.random.default_rng(4), 8)
    covariances = estimate_covariances(cloud, neighbours=12)
    for i in range(0, len(cloud), 97):
        near = np.argsort(np.linalg.norm(cloud - cloud[i], axis=1), kind="stable")[:12]
        np.testing.assert_allclose(covariances[i], np.cov(cloud[near].T), atol=2e-6)


def test_sums_do_not_depend_on_guesses_or_threads():
    target, source = _clouds(0.4)
    T, near = np.eye(4), np.ascontiguousarray(se3.exp([0.0, 0.0, 0.02, 0.05, 0.0, 0.0]))
    more = (3, False, 0.8, 0.3, 0.01, 0.5, True, False)
    fresh = _core.Matcher(target, 0, source, 0).sums(T, *more, 1)
    used = _core.Matcher(target, 0, source, 0)
    used.sums(near, *more, 4)
    again = used.sums(T, *more, 4)
    assert all(np.asarray(a).tobytes() == np.asarray(b).tobytes() for a, b in zip(fresh, again, strict=True))


def test_two_sides_of_a_wall_are_two_walls():
    rng = np.random.default_rng(0)
    wall = scenes.patch(rng, (4, 0, 0), (0, 3, 0), (0, 0, 2), 2000).astype(np.float32)
    across = np.eye(4)
    across[0, 3] = 8.0  # the source's sensor stands behind the wall, 20 cm of which lie between its sides
    beyond = (wall + np.float32([0.2 - 8.0, 0, 0])).astype(np.float32)
    native = [_core.SurfaceCloud(c, 0.5, 2, 0.05, 6, 1) for c in (wall, beyond)]
    counts = [len(_core.Matcher(native[0], 0, native[1], 0).matches(across, 1, False, 1.0, 0.2, 0.01, 0.5, sided, 1))
              for sided in (False, True)]  # fmt: skip
    assert counts[0] > 50 and counts[1] == 0
    native[1] = _core.SurfaceCloud(np.ascontiguousarray(wall + np.float32([2, 0, 0])), 0.5, 2, 0.05, 6, 1)
    T = np.eye(4)
    T[0, 3] = -2.0
    assert len(_core.Matcher(native[0], 0, native[1], 0).matches(T, 1, False, 1.0, 0.2, 0.01, 0.5, True, 1)) > 50
