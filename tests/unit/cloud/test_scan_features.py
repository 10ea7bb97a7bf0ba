"""Features: the native loop against its slow twin, corners found, unfit points left out, quotas kept."""

from dataclasses import replace

import numpy as np
import pytest
from tests.reference.loam import features_slowly

from heliograph.cloud import LineRule, scan_features, scan_lines
from heliograph.config import FeatureConfig

CONFIG = FeatureConfig(region=60)


def room_line(columns=720, seed=0, noise=0.005, height=0.3):
    """One level line of a room of 12 x 8 m with a pillar of half a metre in it, as points and the walls' corners."""
    rng = np.random.default_rng(seed)
    a = np.pi - 2.0 * np.pi * np.arange(columns) / columns
    beam = np.stack([np.cos(a), np.sin(a), np.full(columns, height)], axis=-1)
    ranges = 1.0 / np.max(np.abs(beam[:, :2]) / [6.0, 4.0], axis=-1)
    pillar = np.abs(np.angle(np.exp(1j * (a - 0.3)))) < 0.1
    ranges[pillar] = 2.5
    points = (beam * (ranges + noise * rng.normal(size=columns))[:, None]).astype(np.float32)
    return points, np.flatnonzero(pillar)


def lines_of(points):
    return scan_lines(
        points, np.arange(len(points), dtype=np.int32), np.zeros(len(points), np.uint16), LineRule(kind="ring"), CONFIG
    )


@pytest.mark.parametrize("config", [CONFIG, replace(CONFIG, window=3, edges=4, planes=2, map_stride=1, map_edges=3)])
def test_features_equal_the_slow_twin(config):
    points, _ = room_line(noise=0.02)
    points = np.delete(points, np.arange(100, 140), axis=0)
    found = scan_features(points, lines_of(points), config)
    expected = features_slowly(points.astype(np.float64), config)
    for name, places in zip(("edges", "planes", "map_edges", "map_planes"), expected, strict=True):
        assert getattr(found, name).tolist() == places, name
    assert len(found) == len(found.edges) + len(found.planes)


def test_corners_and_rims_are_edges_and_walls_are_planes():
    points, pillar = room_line()
    found = scan_features(points, lines_of(points), CONFIG)
    corners = np.array([[x, y, 0.0] for x in (-6.0, 6.0) for y in (-4.0, 4.0)])
    at = points[found.map_edges] * np.float32([1.0, 1.0, 0.0])
    reach = np.linalg.norm(at[:, None] - corners, axis=2).min(axis=0)
    assert (reach < 0.1).all()
    assert {pillar[0], pillar[-1]} <= set(found.map_edges.tolist())
    to_wall = np.minimum(np.abs(np.abs(points[:, 0]) - 6.0), np.abs(np.abs(points[:, 1]) - 4.0))
    assert (to_wall[np.setdiff1d(found.map_planes, pillar)] < 0.05).all()


def test_what_a_nearer_surface_hides_is_left_out():
    points, pillar = room_line()
    found = scan_features(points, lines_of(points), CONFIG)
    hidden = [*range(pillar[0] - CONFIG.window, pillar[0]), *range(pillar[-1] + 1, pillar[-1] + 1 + CONFIG.window)]
    everything = np.concatenate([found.edges, found.planes, found.map_edges, found.map_planes])
    assert not set(hidden) & set(everything.tolist())


def test_surfaces_along_the_beam_are_left_out():
    points, _ = room_line()
    ranges = np.linalg.norm(points, axis=1)
    points[200:240] *= (1.0 - 0.2 * (np.arange(40) % 2) * 0.25).astype(np.float32)[:, None]  # 5 % back and forth
    assert ranges.min() > 2.0
    found = scan_features(points, lines_of(points), CONFIG)
    assert not set(range(201, 239)) & {*found.planes.tolist(), *found.edges.tolist()}


def test_uneven_steps_along_a_wall_are_no_corner():
    x = np.cumsum(np.linspace(0.02, 0.2, 80))
    wall = np.stack([x, np.full(80, 2.0), np.zeros(80)], axis=1).astype(np.float32)
    found = scan_features(wall, lines_of(wall), replace(CONFIG, range_noise=0.001, gap=5.0, grazing=1.0))
    assert len(found.map_edges) == 0
    assert len(found.planes) > 0


def test_quotas_hold_in_every_region_and_neighbours_keep_apart():
    points, _ = room_line(noise=0.02)
    found = scan_features(points, lines_of(points), CONFIG)
    region = len(points) // 12
    for picked, most in ((found.edges, CONFIG.edges), (found.planes, CONFIG.planes)):
        assert np.bincount(picked // region, minlength=12).max() <= most
    together = np.sort(np.concatenate([found.map_edges, found.planes]))
    assert np.diff(together).min() > CONFIG.window
    assert set(found.edges.tolist()) <= set(found.map_edges.tolist())


def test_features_do_not_depend_on_threads():
    points = np.concatenate([room_line(seed=k, height=0.1 * k)[0] for k in range(6)])
    rows = np.repeat(np.arange(6, dtype=np.uint16), 720)
    lines = scan_lines(points, np.tile(np.arange(720, dtype=np.int32), 6), rows, LineRule(kind="ring"), CONFIG)
    one, three = (scan_features(points, lines, CONFIG, threads=n) for n in (1, 3))
    assert one.edges.tolist() == three.edges.tolist()
    assert one.map_planes.tolist() == three.map_planes.tolist()
