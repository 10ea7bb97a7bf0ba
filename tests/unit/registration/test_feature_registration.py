"""Registration of features: sums against the slow twin, poses found, and directions that nothing tells."""

import numpy as np
import pytest
from tests.reference.loam import sums_slowly

from heliograph.config import FilterConfig, LoamConfig
from heliograph.lie import se3, so3
from heliograph.maps import FeatureMap, FeaturePoints
from heliograph.registration import FeatureNoise, SweepFeatures, register_features

CONFIG, FILTER = LoamConfig(), FilterConfig()
NOISE = FeatureNoise(edge=0.05, plane=0.03)


def room(rng, count=6000, ends=True, noise=0.01):
    """A corridor of 12 x 3 x 3 m with upright edges in its corners, or one without ends and edges."""
    u, v = rng.uniform(-1.0, 1.0, (2, count))
    side = rng.integers(0, 6 if ends else 4, count)
    half = np.array([6.0, 1.5, 1.5])
    axis, sign = np.array([1, 1, 2, 2, 0, 0])[side], np.where(side % 2 == 0, 1.0, -1.0)
    points = np.empty((count, 3))
    for k in range(3):
        other = [i for i in range(3) if i != k]
        on = axis == k
        points[on, k] = sign[on] * half[k]
        points[np.ix_(on, other)] = np.stack([u, v], axis=1)[on] * half[other]
    z = rng.uniform(-1.5, 1.5, 400)
    corners = np.array([[x, y] for x in (-6.0, 6.0) for y in (-1.5, 1.5)])[rng.integers(0, 4, 400)]
    edges = np.column_stack([corners, z])[: 400 if ends else 0]
    return FeaturePoints(
        edges=(edges + noise * rng.normal(size=edges.shape)).astype(np.float32),
        planes=(points + noise * rng.normal(size=points.shape)).astype(np.float32),
    )


def seen_from(points, T):
    back = se3.inverse(T)
    moved = [(p @ back[:3, :3].T + back[:3, 3]).astype(np.float32) for p in (points.edges, points.planes)]
    return FeaturePoints(edges=moved[0], planes=moved[1])


@pytest.fixture(scope="module")
def world():
    rng = np.random.default_rng(0)
    local_map = FeatureMap(CONFIG)
    for _ in range(4):
        local_map.insert(room(rng), np.eye(4))
    return local_map, room(rng, count=1200)


@pytest.mark.parametrize("edges", [True, False])
def test_sums_equal_the_slow_twin(world, edges):
    local_map, scan = world
    T = se3.exp(np.array([0.01, -0.02, 0.03, 0.05, -0.04, 0.03]))
    points = (scan.edges if edges else scan.planes)[:300]
    found = (local_map.edges if edges else local_map.planes).match(points, T, 0.03, 1)
    sums = found.sum(points, T, np.zeros(0, np.float32), 0.2, 0.1, 0.03, 1)
    rows = [(r[1:4], r[4:7], r[7], r[8]) if r[0] else None for r in found.table()]
    expected = sums_slowly(rows, points, T, edges=edges, gate=0.2, kernel=0.1, sigma=0.03)
    for got, want in zip((sums.information, sums.gradient, sums.feigned), expected, strict=True):
        np.testing.assert_allclose(got, want, rtol=1e-9, atol=1e-9 * np.abs(want).max())
    assert 0 < sums.matches <= sum(row is not None for row in rows)
    many = found.sum(points, T, np.zeros(0, np.float32), 0.2, 0.1, 0.03, 3)
    assert many.information.tobytes() == sums.information.tobytes()


def test_registration_finds_the_pose_from_a_decimetre_away(world):
    local_map, scan = world
    truth = se3.exp(np.array([0.02, -0.03, 0.4, 0.5, 0.2, -0.1]))
    start = truth @ se3.exp(np.array([0.01, -0.01, 0.02, 0.10, -0.08, 0.05]))
    found = register_features(
        local_map, seen_from(scan, truth), start, noise=NOISE, config=CONFIG, settings=FILTER, opening=0.3
    )
    error = se3.log(se3.inverse(truth) @ found.T_odom_body)
    assert found.converged
    assert np.linalg.norm(error[3:]) < 0.004
    assert np.linalg.norm(error[:3]) < 0.001
    assert found.seen.share.all()
    assert found.edges.matches > 100
    assert found.planes.matches > 700
    noise = NOISE.updated(found, FILTER)
    assert noise.plane < NOISE.plane


