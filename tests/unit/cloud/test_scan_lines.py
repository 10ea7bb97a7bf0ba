"""Scan lines: by ring, by elevation, by order, by rows; doubles, gaps, and clouds that have none."""

from dataclasses import replace

import numpy as np
import pytest
from tests.reference.loam import lines_slowly

from heliograph import _core
from heliograph.cloud import LineRule, find_line_rule, scan_lines
from heliograph.config import FeatureConfig
from heliograph.errors import DataError

CONFIG = FeatureConfig()


def spinning(beams=16, columns=360, seed=0):
    """A spinning scanner in a room, column by column: points, times, rings."""
    rng = np.random.default_rng(seed)
    azimuth = np.pi - 2.0 * np.pi * np.arange(columns) / columns
    elevation = np.radians(np.linspace(-15.0, 15.0, beams))
    a, e = np.meshgrid(azimuth, elevation, indexing="ij")
    beam = np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], axis=-1)
    ranges = 1.0 / np.max(np.abs(beam) / [6.0, 4.0, 2.0], axis=-1) + 0.01 * rng.normal(size=a.shape)
    points = (beam * ranges[..., None]).reshape(-1, 3).astype(np.float32)
    times = np.repeat(np.arange(columns, dtype=np.int32) * 270_000, beams)
    return points, times, np.tile(np.arange(beams, dtype=np.uint16), columns)


def rosette(count=12_000, lines=6, seed=0):
    """A solid-state scanner's flower on a wall and a floor, its lasers taking turns."""
    t = np.arange(count) / count
    a = 0.6 * np.cos(40.0 * np.pi * t) * np.cos(2.0 * t) + 0.05 * (np.arange(count) % lines)
    e = 0.5 * np.cos(40.0 * np.pi * t) * np.sin(2.0 * t)
    beam = np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], axis=-1)
    ranges = 1.0 / np.max(np.abs(beam) / [8.0, 5.0, 2.0], axis=-1)
    return (beam * ranges[:, None]).astype(np.float32), (t * 1e8).astype(np.int32)


def sets(lines):
    return [lines.order[a:b].tolist() for a, b in zip(lines.starts[:-1], lines.starts[1:], strict=True)]


@pytest.mark.parametrize("timed", [True, False])
def test_lines_equal_the_slow_twin_whatever_the_order_of_the_message(timed):
    points, times, ring = spinning(beams=5, columns=40)
    points[7] = np.nan
    points[9] = 0.0
    shuffled = np.random.default_rng(1).permutation(len(points))
    times = times if timed else np.zeros_like(times)
    for order in (np.arange(len(points)), shuffled):
        found = scan_lines(points[order], times[order], ring[order], LineRule(kind="ring"), CONFIG)
        expected = lines_slowly(points[order].astype(np.float64), times[order], ring[order])
        assert sets(found) == expected
        assert sum(len(line) for line in expected) == len(points) - 2


def test_the_farthest_return_of_a_beam_stays():
    points, times, ring = spinning(beams=4, columns=50)
    nearer = (0.5 * points).astype(np.float32)
    both = np.concatenate([nearer, points])
    found = scan_lines(both, np.tile(times, 2), np.tile(ring, 2), LineRule(kind="ring"), CONFIG)
    assert found.doubles == len(points)
    assert sorted(found.order.tolist()) == list(range(len(points), 2 * len(points)))


@pytest.mark.parametrize(
    ("case", "kind"),
    [
        ("rings", "ring"),
        ("no rings", "elevation"),
        ("one ring", "elevation"),
        ("shuffled", "elevation"),
        ("flower", "order"),
    ],
)
def test_rule_follows_what_the_message_tells(case, kind):
    points, times, ring = spinning()
    if case == "no rings":
        ring = None
    elif case == "one ring":
        ring = np.zeros_like(ring)
    elif case == "shuffled":
        order = np.random.default_rng(1).permutation(len(points))
        points, times, ring = points[order], times[order], None
    elif case == "flower":
        (points, times), ring = rosette(), None
    rule = find_line_rule(points, times, ring, CONFIG)
    assert rule.kind == kind
    assert np.degrees(rule.step) < CONFIG.max_step_deg
    assert (ring is None) == ("no rings are told" in rule.why)
    assert len(scan_lines(points, times, ring, rule, CONFIG)) == (rule.stride if kind == "order" else 16)


def test_elevation_rows_are_the_rings():
    points, _, ring = spinning(beams=32)
    found = _core.elevation_rows(points, 0.01)
    assert found.discrete
    assert np.array_equal(found.rows, ring)


def test_clouds_that_no_lines_run_through_are_refused_in_one_line():
    rng = np.random.default_rng(0)
    points, times, ring = spinning()
    beam = rng.normal(size=(3000, 3))
    scattered = (10.0 * beam / np.linalg.norm(beam, axis=1, keepdims=True)).astype(np.float32)
    level = points * np.float32([1.0, 1.0, 0.0]) + np.float32([0.0, 0.0, 0.01])
    rare = replace(CONFIG, row_height_deg=0.1)
    cases = [
        (scattered, np.zeros(3000, np.int32), None, "follow no scan lines"),
        (level, times, ring, "single scan line"),
        (points[:500], times[:500], ring[:500], "500 points do not tell scan lines"),
    ]
    for cloud, at, rings, text in cases:
        with pytest.raises(DataError, match=text) as caught:
            find_line_rule(cloud, at, rings, rare)
        assert "\n" not in str(caught.value)
        assert "odometry" in str(caught.value)


def test_rings_that_vanish_are_named():
    points, times, _ = spinning()
    with pytest.raises(DataError, match="no rings although"):
        scan_lines(points, times, None, LineRule(kind="ring"), CONFIG)
