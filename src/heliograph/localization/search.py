"""The search for a query's place in a saved map: all that looks like it, the best of it aligned and weighed.

Numbers of equations are those of docs/theory/localization.md.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from heliograph import _core
from heliograph.arrays import Array, Points, freeze
from heliograph.config import LocalizationConfig
from heliograph.lie import se3
from heliograph.localization.saved_map import SavedMap, SavedSubmap, align_config, thinned
from heliograph.registration import PreparedCloud, align, prepare_cloud
from heliograph.registration.align_levels import METHODS, fit_levels
from heliograph.slam.loops.tangent import near

__all__ = ["MapPlace", "Query", "search", "weigh"]

_THROUGH = 10.0  # a share of this one over of what should be seen, seen through, takes a score to 1/e
_LEAST_SCORE = 0.8  # of what a place must explain
_REACH = 0.5  # largest distance of a counterpart [m]
_KERNEL = 0.1  # residual at which a match counts a quarter [m]
_CELL = math.radians(2.0)  # of directions, in which a query has seen what is between its nearest and farthest return
_APART, _APART_DEG = 1.5, 12.0  # guesses nearer than this lead to the same place [m], [deg]
_PROMISING = 0.75  # share of the best guess's coarse overlap below which a guess is not followed
_SPARED = 0.9  # margin below a rival within which a place is aligned to the end all the same
_WORTH = 0.8  # share of what a place must explain at which it is aligned to the end
_HOPELESS = 6  # the most promising guesses, none of which stands: the others do not either
_AROUND = 12  # submaps near a known pose, of which the one that overlaps the query most is asked
_COARSE, _FINER = 2, 1  # levels at which guesses are compared, and again once they are aligned


@dataclass(frozen=True, slots=True, kw_only=True)
class Query:
    """What is to be found: a local map of the latest scans.

    Parameters
    ----------
    cloud : PreparedCloud
        In the levelled body frame: z up, the origin at the IMU [m].
    image : object
        By direction, between which distances it has seen something; of the native core.
    """

    cloud: PreparedCloud
    image: _core.RangeImage

    def __post_init__(self) -> None:
        freeze(self)

    @classmethod
    def of(cls, points_level: Points, saved: SavedMap, config: LocalizationConfig) -> Query:
        """Prepare points (N, 3) of a levelled body frame [m] for a map.

        Raises
        ------
        DataError
            Too few points.
        """
        cloud = prepare_cloud(points_level, align_config(config, sided=saved.sided), name="the scans")
        return cls(cloud=cloud, image=_core.RangeImage(cloud.points, _CELL))


@dataclass(frozen=True, slots=True, kw_only=True)
class MapPlace:
    """A place where a query may be, and what tells for it.

    Parameters
    ----------
    T_map_level : (4, 4) float64
        Pose of the query's levelled frame.
    covariance : (6, 6) float64
        Covariance of that, right perturbation, with the map's own [rad^2, m^2].
    explained : float
        Share of the query's surfaces that lie on the map's, less the worse they fit.
    confirmed, seen_through : float
        Shares of the map's surfaces that the query should see there: those that it does, and those that it looks
        through at something behind.
    held : bool
        Whether the match sees every direction: in a corridor without doors the place is not told along it.
    """

    T_map_level: Array
    covariance: Array
    explained: float
    confirmed: float
    seen_through: float
    held: bool

    def __post_init__(self) -> None:
        freeze(self)

    @property
    def score(self) -> float:
        """What is explained, as far as the scans do not contradict it: eq. (4)."""
        return self.explained * math.exp(-_THROUGH * self.seen_through)

    def stands(self, config: LocalizationConfig) -> bool:
        """Whether the place by itself may be the right one: the less it explains, the less may speak against it."""
        return (
            self.score >= _LEAST_SCORE * config.min_explained
            and self.explained >= config.min_explained
            and self.confirmed >= config.min_confirmed
            and self.seen_through <= config.max_seen_through
        )


def search(
    query: Query, saved: SavedMap, config: LocalizationConfig, *, known: Sequence[Array] = (), number: int = 0
) -> tuple[MapPlace, ...]:
    """Return the places that explain a query best, the best first, no two of them the same.

    The detector says where in its likeliest submaps the query would be, and correlation at every heading where in these
    and in some of the others; guesses that lead to the same place are one. They are aligned in the order of their
    promise until they promise less than is needed to be the best place's rival. It ends early where there are more
    rivals already than need be told apart: that is ambiguous whatever the others say; and where none of the most
    promising ones stands.

    Parameters
    ----------
    query : Query
    saved : SavedMap
    config : LocalizationConfig
    known : sequence of (4, 4) float64
        Poses of the levelled frame that are tried in any case, such as those of places found before.
    number : int
        Number of the query among those that look for one place: each goes through other submaps of a large map.
    """
    found: list[MapPlace] = []
    for T in known:
        submap = max(saved.around(T, _AROUND), key=lambda some: _promise(query, some, T, config, _COARSE))
        _take(found, weigh(query, submap, T, saved, config, worth=_least(found, config)), config)
    guesses = [] if _ambiguous(found, config) else _improved(query, _guesses(query, saved, config, number), config)
    for count, guess in enumerate(guesses):
        hopeless = count >= _HOPELESS and not any(place.stands(config) for place in found)
        if hopeless or _ambiguous(found, config):
            break
        T, least = guess.T_map_level, _least(found, config)
        _take(found, weigh(query, guess.submap, T, saved, config, worth=least, top=_FINER), config)
    return tuple(sorted(found, key=lambda place: -place.score))


def weigh(
    query: Query,
    submap: SavedSubmap,
    T_map_level: Array,
    saved: SavedMap,
    config: LocalizationConfig,
    *,
    moves: bool = True,
    worth: float = 0.0,
    top: int | None = None,
) -> MapPlace | None:
    """Align a query from a guess and return what tells for the place; None where there is no pose.

    Parameters
    ----------
    query : Query
    submap : SavedSubmap
        That the guess lies in.
    T_map_level : (4, 4) float64
    saved : SavedMap
    config : LocalizationConfig
    moves : bool
        Without it the guess is weighed where it is, and nothing is said of its covariance.
    worth : float
        Score below which a place is not aligned to the end: it is nobody's rival.
    top : int, optional
        Level of cubes at which alignment begins; the widest if not given.
    """
    T = np.ascontiguousarray(se3.inverse(submap.T_map_submap) @ T_map_level)
    settings = submap.cloud.config
    if not moves:
        return _place(query, submap, T, saved)
    levels = range(min(config.levels - 1 if top is None else top, config.levels - 1), -1, -1)
    T = np.ascontiguousarray(fit_levels(submap.cloud, query.cloud, T, "gicp", settings, 1, levels=levels).T)
    place = _place(query, submap, T, saved)
    if place.score < worth or place.explained < _WORTH * config.min_explained:
        return place
    result = align(submap.cloud, query.cloud, start=T, config=settings)
    if result.T_target_source is None or result.covariance is None:
        return None
    place = _place(query, submap, np.ascontiguousarray(result.T_target_source), saved)
    covariance = config.correlation * result.covariance + place.covariance
    return replace(place, covariance=covariance, held=result.status == "converged")


def _place(query: Query, submap: SavedSubmap, T_submap_level: Array, saved: SavedMap) -> MapPlace:
    """Return what tells for a pose as it is: eqs. (2) and (3); of its covariance only the map's share."""
    back = np.ascontiguousarray(se3.inverse(T_submap_level))
    seen, expected, through = query.image.sight(query.cloud.native, submap.cloud.native, 0, back, _REACH, 1)
    carry = se3.adjoint(back)
    return MapPlace(
        T_map_level=submap.T_map_submap @ T_submap_level,
        covariance=carry @ submap.covariance @ carry.T,
        explained=_explained(query, submap, T_submap_level, saved),
        confirmed=seen / max(expected, 1),
        seen_through=through / max(expected, 1),
        held=False,
    )


