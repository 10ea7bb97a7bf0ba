"""Tiles: the same map as at once, however often it went to disk, and wherever it lies."""

import tracemalloc

import numpy as np
import pytest

from heliograph.maps import GlobalMap, MapCells, split_tiles
from heliograph.output import tiles as tiles_module
from heliograph.output.tiles import MapTiles

VOXEL = 0.2


def submap(rng, *, centre=(0.0, 0.0, 0.0), points=6000):
    """Cells of a floor and a wall about a place, with noise."""
    p = rng.uniform(-9.0, 9.0, (points, 3))
    p[: points // 2, 2] = rng.normal(0.0, 0.02, points // 2)
    p[points // 2 :, 1] = rng.normal(2.0, 0.02, points - points // 2)
    T = np.eye(4)
    T[:3, 3] = centre
    part = GlobalMap(VOXEL)
    part.insert(p.astype(np.float32), rng.uniform(0, 9, points).astype(np.float32), T)
    return part.cells()


def in_tiles(folder, parts, thickness):
    tiles = MapTiles(folder, VOXEL)
    for number, cells in enumerate(parts):
        tiles.add(cells, number)
    found = [tile.own(tile.whole.averaged(thickness)) for tile in tiles]
    tiles.close()
    rows = [np.column_stack([f.points, f.intensity, f.first]) for f in found]
    return np.concatenate(rows), len(found)


@pytest.mark.parametrize("thickness", [0.0, 0.02])
@pytest.mark.parametrize("room", [10**9, 2000])
def test_tiles_give_the_map_that_all_at_once_gives(tmp_path, monkeypatch, thickness, room):
    monkeypatch.setattr(tiles_module, "_EDGE", 32)
    monkeypatch.setattr(tiles_module, "_ROOM", room)
    rng = np.random.default_rng(3)
    parts = [submap(rng, centre=(4.0 * k, 0.0, 0.0)) for k in range(5)]
    rows, count = in_tiles(tmp_path, parts, thickness)
    whole = GlobalMap(VOXEL)
    for number, cells in enumerate(parts):
        whole.merge(cells, visit=number)
    at_once = whole.averaged(thickness)
    expected = np.column_stack([at_once.points, at_once.intensity, at_once.first])
    assert count > 20 and len(rows) == len(expected)
    order, expected_order = np.lexsort(rows.T), np.lexsort(expected.T)
    assert rows[order].tobytes() == expected[expected_order].tobytes()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("kilometres", [60.0, 200.0, -3000.0])
def test_tiles_do_not_fold_far_away(tmp_path, kilometres):
    """A road of two places: each comes back where it was put, to the millimetre, and once."""
    rng = np.random.default_rng(4)
    far = (1e3 * kilometres, -1e3 * kilometres, 40.0)
    near, there = submap(rng, points=800), submap(rng, centre=far, points=800)
    rows, _ = in_tiles(tmp_path, [near, there], 0.0)
    means = [cells_means(cells) for cells in (near, there)]
    assert len(rows) == sum(map(len, means))
    expected = np.concatenate(means)
    got, wanted = rows[np.lexsort(rows[:, :3].T), :3], expected[np.lexsort(expected.T)]
    np.testing.assert_allclose(got, wanted, atol=1e-6)


def cells_means(cells):
    return (cells.cubes + 0.5) * VOXEL + cells.sums / cells.counts[:, None]


def test_tiles_take_24_bytes_a_cell():
    assert tiles_module._CELL.itemsize <= 25


def test_cells_that_wait_for_their_tile_do_not_fill_memory(tmp_path):
    parts = [submap(np.random.default_rng(seed), centre=(20.0 * seed, 0.0, 0.0), points=60_000) for seed in range(8)]
    tiles, count = MapTiles(tmp_path, VOXEL), 0
    tracemalloc.start()
    for number in range(80):
        tiles.add(parts[number % len(parts)], number)
        count += len(parts[number % len(parts)])
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    tiles.close()
    assert count * 24 > 2 * 24e6  # what they take in memory or on disk [bytes]
    assert peak < 16e6


def test_tiles_where_the_disk_is_full_stay_in_memory(tmp_path, monkeypatch, full_disk):
    monkeypatch.setattr(tiles_module, "_ROOM", 1000)
    rng = np.random.default_rng(5)
    parts = [submap(rng, centre=(4.0 * k, 0.0, 0.0)) for k in range(3)]
    with full_disk(20_000):
        rows, _ = in_tiles(tmp_path, parts, 0.0)
    whole = GlobalMap(VOXEL)
    for cells in parts:
        whole.merge(cells)
    assert len(rows) == len(whole)


def test_split_tiles_puts_a_cube_near_a_border_into_both():
    cubes = np.array([[5, 5, 5], [1, 5, 5], [1, 9, 5], [-11, 5, 5]], dtype=np.int32)
    split = split_tiles(cubes, 10, 2)
    members = {
        tuple(tile): split.cells[split.begin[k] : split.begin[k + 1]].tolist()
        for k, tile in enumerate(split.tiles.tolist())
    }
    assert members == {
        (0, 0, 0): [0, 1, 2],
        (-1, 0, 0): [1, 2, 3],
        (0, 1, 0): [2],
        (-1, 1, 0): [2],
        (-2, 0, 0): [3],
    }


def test_cells_of_very_many_points_keep_their_mean(tmp_path):
    counts = np.array([1e6], dtype=np.float32)
    cells = MapCells(
        cubes=np.array([[7, 0, 0]], np.int32), sums=np.array([[3e4, 0, 0]], np.float32),
        intensity=5.0 * counts, counts=counts,
    )  # fmt: skip
    rows, _ = in_tiles(tmp_path, [cells], 0.0)
    np.testing.assert_allclose(rows[0, :4], [7.5 * VOXEL + 0.03, 0.5 * VOXEL, 0.5 * VOXEL, 5.0], rtol=1e-6)
