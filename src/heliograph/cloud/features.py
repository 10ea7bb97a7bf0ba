"""Edge and planar points of a sweep, by the curvature of its scan lines."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from heliograph import _core
from heliograph.arrays import as_points, freeze
from heliograph.cloud.scan_lines import ScanLines
from heliograph.config import FeatureConfig

__all__ = ["ScanFeatures", "scan_features"]


@dataclass(frozen=True, slots=True, kw_only=True)
class ScanFeatures:
    """Indices of points, in the order of the lines.

    Parameters
    ----------
    edges, planes : (E,), (P,) int32
        The sharpest and the flattest of each sub-region, to match.
    map_edges, map_planes : (F,), (Q,) int32
        More of them, for the map; `edges` are among the first.
    """

    edges: NDArray[np.int32]
    planes: NDArray[np.int32]
    map_edges: NDArray[np.int32]
    map_planes: NDArray[np.int32]

    def __post_init__(self) -> None:
        freeze(self)

    def __len__(self) -> int:
        return len(self.edges) + len(self.planes)


def scan_features(
    points: NDArray[np.float32], lines: ScanLines, config: FeatureConfig, *, threads: int = 1
) -> ScanFeatures:
    """Pick the edge and planar points of a sweep.

    The curvature of a point is the distance from the mean of its neighbours on the line over its range, eq. (2) of
    docs/theory/loam.md; only the part across the line counts, so that a straight one that is seen under a flat angle,
    with uneven steps, is no corner. Points near a break of the line, hidden ones behind a nearer surface, and those on
    a surface along the beam are left out; the rim of a nearer surface is an edge. Each sub-region gives its quota,
    never from within a window of one that was taken.

    Parameters
    ----------
    points : (N, 3) float32
        Lidar frame, each at its own time [m].
    lines : ScanLines
        The lines of these points.
    config : FeatureConfig
    threads : int
        Threads of the native loop; the result does not depend on them.

    Raises
    ------
    DataError
        ``points`` are not (N, 3) float32.

    Notes
    -----
    After J. Zhang, S. Singh, "LOAM: Lidar odometry and mapping in real-time", RSS 2014, section V-A.
    """
    c, points = config, as_points("points", points)
    found: Any = _core.scan_features(
        points,
        lines.order,
        lines.starts,
        c.window,
        c.region,
        c.edge_curvature,
        c.plane_curvature,
        c.range_noise,
        c.edges,
        c.planes,
        c.map_edges,
        c.map_stride,
        c.gap,
        c.grazing,
        threads,
    )
    return ScanFeatures(edges=found.edges, planes=found.planes, map_edges=found.map_edges, map_planes=found.map_planes)