def _explained(query: Query, submap: SavedSubmap, T: Array, saved: SavedMap) -> float:
    """Return the robust weight of the query's matches over the number of its elements: eq. (2)."""
    matcher, settings = _core.Matcher(submap.cloud.native, 0, query.cloud.native, 0), submap.cloud.config
    sums = matcher.sums(
        T, METHODS["gicp"], False, _REACH, _KERNEL, settings.sigma, settings.min_cosine, saved.sided, False, 1
    )
    return float(sums[3]) / max(query.cloud.native.size(0), 1)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Guess:
    """A place where the query may be, and the share of it that has a counterpart there by large cubes."""

    promise: float
    submap: SavedSubmap
    T_map_level: Array

    def __post_init__(self) -> None:
        freeze(self)


def _guesses(query: Query, saved: SavedMap, config: LocalizationConfig, number: int) -> list[_Guess]:
    """Return the guesses that promise most, at most `tried` of them, no two the same."""
    points = thinned(query.cloud.points)
    places = saved.detector.query(points, allowed=np.ones(len(saved), dtype=bool), top=config.placed)
    placed = [(place.index, place.T_match_query) for place in places]
    placed += saved.headings.places(points, _looked_through([index for index, _ in placed], len(saved), config, number))
    guesses = []
    for index, T_submap_level in placed:
        submap = saved.submaps[index]
        T = submap.T_map_submap @ T_submap_level
        promise = _promise(query, submap, T, config, _COARSE)
        guesses.append(_Guess(promise=promise, submap=submap, T_map_level=T))
    return _different(guesses, _APART, _APART_DEG)[: config.tried]


