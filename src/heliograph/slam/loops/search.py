"""Which keyframes may be looked at, and which of those that look like the query come first."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from heliograph.arrays import Array, Mask
from heliograph.config import LoopConfig
from heliograph.slam.loops.records import RelativePose
from heliograph.slam.loops.submaps import Submaps
from heliograph.slam.loops.tangent import gate_of
from heliograph.slam.loops.verify import guess_distance
from heliograph.slam.places import PlaceMatch, body_guess

__all__ = ["rank_places", "within_reach"]

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
