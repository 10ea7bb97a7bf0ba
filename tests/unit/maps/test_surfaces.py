"""The map without the traces of its grid: walls on a border are one sheet, and what is no plane stays as it is."""

import numpy as np
import pytest

from heliograph.lie import so3
from heliograph.maps import GlobalMap
from reference.maps import slow_surfaces

VOXEL, NOISE, THICKNESS = 0.1, 0.02, 0.02
UP = np.array([0.0, 0.0, 0.04])


def wall(rng, *, side=3.0, density=4000, noise=NOISE):
    """Points of a square about the origin, normal to z."""
    count = round(density * side * side)
    flat = rng.uniform(-side / 2.0, side / 2.0, (count, 2))
    return np.column_stack([flat, rng.normal(0.0, noise, count)])


def mapped(points):
    grown = GlobalMap(VOXEL)
    grown.insert(points.astype(np.float32), None, np.eye(4))
    return grown


def surfaces(points, **options):
    return mapped(points).surfaces(THICKNESS, **options)[0].astype(np.float64)


@pytest.mark.parametrize("turn", [(0, 0, 0), (0, 0, 0.3), (0.3, 0, 0), (0.5, 0.4, 0.3), (np.pi / 4, 0, 0)])
@pytest.mark.parametrize("offset", [0.0, 0.02, 0.05])
def test_surfaces_make_a_wall_one_sheet_wherever_the_grid_lies(rng, turn, offset):
    R = so3.exp(np.array(turn, dtype=np.float64))
    points = wall(rng) @ R.T + offset * R[:, 2]
    found = surfaces(points) @ R
    off = np.abs(found[:, 2] - offset)
    assert np.median(off) < 2e-3 and np.percentile(off, 95) < 8e-3 and np.mean(off > 0.03) < 5e-3
    assert 850 < len(found) < 1200  # of 900 squares of the voxel's edge
    everywhere = np.stack(np.meshgrid(*2 * [np.arange(-1.4, 1.41, 0.05)]), axis=-1).reshape(-1, 2)
    gaps = np.linalg.norm(found[:, None, :2] - everywhere, axis=2).min(axis=0)
    assert gaps.max() < 1.5 * VOXEL


def test_cells_alone_make_a_wall_on_a_border_two_sheets(rng):
    """What the surfaces mend, so that the test above is known to be able to fail."""
    means = mapped(wall(rng)).points()
    assert np.median(np.abs(means[:, 2])) > 0.012 and len(means) > 1700


def test_surfaces_keep_two_walls_apart(rng):
    lower, upper = wall(rng), wall(rng)
    found = surfaces(np.vstack([lower - UP, upper + UP]))
    off = np.abs(np.abs(found[:, 2]) - 0.04)
    assert np.percentile(off, 95) < 8e-3
    for sign in (-1.0, 1.0):
        assert 850 < np.sum(np.sign(found[:, 2]) == sign) < 1200


def test_surfaces_keep_a_faint_wall_in_front_of_a_dense_one(rng):
    """A tenth of the points, 8 cm off: noise does not throw so many so far."""
    found = surfaces(np.vstack([wall(rng) - UP, wall(rng, density=400) + UP]))
    assert np.sum(np.abs(found[:, 2] - 0.04) < 0.02) > 650
    assert np.sum(np.abs(found[:, 2] + 0.04) < 0.01) > 850


def test_surfaces_do_not_eat_corners(rng):
    """A corner of three walls on borders of the grid: on it, and up to the edges."""
    middle = np.array([1.0, 1.0, 0.0])
    faces = [np.roll(wall(rng, side=2.0) + middle, axis, axis=1) for axis in range(3)]
    found = surfaces(np.vstack(faces))
    off = np.abs(found).min(axis=1)
    assert np.median(off) < 2e-3 and np.percentile(off, 95) < 0.02
    along = np.linspace(0.05, 1.95, 39)
    for edge in np.eye(3):
        gaps = np.linalg.norm(found[:, None] - along[None, :, None] * edge, axis=2).min(axis=0)
        assert gaps.max() < 0.11


@pytest.mark.parametrize("radius", [0.03, 0.1])
def test_surfaces_leave_thin_poles_in_their_place(rng, radius):
    angle, z = rng.uniform(0, 2 * np.pi, 8000), rng.uniform(0.0, 2.0, 8000)
    grown = radius + rng.normal(0.0, 0.01, 8000)
    points = np.column_stack([0.5 + grown * np.cos(angle), 0.52 + grown * np.sin(angle), z])
    means, found = mapped(points).points(), surfaces(points)
    error = [np.abs(np.hypot(c[:, 0] - 0.5, c[:, 1] - 0.52) - radius).mean() for c in (means, found)]
    assert error[1] < error[0] + 3e-3
    for height in np.arange(0.1, 2.0, 0.1):
        assert np.abs(found[:, 2] - height).min() < 0.06
    assert np.ptp(found[:, 0]) > 0.6 * np.ptp(means[:, 0]) and np.ptp(found[:, 1]) > 0.6 * np.ptp(means[:, 1])


