"""Defaults of place recognition and of what a loop must show."""

from __future__ import annotations

from dataclasses import dataclass

from heliograph.config_checks import check_choice, check_range
from heliograph.errors import ConfigError

__all__ = ["LoopConfig", "PlacesConfig"]


@dataclass(frozen=True, slots=True, kw_only=True)
class PlacesConfig:
    """Which earlier keyframes look like the one at hand.

    Parameters
    ----------
    method : str
        ``"birds-eye"``: the occupancy seen from above, ranked by its Radon spectrum and placed by correlation; a guess
        of the whole pose, also for narrow fields of view. ``"scan-context"``: heights by ring and sector; yaw only.
    cell : float
        Edge of a cell seen from above [m].
    size : int
        Cells along each side of the picture, a multiple of 8.
    layer : float
        Height of a layer [m]; a cell counts as occupied if it has points in `min_layers` of them: walls do, floors and
        ceilings do not.
    min_layers : int
        See `layer`.
    examined : int
        Candidates, the best ranked by spectrum, that are placed by correlation.
    rings, sectors : int
        Polar cells of scan context.
    max_range : float
        Radius of its outermost ring [m].
    floor : float
        Height that it counts from, below the sensor [m].
    ring_keys : int
        Candidates, nearest by ring key, whose sectors are compared.
    """

    method: str = "birds-eye"
    cell: float = 0.5
    size: int = 96
    layer: float = 0.25
    min_layers: int = 3
    examined: int = 20
    rings: int = 20
    sectors: int = 60
    max_range: float = 80.0
    floor: float = 2.0
    ring_keys: int = 10

    def __post_init__(self) -> None:
        check_choice(self, "method", "birds-eye", "scan-context")
        check_range(self, "cell", "layer", "max_range", above=0.0)
        check_range(self, "size", low=16, high=128)
        if self.size % 8:
            raise ConfigError(f"size = {self.size} is no multiple of 8, which pictures as bits need")
        check_range(self, "min_layers", "examined", "ring_keys", low=1)
        check_range(self, "rings", "sectors", low=2, high=255)
        check_range(self, "floor", low=0.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class LoopConfig:
    """What a loop must show before it is believed. A false loop costs the map, a missed one some drift.

    Parameters
    ----------
    before, after : int
        Keyframes before and after one that make its local map; a query has none after it.
    max_smear, fine_smear : float
        Local maps reach no further than odometry's one-sigma of what is seen ten metres away stays below this [m]; the
        second bounds those that the pose is taken from, once it is found.
    apart : int
        Keyframes that must lie between a query and a candidate: what is nearer, odometry has matched itself.
    reach, reach_up : float
        Distance between a query and a candidate, level and in height, beyond three sigmas of odometry's, at which they
        may still see the same [m].
    placed, candidates : int
        Places asked of the detector for a query, and those of them, the ones first that odometry's covariance allows,
        that are verified until one is not refused.
    voxel, levels : float, int
        Finest cubes of the registration [m], and number of levels.
    elements : int
        Elements of a local map that are matched on a level at most, evenly chosen: neighbours share errors, and more
        of them tell little more.
    gate_probability : float
        A pose that odometry calls less likely than one less this is refused.
    max_shift, max_shift_up : float
        How far a loop may move its query from where odometry has it, level and in height [m]: buildings repeat by
        corridors and storeys, and within half of that nothing but odometry tells twins apart.
    max_doubt, max_doubt_up : float
        Odometry's largest one-sigma of the query, level and in height, with which it can tell them [m].
    correlation : float
        Matches that tell as much as one, as neighbours share errors: a registration's own covariance is times this.
    sigma, sigma_deg : float
        One-sigma that a loop is credited with at best, an axis [m], [deg]: what all points of a local map share.
    slack, slack_deg : float
        One-sigma that a loop may be off besides without being called wrong, an axis [m], [deg]: it widens the gates,
        and is no part of the loop's covariance.
    same, same_deg : float
        Poses nearer than this are one answer [m], [deg].
    min_overlap : float
        Share of either local map that must have a counterpart in the other.
    min_inliers : float
        Share of the matches that must fit their surfaces.
    max_residual : float
        Largest median residual, in edges of the finest cubes.
    min_lead : float
        Evidence of the pose over that of the best pose elsewhere that odometry allows too; below it the loop waits.
    max_blind : int
        Directions that the match may leave unseen.
    max_blur : float
        Largest growth of the map's entropy by joining the local maps at the pose [nat].
    max_blur_ratio : float
        A growth is no worse than that of joining them where odometry has them up to this ratio: local maps are bent,
        and the growths of two poses differ by that. Where it is more than `max_blur`, this is the bound.
    window : float
        Loops whose queries lie within this way of each other make a sequence [m].
    min_sequence : int
        Loops of the sequence that must agree with one, from other queries, before it is accepted.
    min_span : float
        Way that the queries of the sequence must cover, in one-sigmas of odometry's position along its worst axis.
    compared : int
        Latest held and accepted loops that a new one is compared with.
    consistency_probability : float
        Two loops disagree where the cycle that they close is less likely than one less this.
    min_clique : int
        Loops that must agree with each other, pair by pair.
    """

    before: int = 9
    after: int = 5
    max_smear: float = 0.15
    fine_smear: float = 0.06
    apart: int = 30
    reach: float = 8.0
    reach_up: float = 1.5
    placed: int = 20
    candidates: int = 5
    voxel: float = 0.25
    levels: int = 4
    elements: int = 12_000
    gate_probability: float = 0.999
    max_shift: float = 5.0
    max_shift_up: float = 1.5
    max_doubt: float = 2.0
    max_doubt_up: float = 0.75
    correlation: float = 4.0
    sigma: float = 0.005
    sigma_deg: float = 0.05
    slack: float = 0.05
    slack_deg: float = 0.5
    same: float = 0.4
    same_deg: float = 4.0
    min_overlap: float = 0.3
    min_inliers: float = 0.85
    max_residual: float = 0.6
    min_lead: float = 1.15
    max_blind: int = 0
    max_blur: float = 0.25
    max_blur_ratio: float = 1.25
    window: float = 20.0
    min_sequence: int = 2
    min_span: float = 2.0
    compared: int = 80
    consistency_probability: float = 0.99
    min_clique: int = 3

    def __post_init__(self) -> None:
        check_range(self, "before", "after", "max_blind", "min_sequence", low=0)
        check_range(self, "apart", "placed", "candidates", "compared", "min_clique", low=1)
        check_range(self, "levels", low=1, high=8)
        check_range(self, "elements", low=100)
        check_range(
            self,
            "voxel",
            "sigma",
            "sigma_deg",
            "slack",
            "slack_deg",
            "same",
            "same_deg",
            "max_residual",
            "max_smear",
            "window",
            "reach",
            "reach_up",
            above=0.0,
        )
        check_range(self, "min_overlap", "min_inliers", low=0.0, high=1.0)
        check_range(self, "gate_probability", "consistency_probability", above=0.0, below=1.0)
        check_range(self, "max_shift", "max_shift_up", "max_doubt", "max_doubt_up", above=0.0)
        check_range(self, "min_lead", "correlation", low=1.0)
        check_range(self, "max_blur", "min_span", low=0.0)
        check_range(self, "max_blur_ratio", low=1.0)
