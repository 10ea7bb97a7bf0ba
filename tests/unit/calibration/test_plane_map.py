"""The map of a calibration: walls in the faces of cubes, and edges."""

from dataclasses import replace

import numpy as np
import pytest

from heliograph.calibration.plane_map import PlaneMap, turn_against
from heliograph.config import MapConfig
from heliograph.lie import se3, so3
from heliograph.maps import VoxelMap
from heliograph.registration import MatchSettings

WALLS = np.array([[8.0, 6.0, 3.0], [-4.0, -3.0, -1.5]])  # extent and least corner: every wall lies in faces of cubes
AXES = (np.eye(3), np.ones(3))
SETTINGS = MatchSettings(gate=0.15, kernel=0.06, sigma=0.02, fallback_stride=0)


def room(rng, count, noise):
    """Return points (count, 3) on the six sides of a box, each off its side by noise."""
    points = WALLS[1] + WALLS[0] * rng.random((count, 3))
    side = rng.integers(0, 6, count)
    rows, axis = np.arange(count), side % 3
    points[rows, axis] = WALLS[1, axis] + np.where(side < 3, 0.0, WALLS[0, axis]) + noise * rng.standard_normal(count)
    return points.astype(np.float32)


def mapped(R_cubes_odom, noise, scans=30):
    plane_map, rng = PlaneMap(MapConfig(), R_cubes_odom), np.random.default_rng(1)
    for _ in range(scans):
        plane_map.insert(room(rng, 4000, noise), np.eye(4))
    return plane_map


def placed(plane_map, points, T, steps):
    for _ in range(steps):
        information, gradient, _ = plane_map.linearize(points, T, SETTINGS)
        step = -np.linalg.solve(information, gradient)
        T = se3.from_rotation_translation(T[:3, :3] @ so3.exp(step[:3]), T[:3, 3] + T[:3, :3] @ step[3:])
    return T


def left_of_a_step(R_cubes_odom):
    """Return the share of a small error that is left after the steps of a placement."""
    plane_map = mapped(R_cubes_odom, 0.02)
    points = (room(np.random.default_rng(2), 2500, 0.02),) * len(R_cubes_odom)
    off = se3.exp(np.array([2e-4, -2e-4, 2e-4, 1e-3, 1e-3, -1e-3]))
    ends = [placed(plane_map, points, T, 6) for T in (np.eye(4), off)]
    return np.linalg.norm(se3.log(np.linalg.inv(ends[0]) @ ends[1])) / np.linalg.norm(se3.log(off))


def test_walls_in_the_faces_of_cubes_do_not_hold_a_scan_where_it_was():
    assert left_of_a_step(turn_against(*AXES, 2)) < 0.02
    assert left_of_a_step(np.eye(3)[None]) > 0.1  # what is mended


def test_planes_of_cubes_at_edges_are_left_out():
    plane_map, points = mapped(turn_against(*AXES, 1), 0.0), room(np.random.default_rng(3), 6000, 0.0)

    def distance(some):  # of each point to the nearest edge
        return np.sort(np.minimum(some - WALLS[1], WALLS[1] + WALLS[0] - some), axis=1)[:, 1]

    kept = points[plane_map.agreeing_points(points, np.eye(4), 0.15)[0]]
    assert 0.5 < len(kept) / len(points) < 0.95
    assert np.mean(distance(kept) < 0.1) < 0.3 * np.mean(distance(points) < 0.1)


def test_several_sets_of_cubes_average_what_is_left():
    sets = turn_against(*AXES, 6)
    clouds = [room(np.random.default_rng(seed), 2500, 0.0) for seed in range(20, 32)]

    def errors(some):  # of clouds without noise, which a perfect map would leave where they are
        plane_map = mapped(some, 0.02, scans=10)
        return [np.linalg.norm(se3.log(placed(plane_map, (cloud,) * len(some), np.eye(4), 6))) for cloud in clouds]

    single = np.mean([errors(sets[k : k + 1]) for k in range(6)])
    assert np.mean(errors(sets)) < 0.8 * single


def test_all_points_are_used_where_planes_of_two_sizes_are_too_few():
    plane_map, rng = PlaneMap(MapConfig(), np.eye(3)[None]), np.random.default_rng(4)
    strip = np.stack([rng.uniform(0.0, 0.2, 3000), rng.uniform(0.0, 0.24, 3000), np.full(3000, 0.12)], axis=1)
    rail = np.stack([np.full(3000, 0.24), rng.uniform(0.0, 0.24, 3000), rng.uniform(-0.2, 0.2, 3000)], axis=1)
    points = np.concatenate([strip, rail]).astype(np.float32)
    plane_map.insert(points, np.eye(4))
    assert plane_map.agreeing_points(points, np.eye(4), 0.15)[0].all()


