"""Defaults of the registration of two clouds, and of the local map of points."""

from __future__ import annotations

from dataclasses import dataclass

from heliograph.config_checks import check_range

__all__ = ["AlignConfig", "GlobalAlignConfig", "KdTreeMapConfig"]


@dataclass(frozen=True, slots=True, kw_only=True)
class AlignConfig:
    """Registration of two clouds.

    Parameters
    ----------
    voxel : float
        Edge of the finest cubes, one element each [m]; 0: every point is an element, and nothing is coarse.
    levels : int
        Levels of cubes, each twice as wide; the widest sets how far off a start may be.
    neighbours : int
        Nearest points that make the surface at a point, where ``voxel`` is 0.
    min_support : int
        Points that a surface in a cube needs.
    max_thickness : float
        Largest standard deviation across a plane or line [m].
    gate : float
        Largest distance of partners, in edges of a level's cubes; in metres where ``voxel`` is 0.
    kernel : float
        Scale of the Geman-McClure kernel, in edges of a level's cubes; in metres where ``voxel`` is 0 (0: none).
    sigma : float
        One-sigma of a residual, beside what the points' own scatter tells [m].
    normal_sigma_deg : float
        Normal_sigma_deg of a normal, beside what the points' own scatter tells [deg].
    min_cosine : float
        Min_cosine of the angle between the normals of partners, on the two finest levels.
    one_sided : bool
        Each cloud is a scan seen from its origin: the two sides of a wall are not taken for one. Does nothing for
        float64 clouds that were moved near their origin. Turn it off for maps whose frames lie far apart.
    iterations : int
        Largest number on each level.
    tolerance, tolerance_deg : float
        A smaller step ends the finest level [m], [deg].
    min_overlap : float
        Share of each cloud that must have a counterpart, or there is no answer.
    min_matches : int
        Elements with a partner that an answer needs.
    blind_probability : float
        A direction that is unobservable with at least this probability keeps its start.
    blind_gain : float
        Information that a direction needs, in multiples of what the normals' noise alone feigns.
    start_sigma, start_sigma_deg : float
        One-sigma of a start, an axis, for the covariance of directions that keep it [m], [deg].
    remap : bool
        Whether blind directions keep their start.
    max_elements : int
        Elements of the source that are matched on a level at most, evenly chosen; 0: all.
    max_extent : float
        A cloud that spans more is taken for one in another unit [m].
    """

    voxel: float = 0.25
    levels: int = 4
    neighbours: int = 10
    min_support: int = 6
    max_thickness: float = 0.05
    gate: float = 2.0
    kernel: float = 0.5
    sigma: float = 0.005
    normal_sigma_deg: float = 0.5
    min_cosine: float = 0.5
    one_sided: bool = True
    iterations: int = 12
    tolerance: float = 2e-4
    tolerance_deg: float = 2e-3
    min_overlap: float = 0.1
    min_matches: int = 20
    blind_probability: float = 0.5
    blind_gain: float = 3.0
    start_sigma: float = 0.5
    start_sigma_deg: float = 5.0
    remap: bool = True
    max_elements: int = 0
    max_extent: float = 5000.0

    def __post_init__(self) -> None:
        check_range(self, "voxel", "kernel", "min_cosine", "normal_sigma_deg", "max_elements", low=0.0)
        check_range(self, "max_thickness", "gate", "sigma", "tolerance", "tolerance_deg", "max_extent", above=0.0)
        check_range(self, "start_sigma", "start_sigma_deg", "blind_gain", above=0.0)
        check_range(self, "min_overlap", "blind_probability", low=0.0, high=1.0)
        check_range(self, "levels", low=1, high=8)
        check_range(self, "neighbours", "min_support", "min_matches", low=3)
        check_range(self, "iterations", low=1)


@dataclass(frozen=True, slots=True, kw_only=True)
class GlobalAlignConfig:
    """Alignment without a start.

    Parameters
    ----------
    level : int
        Level of elements, 0 the finest, whose features are matched.
    radius : float
        Radius of a feature's neighbourhood [m].
    wide_radius, wide_tolerance : float
        Radius and tolerance on the next level, which is matched too [m].
    keypoints : int
        Elements of each cloud that are matched.
    neighbours : int
        Nearest features that count as a match, if mutual.
    tolerance : float
        Tolerance of distances between matches that agree [m].
    max_angle_deg : float
        The same of the angles between their normals [deg].
    seeds, hypotheses : int
        Sets that are grown on a level, and poses of them that are tried.
    same, same_deg : float
        Poses nearer than this are one [m], [deg].
    refined : int
        Poses, of those the most promising, that are refined and compared.
    reach : float
        Largest distance of a counterpart [m].
    kernel : float
        Residual at which a match counts a quarter as evidence [m].
    cell_deg : float
        Cell of directions in which a scan is taken to have seen what is between its nearest and farthest return [deg].
    min_odds : float
        Odds, by the evidence, that a pose needs.
    """

    level: int = 1
    radius: float = 2.0
    wide_radius: float = 6.0
    wide_tolerance: float = 0.6
    keypoints: int = 1500
    neighbours: int = 4
    tolerance: float = 0.4
    max_angle_deg: float = 25.0
    seeds: int = 150
    hypotheses: int = 40
    refined: int = 10
    same: float = 0.5
    same_deg: float = 5.0
    reach: float = 0.5
    kernel: float = 0.1
    cell_deg: float = 2.0
    min_odds: float = 11.0

    def __post_init__(self) -> None:
        check_range(self, "wide_radius", "wide_tolerance", above=0.0)
        check_range(self, "radius", "tolerance", "max_angle_deg", "same", "same_deg", "reach", "kernel", above=0.0)
        check_range(self, "level", low=0)
        check_range(self, "keypoints", low=3)
        check_range(self, "neighbours", "seeds", "hypotheses", "refined", low=1)
        check_range(self, "min_odds", above=0.0)
        check_range(self, "cell_deg", low=0.1, high=30.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class KdTreeMapConfig:
    """A local map of points in an incremental k-d tree.

    Parameters
    ----------
    spacing : float
        Edge of the cubes of which each keeps one point [m]; 0 keeps all.
    balance : float
        Largest share of a subtree's points on one side.
    neighbours : int
        Nearest points that make a plane, at most 32.
    reach : float
        Largest distance to the farthest of them [m].
    max_thickness, min_spread : float
        Largest standard deviation across a plane, smallest along it [m].
    cube : float
        Edge of the cubes by which an insertion is judged new [m].
    radius : float
        Points farther from the centre are forgotten [m].
    max_points : int
        Most that are kept.
    """

    spacing: float = 0.1
    balance: float = 0.7
    neighbours: int = 8
    reach: float = 1.0
    max_thickness: float = 0.05
    min_spread: float = 0.03
    cube: float = 1.0
    radius: float = 100.0
    max_points: int = 2_000_000

    def __post_init__(self) -> None:
        check_range(self, "spacing", low=0.0)
        check_range(self, "balance", above=0.5, below=1.0)
        check_range(self, "neighbours", low=3, high=32)
        check_range(self, "reach", "max_thickness", "min_spread", "cube", "radius", above=0.0)
        check_range(self, "max_points", low=1000)
