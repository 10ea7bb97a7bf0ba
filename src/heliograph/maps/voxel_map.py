"""Hashed voxels on several levels, each with running moments and a plane: the default local map."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from heliograph import _core
from heliograph.arrays import as_array, as_points, as_pose, require_finite
from heliograph.config import MapConfig
from heliograph.errors import DataError
from heliograph.maps.protocol import PlaneMatches
from heliograph.snapshots import Snapshot, require

__all__ = ["VoxelMap"]


class VoxelMap:
    """A `LocalMap` of planes in cubes whose edge doubles from level to level.

    Each cube keeps count, sum and outer products of its points; a plane is fitted when they are thin and wide enough
    (probabilistic voxel planes: C. Yuan et al., "Efficient and probabilistic adaptive voxel mapping", RA-L 2022). A
    query takes the finest plane of the cubes that hold it, so its cost does not depend on the map's size. A cube with
    ``max_points`` is frozen: later visits are matched to what was seen first, and do not smear it. Where no plane is
    known, a plane through the five nearest of a few stored points stands in.

    Parameters
    ----------
    config : MapConfig, optional
        Cubes, planes and bounds; the default is that of a run.
    """

    def __init__(self, config: MapConfig | None = None) -> None:
        self.config = config if config is not None else MapConfig()
        self.clear()

    def clear(self) -> None:
        """Forget everything: the next insertion begins a new map."""
        c = self.config
        self.native = _core.VoxelMap(
            c.voxel, c.levels, c.min_points, c.max_points, c.max_thickness, c.min_spread, c.point_spacing
        )

    def insert(self, points_body: NDArray[np.float32], T_odom_body: NDArray[np.float64]) -> float:
        """Add points (N, 3) of the body frame seen from the pose (4, 4); return the new share of the cubes touched.

        Points that are not finite are left out.

        Raises
        ------
        DataError
            An array of another dtype or shape, or a pose that is not finite.
        """
        points, T = as_points("points_body", points_body), as_pose("T_odom_body", T_odom_body)
        return float(self.native.insert(points, T))

    def prune(self, centre_odom: NDArray[np.float64]) -> None:
        """Forget cubes beyond ``config.radius`` of ``centre_odom`` (3,), and the farthest of too many.

        Raises
        ------
        DataError
            ``centre_odom`` is not a finite (3,) float64.
        """
        centre = require_finite("centre_odom", as_array("centre_odom", centre_odom, np.float64, (3,)))
        self.native.prune(centre, self.config.radius, self.config.max_voxels)

    def forget_unseen(self, insertions: int) -> None:
        """Forget cubes and raw points that none of the last ``insertions`` insertions had a point in."""
        self.native.forget_unseen(int(insertions))

    def planes_at(self, points_odom: NDArray[np.float64], *, gate: float, neighbours: bool = True) -> PlaneMatches:
        """Return for each point (N, 3) the finest plane whose cube holds it, else one through its neighbours.

        Looking for ``neighbours`` takes most of the time where many points have no plane. A point that is not finite
        has none.

        Raises
        ------
        DataError
            ``points_odom`` are not (N, 3) float64.
        """
        points = as_array("points_odom", points_odom, np.float64, (None, 3))
        normal, point, variance, tilt, scatter, since, source = _core.query_planes(
            self.native, points, gate, int(neighbours), self.config.fallback_range
        )
        return PlaneMatches(
            normal=normal, point=point, variance=variance, tilt=tilt, scatter=scatter, since=since, source=source
        )

    def table(self) -> NDArray[np.float64]:
        """Return one row a cube: level, count, centre 3, normal 3, centroid 3, variance (< 0: no plane), 1 / spread."""
        return np.asarray(self.native.planes())

    def snapshot(self) -> Snapshot:
        """Return what further insertions and queries depend on."""
        return {"native": self.native.save()}

    def restore(self, snapshot: Snapshot) -> None:
        """Take up the state of another map of the same settings, to the bit.

        Raises
        ------
        DataError
            It is none of such a map, or damaged.
        """
        require(self, snapshot, {"native": bytes})
        try:
            self.clear()
            self.native.load(snapshot["native"])
        except ValueError as error:
            raise DataError(f"the state of a map is of other settings or damaged ({error})") from error

    @property
    def nbytes(self) -> int:
        """Memory held [bytes]."""
        return int(self.native.bytes())

    def __len__(self) -> int:
        return len(self.native)

    def __repr__(self) -> str:
        info: dict[str, Any] = {"cubes": len(self), "voxel": self.config.voxel, "levels": self.config.levels}
        return f"VoxelMap({', '.join(f'{k}={v}' for k, v in info.items())})"
