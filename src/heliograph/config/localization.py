"""Defaults of localisation in a saved map."""

from __future__ import annotations

from dataclasses import dataclass

from heliograph.config_checks import check_range

__all__ = ["LocalizationConfig"]


@dataclass(frozen=True, slots=True, kw_only=True)
class LocalizationConfig:
    """How a saved map is cut, searched and tracked. A false lock costs the robot, a late one some seconds.

    Parameters
    ----------
    spacing : float
        Distance of the submaps' middles [m]; keyframes that look another way have their own.
    reach, reach_up : float
        Keyframes within this of a submap's middle belong to it, level and in height [m].
    members : int
        Keyframes of a submap at most, the nearest first.
    tile : float
        Distance of the submaps' middles in a map without keyframes [m].
    view : float
        Points of such a map within this of a middle belong to its submap [m].
    before : float
        Length of the way whose scans make the query's local map [m].
    every : float
        Way between two queries [m].
    every_s : float
        Longest time between them [s].
    placed, tried : int
        Guesses that the detector places, and those of them, the most promising, that are aligned.
    headings : int
        Submaps in which a query is placed at every heading: half of them those that the detector finds likeliest, then
        the others in turn, query by query; 0: in none.
    max_rivals : int
        Rivals beyond which a search ends: the place is ambiguous whatever else there is.
    voxel, levels : float, int
        Finest cubes of the alignment [m], and number of levels.
    same, same_deg : float
        Poses nearer than this are one place [m], [deg].
    min_explained : float
        Share of the query's surfaces that must lie on the map's at a place that is taken for the right one.
    min_confirmed : float
        Share of the map's surfaces that the query should see there and does.
    max_seen_through : float
        Share of them that it looks through at most.
    rival : float
        A place elsewhere with at least this share of the best place's score is a rival.
    agreeing : int
        Queries in a row that must find the same place, and no rival, before it is believed.
    rotation_walk_deg, position_walk : float
        One-sigma that odometry drifts by a metre besides what it says itself, an axis [deg], [m].
    correlation : float
        Matches of a scan that tell as much as one.
    points : int
        Points of a scan that are matched to the map.
    matched_share : float
        Part of the share that usually matches below which a scan contradicts the place.
    slack, slack_deg : float
        One-sigma that a map may be bent besides what it says itself, an axis [m], [deg]: it widens the gate.
    gate_probability : float
        A match that moves the place further than odometry and slack allow with this probability contradicts it.
    max_unexplained : float
        So does a scan of which more than this share of `min_explained` is missing, looked at every `every_s`.
    lost_scans : int
        Scans in a row that contradict it before the place is given up.
    """

    spacing: float = 2.0
    reach: float = 8.0
    reach_up: float = 1.5
    members: int = 16
    tile: float = 4.0
    view: float = 25.0
    before: float = 10.0
    every: float = 0.5
    every_s: float = 1.0
    placed: int = 24
    tried: int = 16
    headings: int = 24
    max_rivals: int = 3
    voxel: float = 0.25
    levels: int = 4
    same: float = 0.5
    same_deg: float = 5.0
    min_explained: float = 0.3
    min_confirmed: float = 0.45
    max_seen_through: float = 0.08
    rival: float = 0.85
    agreeing: int = 3
    rotation_walk_deg: float = 0.02
    position_walk: float = 0.003
    correlation: float = 8.0
    points: int = 1500
    matched_share: float = 0.5
    slack: float = 0.05
    slack_deg: float = 0.5
    gate_probability: float = 0.9999
    max_unexplained: float = 0.5
    lost_scans: int = 10

    def __post_init__(self) -> None:
        check_range(self, "spacing", "reach", "reach_up", "tile", "view", "before", "every", "every_s", above=0.0)
        check_range(self, "members", "placed", "tried", "max_rivals", "agreeing", "lost_scans", low=1)
        check_range(self, "headings", low=0)
        check_range(self, "levels", low=1, high=8)
        check_range(self, "voxel", "same", "same_deg", "rotation_walk_deg", "position_walk", above=0.0)
        check_range(self, "min_explained", "min_confirmed", "max_seen_through", "matched_share", low=0.0, high=1.0)
        check_range(self, "rival", low=0.0, high=1.0)
        check_range(self, "slack", "slack_deg", above=0.0)
        check_range(self, "max_unexplained", low=0.0, high=1.0)
        check_range(self, "correlation", low=1.0)
        check_range(self, "points", low=50)
        check_range(self, "gate_probability", above=0.0, below=1.0)