def _improved(query: Query, guesses: Sequence[_Guess], config: LocalizationConfig) -> list[_Guess]:
    """Return the guesses aligned by large cubes, those that then promise enough, the most promising first."""
    out = []
    levels = range(config.levels - 1, min(_COARSE, config.levels - 1) - 1, -1)
    for guess in guesses:
        submap = guess.submap
        start = np.ascontiguousarray(se3.inverse(submap.T_map_submap) @ guess.T_map_level)
        fit = fit_levels(submap.cloud, query.cloud, start, "gicp", submap.cloud.config, 1, levels=levels)
        T = submap.T_map_submap @ fit.T
        promise = _promise(query, submap, T, config, _FINER)
        if promise >= _WORTH * config.min_explained:  # what has no counterpart explains nothing
            out.append(_Guess(promise=promise, submap=submap, T_map_level=T))
    return _different(out, config.same, config.same_deg)


def _different(guesses: Sequence[_Guess], apart: float, apart_deg: float) -> list[_Guess]:
    """Return the guesses that promise enough beside the best one, the most promising first, one of a place."""
    kept: list[_Guess] = []
    for guess in sorted(guesses, key=lambda guess: -guess.promise):
        if kept and guess.promise < _PROMISING * kept[0].promise:
            break
        if not any(near(guess.T_map_level, other.T_map_level, apart, apart_deg) for other in kept):
            kept.append(guess)
    return kept


def _promise(query: Query, submap: SavedSubmap, T_map_level: Array, config: LocalizationConfig, level: int) -> float:
    """Return the share of the query that has a counterpart in a submap, by the cubes of a level."""
    level = min(level, config.levels - 1)
    T = np.ascontiguousarray(se3.inverse(submap.T_map_submap) @ T_map_level)
    return float(submap.cloud.native.overlap(level, query.cloud.native, level, T, config.voxel * 2.0**level, 1))


def _looked_through(likely: Sequence[int], count: int, config: LocalizationConfig, number: int) -> list[int]:
    """Return the submaps in which every heading is tried: half of them the likeliest, then the others in turn."""
    chosen = list(dict.fromkeys(likely))[: config.headings // 2]
    others = [index for index in range(count) if index not in set(chosen)]
    room = min(config.headings - len(chosen), len(others))
    begin = number * room
    return chosen + [others[(begin + k) % len(others)] for k in range(room)]


def _take(found: list[MapPlace], place: MapPlace | None, config: LocalizationConfig) -> None:
    """Add a place; of two that are the same the better one stays."""
    if place is None:
        return
    same = [
        k for k, other in enumerate(found) if near(other.T_map_level, place.T_map_level, config.same, config.same_deg)
    ]
    if not same:
        found.append(place)
    elif place.score > found[same[0]].score:
        found[same[0]] = place


def _least(found: Sequence[MapPlace], config: LocalizationConfig) -> float:
    """Return the score that a place must have at least to be a rival of the best so far."""
    return _SPARED * config.rival * max((place.score for place in found if place.stands(config)), default=0.0)


def _ambiguous(found: Sequence[MapPlace], config: LocalizationConfig) -> bool:
    """Whether enough places explain the query alike."""
    best = max((place.score for place in found), default=0.0)
    standing = [place for place in found if place.stands(config)]
    return sum(place.score >= config.rival * best for place in standing) > config.max_rivals