def test_equations_are_those_of_turns_and_shifts_along_lidar_axes():
    points = room(np.random.default_rng(5), 3000, 0.0)
    points = points[np.sort(np.minimum(points - WALLS[1], WALLS[1] + WALLS[0] - points), axis=1)[:, 1] > 0.7]
    sets = turn_against(*AXES, 3)
    T_room = se3.exp(np.array([0.3, -0.2, 1.0, 0.4, -0.1, 0.2]))  # the lidar's pose
    body = ((points - T_room[:3, 3]) @ T_room[:3, :3]).astype(np.float32)
    plane_map = mapped(sets, 0.0)
    d = 1e-4 * np.array([1.0, -2.0, 0.5, 10.0, 5.0, -8.0])
    T = se3.from_rotation_translation(T_room[:3, :3] @ so3.exp(d[:3]), T_room[:3, 3] + T_room[:3, :3] @ d[3:])
    information, gradient, matches = plane_map.linearize((body,) * 3, T, SETTINGS)
    np.testing.assert_allclose(np.linalg.solve(information, gradient), d, atol=0.02 * np.abs(d).max())
    assert 0.8 * len(points) < matches <= len(points)


@pytest.mark.parametrize("seed", range(4))
def test_cubes_are_turned_against_walls_of_any_attitude(seed):
    R_odom_walls = so3.exp(np.random.default_rng(seed).uniform(-np.pi, np.pi, 3))
    normals = np.concatenate([R_odom_walls.T, -R_odom_walls.T])
    for R in turn_against(normals, np.array([3.0, 2.0, 1.0] * 2), 3):
        np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
        assert np.abs(normals @ R.T).max() < 0.93  # 21 degrees from every face


FLOOR = 0.12  # in the middle of cubes


def swept(rng, count, noise, height):
    """Return points (count, 3) of a floor as seen from above it, each off along its own beam."""
    beam = rng.standard_normal((count, 3)) * [1.0, 1.0, 0.4]
    beam[:, 2] = -np.abs(beam[:, 2])
    beam = (beam / np.linalg.norm(beam, axis=1)[:, None])[beam[:, 2] < -0.3 * np.linalg.norm(beam[:, :2], axis=1)]
    ranges = -height / beam[:, 2] + noise * rng.standard_normal(len(beam))
    return (beam * ranges[:, None]).astype(np.float32)


def floor_found(scans, T):
    """Return the height above the floor of the planes that a map finds (K,), and how many points each has (K,)."""
    voxels = VoxelMap(replace(MapConfig(), max_points=1_000_000))
    for scan in scans:
        voxels.insert(scan, T)
    table = voxels.table()
    planes = table[(table[:, 0] == table[:, 0].min()) & (table[:, 11] >= 0.0)]
    return planes[:, 10] - FLOOR, planes[:, 1]


def test_noise_along_the_beams_lies_behind_a_surface_until_it_is_laid_across():
    rng, height = np.random.default_rng(6), 1.0
    T = se3.exp(np.array([0.05, -0.02, 0.4, 0.3, 0.1, 0.0]))
    T[2, 3] = FLOOR + height
    level = se3.from_rotation_translation(np.eye(3), T[:3, 3])
    turn = (np.linalg.inv(T) @ level)[:3, :3]
    scans = [(swept(rng, 8000, 0.04, height) @ turn.T).astype(np.float32) for _ in range(40)]
    plane_map = PlaneMap(MapConfig(), np.eye(3)[None])
    for scan in scans:
        plane_map.insert(scan, T)
    before, weight = floor_found(scans, T)
    across = [plane_map.across_planes(scan, T, 0.3) for scan in scans]
    after, also = floor_found(across, T)
    behind, mended = np.average(before, weights=weight), np.average(after, weights=also)
    assert behind < -7e-5
    assert abs(mended) < 0.5 * abs(behind)


def test_laying_across_keeps_the_distance_and_the_beam_and_leaves_what_is_no_noise():
    rng = np.random.default_rng(7)
    plane_map = PlaneMap(MapConfig(), np.eye(3)[None])
    flat = np.stack([*rng.uniform(-3.0, 3.0, (2, 40_000)), np.full(40_000, -0.9)], axis=1).astype(np.float32)
    plane_map.insert(flat, np.eye(4))
    feet = np.stack([*rng.uniform(-2.9, 2.9, (2, 500)), np.full(500, -0.9)], axis=1)
    length = np.linalg.norm(feet, axis=1)
    along = rng.uniform(-0.1, 0.1, 500)
    moved = plane_map.across_planes((feet * (1.0 + along / length)[:, None]).astype(np.float32), np.eye(4), 0.15)
    expected = feet.copy()
    expected[:, 2] -= along * 0.9 / length
    np.testing.assert_allclose(moved, expected, atol=1e-5)
    stray = (feet * (1.0 + 0.2 / length)[:, None]).astype(np.float32)  # beyond the gate along the beam, not across
    np.testing.assert_array_equal(plane_map.across_planes(stray, np.eye(4), 0.15), stray)
    nowhere = np.array([[50.0, 0.0, 0.0], [0.0, 0.0, 0.0]], np.float32)
    np.testing.assert_array_equal(plane_map.across_planes(nowhere, np.eye(4), 0.15), nowhere)
