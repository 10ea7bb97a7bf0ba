"""The law of local maps."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import Array
from heliograph.lie import so3
from heliograph.maps import LocalMap, WindowedMap

__all__ = ["Walls", "assert_local_map"]


def assert_local_map(make_map: Callable[[], LocalMap], rng: np.random.Generator) -> None:
    """Assert that a local map finds the walls it was shown, keeps to gate and bound, and forgets when it is cleared.

    Empty and NaN clouds must leave it as it is. One that is a `WindowedMap` forgets what was not seen for a while too.

    Parameters
    ----------
    make_map : callable
        Returns a new, empty map. Three walls of 4 m by 4 m with 300 points a square metre must be enough for it.
    rng : numpy.random.Generator
        Draws walls, poses and queries.
    """
    walls = Walls(rng)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = so3.exp(rng.normal(size=3)), rng.uniform(-5.0, 5.0, 3)
    cloud_odom = walls.points(rng, 4800, 0.0)
    cloud_body = ((cloud_odom - T[:3, 3]) @ T[:3, :3]).astype(np.float32)
    local_map, twin = make_map(), make_map()
    _assert_nothing_found(local_map, cloud_odom, "an empty map")
    for some in (local_map, twin):
        share = some.insert(cloud_body, T)
        assert share == 1.0, f"the first scan is new by {share:.0%}, not all of it"
    size = len(local_map)
    assert size > 0, "a map with points has length 0"
    local_map.insert(cloud_body[:0], T)
    local_map.insert(np.full((7, 3), np.nan, dtype=np.float32), T)
    assert len(local_map) == size, "an empty cloud or one of NaN changed the map"
    for offset, gate in ((0.03, 0.2), (-0.1, 0.15), (0.1, 0.05)):
        _assert_walls_found(local_map, twin, walls, rng, offset, gate)
    share = local_map.insert(cloud_body, T)
    assert share == 0.0, f"the same scan again is new by {share:.0%}"
    before = local_map.planes_at(cloud_odom, gate=0.1)
    local_map.prune(walls.centre)
    after = local_map.planes_at(cloud_odom, gate=0.1)
    np.testing.assert_array_equal(after.source, before.source, err_msg="pruning around the walls forgot some")
    local_map.prune(walls.centre + 1e5)
    _assert_nothing_found(local_map, cloud_odom, "a map pruned 100 km away")
    _assert_fills_again(local_map, cloud_body, T, cloud_odom, before.source, "a map pruned to nothing")
    if isinstance(local_map, WindowedMap):
        _assert_forgets_unseen(local_map, cloud_body, T, cloud_odom)
    local_map.clear()
    _assert_nothing_found(local_map, cloud_odom, "a cleared map")
    _assert_fills_again(local_map, cloud_body, T, cloud_odom, before.source, "a cleared map")


def _assert_fills_again(
    local_map: LocalMap, cloud_body: NDArray[np.float32], T: Array, queries: Array, source: NDArray[np.uint8], case: str
) -> None:
    share = local_map.insert(cloud_body, T)
    assert share == 1.0, f"{case} takes the first scan for new by {share:.0%}, not all of it"
    local_map.insert(cloud_body, T)
    found = local_map.planes_at(queries, gate=0.1)
    np.testing.assert_array_equal(found.source, source, err_msg=f"{case} does not fill again")


def _assert_forgets_unseen(local_map: WindowedMap, cloud_body: NDArray[np.float32], T: Array, queries: Array) -> None:
    """Assert that what was seen last stays, full or not, and that what was not goes, whenever it was first seen."""
    away = np.array([80.0, 0.0, 0.0])
    there = T.copy()
    there[:3, 3] += away
    for pose in (there, T, T, T, T, there, T):
        local_map.insert(cloud_body, pose)
    here, beyond = (local_map.planes_at(q, gate=0.1).source for q in (queries, queries + away))
    local_map.forget_unseen(2)
    for q, before, place in ((queries, here, "last"), (queries + away, beyond, "last but one")):
        found = local_map.planes_at(q, gate=0.1).source
        np.testing.assert_array_equal(found, before, err_msg=f"what was seen {place} is forgotten")
    local_map.forget_unseen(1)
    np.testing.assert_array_equal(local_map.planes_at(queries, gate=0.1).source, here, err_msg="seen last, forgotten")
    assert not local_map.planes_at(queries + away, gate=0.1).source.any(), "what was seen the last time but one stays"


class Walls:
    """Three walls that meet nowhere near their middles, in odom: their normals, and the place between them."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.normals = so3.exp(rng.normal(size=3)).T
        self.centre = rng.uniform(-20.0, 20.0, 3)

    def points(self, rng: np.random.Generator, count: int, offset: float) -> Array:
        """Return ``count`` points in turn of each wall, moved along its normal by ``offset``, (3 count, 3)."""
        out = np.empty((count, 3, 3))
        for i, n in enumerate(self.normals):
            u, v = self.normals[(i + 1) % 3], self.normals[(i + 2) % 3]
            a, b = rng.uniform(-2.0, 2.0, (2, count, 1))
            out[:, i] = self.centre + (6.0 + offset) * n + a * u + b * v
        return out.reshape(-1, 3)


def _assert_nothing_found(local_map: LocalMap, queries: Array, case: str) -> None:
    for some in (queries, queries[:0]):
        found = local_map.planes_at(some, gate=1.0)
        shapes = [found.normal.shape, found.point.shape, found.variance.shape, found.source.shape]
        assert shapes == [(len(some), 3), (len(some), 3), (len(some),), (len(some),)], f"{case}: shapes are {shapes}"
        assert not np.any(found.source), f"{case} finds planes"
    assert len(local_map) == 0, f"{case} has length {len(local_map)}, not 0"


def _assert_walls_found(
    local_map: LocalMap, twin: LocalMap, walls: Walls, rng: np.random.Generator, offset: float, gate: float
) -> None:
    queries = walls.points(rng, 150, offset)
    normals = np.tile(walls.normals, (150, 1))
    found, again = local_map.planes_at(queries, gate=gate), twin.planes_at(queries, gate=gate)
    for name in ("normal", "point", "variance", "source"):
        a, b = getattr(found, name), getattr(again, name)
        some = found.source > 0
        np.testing.assert_array_equal(a[some], b[some], err_msg=f"two maps with the same points differ in {name}")
    case = f"queries {offset:g} m off the walls with a gate of {gate:g} m"
    share = float(np.mean(found.source > 0))
    if abs(offset) > 1.5 * gate:
        assert share < 0.05, f"{case}: {share:.0%} passed"
        return
    assert share > 0.8, f"{case}: only {share:.0%} found a plane"
    n, d = found.normal[some].astype(np.float64), queries[some] - found.point[some]
    np.testing.assert_allclose(np.linalg.norm(n, axis=1), 1.0, atol=1e-5, err_msg=f"{case}: normals are not unit")
    np.testing.assert_allclose(np.abs(np.sum(n * normals[some], axis=1)), 1.0, atol=1e-2, err_msg=f"{case}: normals")
    r = np.abs(np.sum(n * d, axis=1))
    assert r.max() <= gate * (1.0 + 1e-5), f"{case}: a residual of {r.max():g} m passed"
    np.testing.assert_allclose(r, abs(offset), atol=5e-3, err_msg=f"{case}: residuals")
    variance = found.variance[some]
    assert np.isfinite(variance).all() and (variance > 0.0).all(), f"{case}: variances must be positive"