def test_a_direction_that_nothing_faces_stays_where_the_start_has_it():
    rng = np.random.default_rng(1)
    local_map = FeatureMap(CONFIG)
    for _ in range(4):
        local_map.insert(room(rng, ends=False), np.eye(4))
    scan = room(rng, count=1200, ends=False)
    inside = np.abs(scan.planes[:, 0]) < 4.0
    scan = FeaturePoints(edges=scan.edges, planes=scan.planes[inside])
    start = se3.exp(np.array([0.0, 0.01, 0.01, 0.20, 0.05, 0.04]))
    found = register_features(local_map, scan, start, noise=NOISE, config=CONFIG, settings=FILTER, opening=0.2)
    assert not found.seen.share.all()
    np.testing.assert_allclose(found.T_odom_body[1:3, 3], 0.0, atol=0.004)
    assert abs(found.T_odom_body[0, 3] - 0.20) < 0.02


def test_nothing_to_match_moves_nothing():
    found = register_features(
        FeatureMap(CONFIG),
        room(np.random.default_rng(2), count=50),
        np.eye(4),
        noise=NOISE,
        config=CONFIG,
        settings=FILTER,
    )
    np.testing.assert_array_equal(found.T_odom_body, np.eye(4))
    assert found.sums.matches == 0
    assert not found.seen.share.any()


@pytest.mark.parametrize("edges", [True, False])
def test_a_point_that_goes_along_in_part_counts_in_part(world, edges):
    local_map, scan = world
    T, points = np.eye(4), (scan.edges if edges else scan.planes)[:40]
    shares = np.linspace(0.0, 1.0, len(points), dtype=np.float32)
    kind = local_map.edges if edges else local_map.planes
    sums = kind.match(points, T, 0.03, 1).sum(points, T, shares, 0.2, 0.1, 0.03, 1)
    one_by_one = [
        kind.match(p, T, 0.03, 1).sum(p, T, np.zeros(0, np.float32), 0.2, 0.1, 0.03, 1) for p in points[:, None]
    ]
    assert sums.matches == sum(one.matches for one in one_by_one) > 20
    for name, power in (("information", 2), ("feigned", 2), ("gradient", 1)):
        expected = sum(float(s) ** power * getattr(one, name) for s, one in zip(shares, one_by_one, strict=True))
        assert np.allclose(getattr(sums, name), expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


def test_the_columns_of_motion_are_what_velocity_and_bias_do_to_the_points(world):
    local_map, scan = world
    seconds = tuple(np.linspace(0.1, 0.0, len(p), dtype=np.float32) for p in (scan.edges, scan.planes))

    def swept(v, bias):
        moved = [
            np.einsum("nij,nj->ni", so3.exp(t[:, None] * bias), p) - t[:, None] * v
            for t, p in zip(seconds, (scan.edges, scan.planes), strict=True)
        ]
        return FeaturePoints(edges=moved[0].astype(np.float32), planes=moved[1].astype(np.float32))

    features = SweepFeatures(local_map, seconds, noise=NOISE, config=CONFIG, settings=FILTER)
    zero, v, bias = np.zeros(3), np.array([0.05, -0.04, 0.03]), np.array([-0.01, 0.02, 0.015])
    at_rest = features.sums(swept(zero, zero), np.eye(4), 1e3)[2]
    moving = features.sums(swept(v, bias), np.eye(4), 1e3)[2]
    assert at_rest.blocks == ("pose", "motion") and at_rest.information.shape == (12, 12)
    change = at_rest.information[:, 6:] @ np.concatenate([v, bias])
    assert np.linalg.norm(moving.gradient - at_rest.gradient - change) < 0.02 * np.linalg.norm(change)
