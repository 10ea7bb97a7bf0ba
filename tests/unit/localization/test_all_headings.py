"""Correlation at every heading places what saw only a part of its surroundings."""

from dataclasses import replace

import numpy as np
import pytest
from kidnapped import saved_map, walk, woken

from heliograph.config import LocalizationConfig
from heliograph.lie import se3, so3
from heliograph.localization import Query, search
from heliograph.localization.all_headings import HeadingSearch
from heliograph.localization.recent_scans import level_frame
from heliograph.localization.search import _looked_through
from heliograph.slam.loops.tangent import near

HALF_VIEW = np.radians(40.0)


def walls(rng, count=4000):
    """Return points of three walls and some pillars of a yard."""
    along, up = rng.uniform(0.0, 1.0, (2, count))
    some = [
        np.column_stack([np.full(count, 9.0), 20.0 * along - 8.0, 4.0 * up - 1.2]),
        np.column_stack([17.0 * along - 8.0, np.full(count, 12.0), 3.0 * up - 1.2]),
        np.column_stack([-6.0 + 0.3 * along, 9.0 * along - 8.0, 2.5 * up - 1.2]),
    ]
    for x, y in np.random.default_rng(1).uniform(-11.0, 11.0, (14, 2)):
        some.append(np.column_stack([x + 0.4 * along[:200], y + 0.4 * up[:200], 3.0 * rng.uniform(size=200) - 1.2]))
    return np.concatenate(some).astype(np.float32)


def ahead(points, half_view=HALF_VIEW):
    """Return what a narrow field of view shows of points around."""
    return np.ascontiguousarray(points[np.abs(np.arctan2(points[:, 1], points[:, 0])) < half_view])


@pytest.mark.parametrize("heading", [-2.5, -0.7, 0.0, 1.1, 3.0])
def test_narrow_view_is_placed_at_any_heading(heading):
    rng = np.random.default_rng(5)
    T = se3.from_rotation_translation(so3.from_rpy(0.0, 0.0, heading), np.array([1.3, -2.2, 0.0]))
    yard = walls(rng)
    query = ahead(se3.act(se3.inverse(T), walls(rng).astype(float)).astype(np.float32), np.radians(60.0))
    places = list(HeadingSearch([yard[:50], yard]).places(query, [1]))
    assert 1 <= len(places) <= 4
    assert {index for index, _ in places} == {1}
    assert any(near(guess, T, 1.6, 12.0) for _, guess in places)


def test_height_of_the_query_is_found():
    yard = walls(np.random.default_rng(6))
    raised = yard + np.float32([0.0, 0.0, -1.5])  # seen from higher up
    z = {round(float(T[2, 3]), 2) for _, T in HeadingSearch([yard]).places(raised, [0])}
    assert z == {1.5}


@pytest.mark.parametrize("points", [np.zeros((0, 3)), np.full((40, 3), 500.0), np.zeros((40, 3))])
def test_nothing_upright_has_no_place(points):
    some = HeadingSearch([walls(np.random.default_rng(7))])
    assert list(some.places(points.astype(np.float32), [0])) == []
    assert all(np.isfinite(T).all() for _, T in HeadingSearch([points.astype(np.float32)]).places(some._clouds[0], [0]))


def test_every_submap_of_a_large_map_gets_its_turn():
    config = LocalizationConfig(headings=6)
    asked = [_looked_through([4, 9, 9, 2, 7], 20, config, number) for number in range(8)]
    assert all(chosen[:3] == [4, 9, 2] and len(set(chosen)) == 6 for chosen in asked)
    assert set().union(*asked) == set(range(20))
    assert sorted(_looked_through([1], 3, config, 5)) == [0, 1, 2]
    assert _looked_through([1], 3, replace(config, headings=0), 5) == []


def test_narrow_query_is_found_where_the_detector_alone_fails():
    """What the detector ranks by does not change under turns and shifts, and does by half of what is seen."""
    saved, some = saved_map(), walk()
    found = {0: 0, 24: 0}
    for first in range(42, 60):
        clouds = [ahead(some.keyframes[first].points_imu)]
        result = woken(first, 1, clouds=clouds)[0][0]
        T_odom_level = level_frame(result.T_odom_imu)
        points = se3.act(se3.inverse(T_odom_level) @ result.T_odom_imu, clouds[0].astype(float)).astype(np.float32)
        T_true = some.T_true[first] @ se3.inverse(result.T_odom_imu) @ T_odom_level
        for headings in found:
            config = LocalizationConfig(headings=headings)
            places = search(Query.of(points, saved, config), saved, config)
            found[headings] += bool(places) and near(places[0].T_map_level, T_true, 0.3, 3.0)
    assert found[24] >= max(found[0] + 3, 15), found
