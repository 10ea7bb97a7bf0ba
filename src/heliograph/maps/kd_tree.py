"""An incremental k-d tree as a local map: exact nearest neighbours, and planes through them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from heliograph import _core
from heliograph.config import KdTreeMapConfig
from heliograph.errors import DataError
from heliograph.maps.protocol import PlaneMatches

__all__ = ["KdTreeMap"]


class KdTreeMap:
    """A `LocalMap` of points in a k-d tree that grows, thins and forgets in place.

    What the incremental k-d trees of the literature do (Y. Cai, W. Xu, F. Zhang, "ikd-Tree", arXiv 2102.10808):
    insertion with one point a cube kept, removal by box, partial rebuilding, exact neighbours; here with leaves of up
    to 32 points, removal at once instead of marks, and no second thread. A query costs several times that of
    `VoxelMap`, and needs no cube to hold enough points.

    Parameters
    ----------
    config : KdTreeMapConfig, optional
    threads : int
        Threads of `planes_at`; the result does not depend on it.
    """

    def __init__(self, config: KdTreeMapConfig | None = None, *, threads: int = 1) -> None:
        self.config = config if config is not None else KdTreeMapConfig()
        self.threads = threads
        self.native = _core.IncrementalKdTree(self.config.spacing, self.config.balance)
        self._seen = _core.SeenCubes(self.config.cube)

    def insert(self, points_body: NDArray[np.float32], T_odom_body: NDArray[np.float64]) -> float:
        """Add points (N, 3) of the body frame seen from the pose (4, 4); return the new share of the cubes touched."""
        points, pose = np.ascontiguousarray(points_body), np.ascontiguousarray(T_odom_body)
        return float(self.native.insert_scan(points, pose, self._seen))

    def prune(self, centre_odom: NDArray[np.float64]) -> None:
        """Forget points beyond ``config.radius`` of ``centre_odom`` (3,), and the farthest of too many."""
        centre = np.asarray(centre_odom, dtype=np.float32)
        self.native.remove_beyond(centre, self.config.radius)
        self._seen.prune(np.ascontiguousarray(centre_odom, dtype=np.float64), self.config.radius + self.config.cube)
        excess = len(self) - self.config.max_points
        if excess > 0:
            square = ((self.points().astype(np.float64) - centre_odom) ** 2).sum(axis=1)
            self.native.remove_beyond(centre, float(np.sqrt(np.partition(square, -excess)[-excess])) * (1.0 - 1e-6))

    def forget_unseen(self, insertions: int) -> None:
        """Forget points in cubes of ``config.cube`` that none of the last ``insertions`` insertions had one in."""
        self.native.forget_unseen(self._seen, int(insertions))

    def remove_box(self, low_odom: NDArray[np.float64], high_odom: NDArray[np.float64]) -> int:
        """Forget the points in a box from ``low_odom`` to ``high_odom`` (3,), ends included; return how many."""
        low, high = np.asarray(low_odom, dtype=np.float32), np.asarray(high_odom, dtype=np.float32)
        if low.shape != (3,) or high.shape != (3,) or not (low <= high).all():
            raise DataError(f"a box needs three ends below three others, not {low.tolist()} and {high.tolist()}")
        return int(self.native.remove_box(low, high))

    def clear(self) -> None:
        """Forget everything."""
        self.native.clear()
        self._seen.clear()

    def nearest(
        self, queries_odom: NDArray[np.float32], count: int, *, max_distance: float = np.inf
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return squared distances (N, count) [m^2] and points (N, count, 3), nearest first: exact.

        Where there are fewer within ``max_distance`` [m] the rest is infinite and NaN. Equal distances are ordered by
        coordinates.
        """
        square, places = self.native.nearest(np.ascontiguousarray(queries_odom), count, max_distance)
        return np.asarray(square), np.asarray(places)

    def planes_at(self, points_odom: NDArray[np.float64], *, gate: float) -> PlaneMatches:
        """Return for each point (N, 3) the plane through its nearest neighbours, where they lie on one."""
        c = self.config
        normal, point, variance, source = self.native.planes(
            np.ascontiguousarray(points_odom), c.neighbours, c.reach, c.max_thickness, c.min_spread, gate, self.threads
        )
        return PlaneMatches(normal=normal, point=point, variance=variance, source=source)

    def points(self) -> NDArray[np.float32]:
        """Return all stored points, (M, 3), odom frame [m], in the order of the tree."""
        return np.asarray(self.native.points())

    @property
    def nbytes(self) -> int:
        """Memory held [bytes]."""
        return int(self.native.bytes())

    def __len__(self) -> int:
        return len(self.native)

    def __repr__(self) -> str:
        return f"KdTreeMap(points={len(self)}, spacing={self.config.spacing}, depth={self.native.depth()})"