def test_surfaces_do_not_flatten_what_is_round(rng):
    radius, count = 0.6, 60_000
    direction = rng.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    found = surfaces(direction * (radius + rng.normal(0.0, 0.005, (count, 1))) + 0.03)
    off = np.linalg.norm(found - 0.03, axis=1) - radius
    assert abs(off.mean()) < 2e-3 and np.percentile(np.abs(off), 95) < 0.01


def test_surfaces_leave_single_points_as_they_are(rng):
    grown = GlobalMap(VOXEL)
    values = rng.uniform(0.0, 255.0, 300).astype(np.float32)
    grown.insert(rng.uniform(-20.0, 20.0, (300, 3)).astype(np.float32), values, np.eye(4))
    points, intensity = grown.surfaces(THICKNESS)
    np.testing.assert_array_equal(points, grown.points())
    np.testing.assert_array_equal(intensity, grown.intensity())


def test_surfaces_leave_four_points_that_lie_almost_in_a_plane(rng):
    four = np.array([[0.05, 0.05, 0.06], [0.15, 0.05, 0.04], [0.05, 0.15, 0.04], [0.15, 0.15, 0.06]], np.float32)
    grown = mapped(four)
    np.testing.assert_array_equal(grown.surfaces(THICKNESS)[0], grown.points())


def test_surfaces_leave_single_points_beside_a_wall(rng):
    lone = np.array([[0.33, 0.44, 0.15], [-0.71, 0.2, 0.31]])
    found = surfaces(np.vstack([wall(rng, density=20_000), lone]))
    for point in lone:
        assert np.linalg.norm(found - point, axis=1).min() < 1e-5


def test_surfaces_weigh_by_count_and_average_intensity(rng):
    points, grown = wall(rng), GlobalMap(VOXEL)
    values = np.where(points[:, 0] < 0.0, 10.0, 20.0).astype(np.float32)
    grown.insert(points.astype(np.float32), values, np.eye(4))
    found, intensity = grown.surfaces(THICKNESS)
    clear = np.abs(found[:, 0]) > 0.15
    np.testing.assert_allclose(intensity[clear], np.where(found[clear, 0] < 0.0, 10.0, 20.0), rtol=1e-5)


def test_surfaces_give_the_same_bits_at_any_number_of_threads(rng):
    grown = mapped(np.vstack([wall(rng, side=12.0, density=1500), rng.uniform(-6.0, 6.0, (20_000, 3))]))
    assert len(grown) > 3 * 8192
    one = grown.surfaces(THICKNESS)
    for threads in (2, 5):
        for a, b in zip(one, grown.surfaces(THICKNESS, threads=threads), strict=True):
            np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("seed", range(3))
def test_surfaces_equal_their_twin(seed):
    rng = np.random.default_rng(seed)
    R = so3.exp(rng.uniform(-1.0, 1.0, 3))
    scene = np.vstack([wall(rng) @ R.T, wall(rng, side=1.0) + 0.3, rng.uniform(-1.5, 1.5, (200, 3))])
    grown = mapped(scene)
    cells = grown.cells()
    expected = slow_surfaces(cells.cubes, (cells.cubes + 0.5) * VOXEL + cells.sums / cells.counts[:, None],
                             cells.counts, VOXEL, THICKNESS)  # fmt: skip
    found = grown.surfaces(THICKNESS)[0]
    assert len(found) == len(expected)
    # A cell on the edge of a gate may fall on either side of it.
    assert (np.abs(found - expected).max(axis=1) < 2e-5).mean() > 0.99


def test_surfaces_of_an_empty_map_are_empty():
    points, intensity = GlobalMap(VOXEL).surfaces(THICKNESS)
    assert points.shape == (0, 3) and intensity.shape == (0,)


def test_surfaces_give_the_index_back_and_the_map_grows_on(rng):
    points = wall(rng)
    grown, twice = mapped(points), mapped(points)
    before = grown.nbytes
    grown.surfaces(THICKNESS)
    assert grown.nbytes < before
    for cloud in (grown, twice):
        cloud.insert(points.astype(np.float32), None, np.eye(4))
    np.testing.assert_array_equal(grown.points(), twice.points())
    grown.surfaces(THICKNESS)
    for cloud in (grown, twice):
        cloud.merge(mapped(points).cells())
    np.testing.assert_array_equal(grown.counts(), twice.counts())
