"""The LOAM odometry: features of scan lines, and their registration."""

from __future__ import annotations

from dataclasses import dataclass

from heliograph.config_checks import check_range

__all__ = ["FeatureConfig", "LoamConfig"]


@dataclass(frozen=True, slots=True, kw_only=True)
class FeatureConfig:
    """Which points of a scan line are edges and which are planar.

    Parameters
    ----------
    window : int
        Points on either side that the curvature is taken over.
    region : int
        Points of a sub-region of a line, about; each has quotas of its own, so that no side has all features.
    edges, planes : int
        Most edge and planar points of a sub-region that are matched.
    map_edges : int
        Most edge points of a sub-region that go into the map.
    map_stride : int
        Every such planar point goes into the map.
    edge_curvature, plane_curvature : float
        Least curvature of an edge and largest of a planar point: the offset from the mean of the neighbours, across the
        line, as a share of the range.
    range_noise : float
        One-sigma of a range [m]; an offset within three times that is no edge, and no bend of a plane.
    gap : float
        A change of range from one point to the next, beyond which the farther one may be hidden from elsewhere [m].
    grazing : float
        A change of range to both neighbours, as a share of it, beyond which the surface lies along the beam.
    max_step_deg : float
        Largest median angle from one point of a line to the next; beyond it the points follow no lines [deg].
    row_height_deg : float
        Height of the rows that points without rings and without order are sorted into by elevation [deg].
    """

    window: int = 5
    region: int = 170
    edges: int = 2
    planes: int = 4
    map_edges: int = 20
    map_stride: int = 5
    edge_curvature: float = 0.01
    plane_curvature: float = 0.005
    range_noise: float = 0.02
    gap: float = 0.3
    grazing: float = 0.02
    max_step_deg: float = 1.5
    row_height_deg: float = 0.5

    def __post_init__(self) -> None:
        check_range(self, "window", "region", "map_stride", low=1)
        check_range(self, "edges", "planes", "map_edges", low=0)
        check_range(self, "edge_curvature", "plane_curvature", "range_noise", low=0.0)
        check_range(self, "gap", "grazing", "max_step_deg", "row_height_deg", above=0.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class LoamConfig:
    """The map of features, and the registration of a scan to it. What is not here is the filter's, in `FilterConfig`.

    Parameters
    ----------
    features : FeatureConfig
    edge_voxel, plane_voxel : float
        Cubes of which each keeps one mean edge, one mean planar point [m].
    edge_reach, plane_reach : float
        How far the neighbours of a feature may be [m].
    neighbours : int
        Means at most that a line or a plane is laid through; a line needs three, a plane five.
    max_thickness : float
        Largest standard deviation of them off it [m].
    min_spread : float
        Least standard deviation along it, as a share of the cubes' edge.
    max_points : int
        Points at which a cube is frozen.
    max_cells : int
        Most cubes of either map.
    edge_sigma, plane_sigma : float
        Noise of a feature across its line or plane at the start [m]; afterwards it follows the residuals.
    max_iterations : int
        Iterations of one registration, once its kernel has narrowed.
    rematch : float
        Features look for their lines and planes again when the pose has moved by as much at the typical range [m].
    passes : int
        Most registrations of a scan, each de-skewed with the motion that the one before it found.
    correlation : float
        How many matches count as one independent one.
    max_jump : float
        A registration that ends farther from its start than this, beyond what the prediction allows for, is not
        believed [m].
    scan_to_scan : bool
        Without an IMU: whether each registration to the map begins where the sweep before puts the sweep. If not, that
        is asked only where the map alone tells no place.
    """

    features: FeatureConfig = FeatureConfig()
    edge_voxel: float = 0.3
    plane_voxel: float = 0.4
    edge_reach: float = 0.6
    plane_reach: float = 0.8
    neighbours: int = 8
    max_thickness: float = 0.1
    min_spread: float = 0.4
    max_points: int = 50
    max_cells: int = 500_000
    edge_sigma: float = 0.05
    plane_sigma: float = 0.03
    max_iterations: int = 10
    rematch: float = 0.03
    passes: int = 2
    correlation: float = 4.0
    max_jump: float = 0.5
    scan_to_scan: bool = False

    def __post_init__(self) -> None:
        check_range(self, "edge_voxel", "plane_voxel", "edge_reach", "plane_reach", "max_thickness", above=0.0)
        check_range(self, "edge_sigma", "plane_sigma", "correlation", "max_jump", above=0.0)
        check_range(self, "min_spread", "rematch", low=0.0)
        check_range(self, "neighbours", low=5, high=16)
        check_range(self, "max_points", "max_cells", "max_iterations", "passes", low=1)
