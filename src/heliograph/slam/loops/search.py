"""From a query to evidence: which keyframes may be looked at, who looks like it, and who registers."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from heliograph.arrays import Array, Mask
from heliograph.config import LoopConfig
from heliograph.slam.loops.judge import judge
from heliograph.slam.loops.records import LoopEvidence, LoopStart, RelativePose
from heliograph.slam.loops.submaps import LocalMaps, Submaps
from heliograph.slam.loops.tangent import gate_of
from heliograph.slam.loops.verify import guess_distance, verify
from heliograph.slam.places import PlaceMatch, body_guess

__all__ = ["rank_places", "verify_places", "within_reach"]

_SIGMAS = 3.0


def within_reach(p_odom_query: Array, p_odom: Array, sigma: Array, config: LoopConfig | None = None) -> Mask:
    """Return which keyframes may show the query's place, as far as odometry knows, (K,).

    Parameters
    ----------
    p_odom_query : (3,) float64
        Position of the query [m].
    p_odom : (K, 3) float64
        Positions of the keyframes [m].
    sigma : (K, 3) float64
        One-sigmas of the query's position relative to theirs, along odom's axes [m].
    config : LoopConfig, optional
    """
    c = config or LoopConfig()
    off = np.maximum(np.abs(p_odom - p_odom_query) - _SIGMAS * sigma, 0.0)
    return np.asarray((np.hypot(off[:, 0], off[:, 1]) <= c.reach) & (off[:, 2] <= c.reach_up))


def rank_places(
    query: int,
    places: Sequence[PlaceMatch],
    submaps: Submaps,
    relative: RelativePose,
    config: LoopConfig | None = None,
) -> tuple[PlaceMatch, ...]:
    """Return the best places, those first whose guess odometry allows; a twin of the place is not among those.

    The others follow by their distance as odometry has it: where the detector is wrong, the nearest is the best bet.

    Parameters
    ----------
    query : int
        Keyframe.
    places : sequence of PlaceMatch
        A detector's answer, `placed` of them.
    submaps : Submaps
        Poses of the keyframes.
    relative : callable
        Keyframes a < b -> odometry's ``T_a_b`` and its covariance.
    config : LoopConfig, optional
    """
    c = config or LoopConfig()
    gate, T_query = gate_of(c.gate_probability), submaps.T_odom_imu(query)

    def order(place: PlaceMatch) -> tuple[bool, float]:
        prior = relative(place.index, query)
        T = body_guess(place.T_match_query, submaps.T_odom_imu(place.index), T_query)
        excluded = not place.yaw_only and guess_distance(T, prior, c) > gate
        return excluded, float(np.linalg.norm(prior[0][:3, 3])) if excluded else 0.0

    return tuple(sorted(places, key=order)[: c.candidates])


def verify_places(
    query: int,
    places: Sequence[PlaceMatch],
    maps: LocalMaps,
    relative: RelativePose,
    *,
    newest: int,
    config: LoopConfig | None = None,
    threads: int = 1,
) -> tuple[LoopEvidence, ...]:
    """Verify places in their order until one is not refused by itself; return the evidence of all that were looked at.

    Parameters
    ----------
    query : int
        Keyframe.
    places : sequence of PlaceMatch
        In the order in which to try them, see `rank_places`.
    maps : LocalMaps
    relative : callable
        Keyframes a < b -> odometry's ``T_a_b`` and its covariance.
    newest : int
        Last keyframe that there is.
    config : LoopConfig, optional
    threads : int
    """
    config = config or LoopConfig()
    found: list[LoopEvidence] = []
    T_query = maps.submaps.T_odom_imu(query)
    for place in places:
        T = body_guess(place.T_match_query, maps.submaps.T_odom_imu(place.index), T_query)
        # A turn alone says nothing of the position: odometry's own start has the better one.
        starts = () if place.yaw_only else (LoopStart(source="place", T_match_query=T),)
        evidence = verify(query, place.index, maps, starts, relative, newest=newest, config=config,
                          score=place.score, threads=threads)  # fmt: skip
        found.append(evidence)
        if judge(evidence, config).verdict != "rejected":
            break
    return tuple(found)
