"""Alignment without a start: poses found from features, and refusals where the evidence does not suffice."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from tests import scenes
from tests.reference.features import point_features
from tests.reference.range_image import sight

from heliograph import _core
from heliograph.config import GlobalAlignConfig
from heliograph.errors import ConfigError
from heliograph.lie import se3, so3
from heliograph.registration import align
from heliograph.registration.global_alignment import truncated_pose
from heliograph.registration.global_evidence import GlobalEvidence, log_odds


@pytest.mark.parametrize("seed", range(4))
def test_global_alignment_finds_any_pose(seed):
    rng = np.random.default_rng(seed)
    truth = scenes.random_motion(rng, 1.2, rng.uniform(0.0, np.pi))
    result = align(scenes.corner_room(rng), scenes.moved(scenes.corner_room(rng), truth), start="global")
    assert result.status == "converged", result.reason
    assert np.linalg.norm(se3.log(se3.inverse(truth) @ result.T_target_source)) < 5e-3
    assert result.seconds["start"] > 0.0


def test_global_alignment_refuses_what_looks_the_same_turned_round():
    rng = np.random.default_rng(0)
    walls = [((x, 0, 0), (0, 3, 0), (0, 0, 1.5)) for x in (-4, 4)] + [
        ((0, y, 0), (4, 0, 0), (0, 0, 1.5)) for y in (-3, 3)
    ]
    clouds = [np.concatenate([scenes.patch(rng, *w, 1500) for w in walls]).astype(np.float32) for _ in range(2)]
    result = align(clouds[0], scenes.moved(clouds[1], scenes.random_motion(rng, 1.0, 2.0)), start="global")
    assert result.status == "refused" and result.T_target_source is None and result.reason


def test_global_alignment_refuses_another_place():
    rng = np.random.default_rng(0)
    ball = np.concatenate([scenes.sphere(rng, 4000, 0.01, centre=(2, 1, 0), radius=r) for r in (1.0, 4.0)])
    result = align(scenes.corner_room(rng), ball.astype(np.float32), start="global")
    assert result.status == "refused" and result.T_target_source is None


EVIDENCE = GlobalEvidence(
    overlap=0.6, fit=0.45, confirmed=0.93, seen_through=0.001, lead=1.5, weakest=0.05, elements=3000
)


@pytest.mark.parametrize(
    ("name", "worse"),
    [("overlap", 0.2), ("fit", 0.1), ("confirmed", 0.6), ("seen_through", 0.1), ("lead", 1.0), ("weakest", 0.001)],
)
def test_odds_fall_with_each_kind_of_evidence(name, worse):
    assert log_odds(EVIDENCE) > np.log(GlobalAlignConfig().min_odds)
    assert log_odds(replace(EVIDENCE, **{name: worse})) < log_odds(EVIDENCE) - 0.5


def test_a_pose_that_is_seen_through_is_refused_however_well_it_fits():
    splendid = replace(EVIDENCE, overlap=0.95, fit=0.9, confirmed=1.0, lead=np.inf, weakest=0.2)
    assert log_odds(replace(splendid, seen_through=0.15)) < np.log(GlobalAlignConfig().min_odds)


def test_start_is_a_pose_or_global():
    cloud = scenes.corner_room(np.random.default_rng(0))
    with pytest.raises(ConfigError, match="neither a pose nor 'global'"):
        align(cloud, cloud, start="anywhere")


def test_global_alignment_does_not_depend_on_threads():
    rng = np.random.default_rng(0)
    target, source = scenes.corner_room(rng), scenes.moved(scenes.corner_room(rng), scenes.random_motion(rng, 1.2, 2.0))
    one, many = (align(target, source, start="global", threads=t) for t in (1, 4))
    assert one.T_target_source.tobytes() == many.T_target_source.tobytes()


def test_features_agree_with_the_twin():
    cloud = scenes.corner_room(np.random.default_rng(0), 20)
    native = _core.SurfaceCloud(cloud, 0.6, 2, 0.05, 6, 1)
    mean, _, axes, *_ = native.elements(0)
    found = np.asarray(_core.point_features(native, 0, 1.5, 3))
    wanted = point_features(np.asarray(mean), np.asarray(axes)[:, 0], 1.5)
    # A share on the edge between two bins may fall into either.
    assert np.quantile(np.abs(found - wanted).max(axis=1), 0.95) < 1.0


def test_sight_agrees_with_the_twin():
    rng = np.random.default_rng(4)
    target, source = scenes.corner_room(rng, 20), scenes.corner_room(rng, 20)
    a, b = (_core.SurfaceCloud(cloud, 0.25, 1, 0.05, 6, 1) for cloud in (target, source))
    to, elements = (np.asarray(c.elements(0)[0]) for c in (a, b))
    cell = np.radians(5.0)
    image = _core.RangeImage(target, cell)
    for off in ([0.0] * 6, [0.0, 0.0, 0.6, 1.2, 0.5, 0.1], [0.3, 0.2, 2.0, -1.0, 0.4, 0.3]):
        T = se3.exp(off)
        found = [image.sight(a, b, 0, T, 0.3, threads) for threads in (1, 3)]
        wanted = sight(target, cell, to, elements, T, 0.3)
        # A place on the edge between two cells, or exactly as far as asked, may fall to either side.
        assert found[0] == found[1] and np.abs(np.subtract(found[0], wanted)).max() <= 2
    assert wanted[2] > 100


def test_nearest_features_agree_with_numpy():
    rng = np.random.default_rng(0)
    a, b = (rng.normal(size=(n, 33)).astype(np.float32) for n in (50, 70))
    found = np.asarray(_core.nearest_features(a, b, 4, 2))
    distance = ((a[:, None].astype(np.float64) - b[None]) ** 2).sum(axis=2)
    np.testing.assert_array_equal(found, np.argsort(distance, axis=1)[:, :4])
    assert (np.asarray(_core.nearest_features(a, b[:2], 4, 1))[:, 2:] == -1).all()


def test_consistent_sets_are_cliques_and_hold_the_truth():
    rng = np.random.default_rng(1)
    T = scenes.random_motion(rng, 3.0, 1.0)
    p = rng.uniform(-10, 10, (120, 3))
    n = rng.normal(size=(120, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    q, m = se3.act(T, p), n @ T[:3, :3].T
    wrong = rng.permutation(120)[:80]
    q[wrong], m[wrong] = rng.uniform(-10, 10, (80, 3)), np.roll(m[wrong], 1, axis=0)
    p, q, n, m = (np.ascontiguousarray(x, dtype=np.float32) for x in (p, q, n, m))
    sets = _core.consistent_sets(p, q, n, m, 0.1, 0.1, 10, 2)
    assert set(np.delete(np.arange(120), wrong)) <= set(sets[0].tolist())
    for i, j in itertools.combinations(sets[0].tolist(), 2):
        assert abs(np.linalg.norm(p[i] - p[j]) - np.linalg.norm(q[i] - q[j])) <= 0.1 + 1e-5
    assert [len(s) for s in sets] == sorted((len(s) for s in sets), reverse=True)


@pytest.mark.parametrize("share", [0.0, 0.3, 0.6])
def test_truncated_pose_leaves_outliers_out(share):
    rng = np.random.default_rng(2)
    T = scenes.random_motion(rng, 5.0, 2.0)
    p = rng.uniform(-5, 5, (100, 3))
    q = se3.act(T, p) + 0.01 * rng.normal(size=p.shape)
    count = int(100 * share)
    q[:count] = rng.uniform(-5, 5, (count, 3))
    found, inliers = truncated_pose(p.astype(np.float32), q.astype(np.float32), 0.1)
    assert np.linalg.norm(se3.log(se3.inverse(T) @ found)) < 0.02
    assert inliers[count:].all() and inliers[:count].sum() <= 2
    assert np.allclose(found[:3, :3] @ found[:3, :3].T, np.eye(3)) and so3.log(found[:3, :3]).shape == (3,)
