"""Edge and planar points of the world, one mean a cube: what LOAM registers scans to."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph import _core
from heliograph.arrays import as_array, as_points, as_pose, frozen, require_finite
from heliograph.config import LoamConfig
from heliograph.errors import DataError
from heliograph.snapshots import Snapshot, require

__all__ = ["FeatureMap", "FeaturePoints"]


@dataclass(frozen=True, slots=True, kw_only=True)
class FeaturePoints:
    """Edge and planar points of one scan, de-skewed.

    Parameters
    ----------
    edges, planes : (E, 3), (P, 3) float32
        Body frame at one instant [m].
    """

    edges: NDArray[np.float32]
    planes: NDArray[np.float32]

    def __post_init__(self) -> None:
        for name in ("edges", "planes"):
            object.__setattr__(self, name, frozen(name, getattr(self, name), np.float32, (None, 3)))

    def __len__(self) -> int:
        return len(self.edges) + len(self.planes)


class FeatureMap:
    """Hashed cubes for edges and others for planar points, each with the mean of its first points.

    A mean of points on a line lies on it, and of points on a plane on that, with less noise than any one of them. The
    line or plane of a query goes through the nearest means; how sure it is follows from their scatter and number. It
    changes by its verbs only, those of a `LocalMap` but for what is inserted.

    Parameters
    ----------
    config : LoamConfig, optional
    radius : float
        What lies farther from the sensor is forgotten [m].
    """

    def __init__(self, config: LoamConfig | None = None, *, radius: float = 150.0) -> None:
        self.config = config if config is not None else LoamConfig()
        self._radius = radius
        self._begin()

    def _begin(self) -> None:
        c = self.config
        self.edges = _core.FeatureMap(
            True, c.edge_voxel, c.max_points, c.neighbours, c.edge_reach, c.max_thickness, c.min_spread * c.edge_voxel
        )
        self.planes = _core.FeatureMap(
            False,
            c.plane_voxel,
            c.max_points,
            c.neighbours,
            c.plane_reach,
            c.max_thickness,
            c.min_spread * c.plane_voxel,
        )

    def insert(self, points_body: FeaturePoints, T_odom_body: NDArray[np.float64]) -> float:
        """Add the features of a scan seen from a pose (4, 4); return the new share of the planar surroundings.

        Raises
        ------
        DataError
            A pose that is not finite.
        """
        T = as_pose("T_odom_body", T_odom_body)
        edges, planes = as_points("edges", points_body.edges), as_points("planes", points_body.planes)
        fresh = float(self.edges.insert(edges, T))
        return float(self.planes.insert(planes, T)) if len(planes) > 0 else fresh

    def prune(self, centre_odom: NDArray[np.float64]) -> None:
        """Forget what lies farther from ``centre_odom`` (3,) than the radius, and the farthest of too many.

        Raises
        ------
        DataError
            ``centre_odom`` is not a finite (3,) float64.
        """
        centre = require_finite("centre_odom", as_array("centre_odom", centre_odom, np.float64, (3,)))
        for kind in (self.edges, self.planes):
            kind.prune(centre, self._radius, self.config.max_cells)

    def clear(self) -> None:
        """Forget everything."""
        self.edges.clear()
        self.planes.clear()

    def snapshot(self) -> Snapshot:
        """Return what further insertions and queries depend on."""
        return {"edges": self.edges.save(), "planes": self.planes.save()}

    def restore(self, snapshot: Snapshot) -> None:
        """Take up the state of another map of the same settings, to the bit.

        Raises
        ------
        DataError
            It is none of such a map, or damaged.
        """
        require(self, snapshot, {"edges": bytes, "planes": bytes})
        try:
            self._begin()
            self.edges.load(snapshot["edges"])
            self.planes.load(snapshot["planes"])
        except ValueError as error:
            raise DataError(f"the state of a map is of other settings or damaged ({error})") from error

    @property
    def nbytes(self) -> int:
        """Memory held [bytes]."""
        return int(self.edges.bytes()) + int(self.planes.bytes())

    def __len__(self) -> int:
        return len(self.edges) + len(self.planes)

    def __repr__(self) -> str:
        return f"FeatureMap(edges={len(self.edges)}, planes={len(self.planes)})"
