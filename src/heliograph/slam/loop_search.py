"""The search for loops: who may show a keyframe's place, and does it match."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from heliograph.arrays import Array, Mask, Points, freeze
from heliograph.config import LoopConfig, PlacesConfig, SlamConfig
from heliograph.lie import se3
from heliograph.slam.covariances import OdometryChain
from heliograph.slam.descriptor_file import DescriptorFile
from heliograph.slam.loops import (
    LocalMaps,
    LoopEvidence,
    LoopStart,
    RelativePose,
    local_map,
    loop_align_config,
    rank_places,
    verification,
    within_reach,
)
from heliograph.slam.places import body_guess, level_points, make_detector
from heliograph.slam.store import KeyframeStore
from heliograph.snapshots import Snapshot, Stateful, fixed

__all__ = ["Candidate", "LoopSearch"]

_REMEMBERED = 8  # latest loops by which the graph may know the way
_PULLED_IN = 0.3  # a position known so well needs no detector: registration finds the rest [m], one-sigma
_TURNED_IN = np.radians(3.0)  # the same of rotation
_DESCRIBED = 2  # every second keyframe has a descriptor: its neighbours look like it
_CATCH_UP = 4  # descriptors made at one keyframe, so that none has to wait for hundreds
_TURNED_APART = 30.0  # distance that counts as much as being turned by 120 degrees [m]: the field of view may be narrow
_TRIED = 3  # such places
_MAX_POINTS = 30_000  # of a local map that is described
_ANCHOR = 5  # of places known so well every fifth keyframe is matched with: neighbours share its local map


@dataclass(frozen=True, slots=True, kw_only=True)
class Candidate:
    """An earlier keyframe that may show the same place, and guesses of the query's pose in it beside the graph's.

    Parameters
    ----------
    match : int
    score : float
        Likeness by the detector; NaN where the poses propose it.
    starts : tuple of LoopStart
    sure : bool
        Whether the graph knows the way there well enough for a registration.
    """

    match: int
    score: float = float("nan")
    starts: tuple[LoopStart, ...] = ()
    sure: bool = False

    def __post_init__(self) -> None:
        freeze(self)


class _Clouds:
    """The keyframes' clouds, from the store, and their poses, which are in memory."""

    def __init__(self, store: KeyframeStore, chain: OdometryChain) -> None:
        self._store, self._chain = store, chain

    def points(self, index: int) -> Points:
        return self._store.points(index)

    def T_odom_imu(self, index: int) -> Array:
        return self._chain.pose(index)


class LoopSearch(Stateful):
    """Descriptors and local maps of all keyframes so far.

    Parameters
    ----------
    store : KeyframeStore
    chain : OdometryChain
        Poses of the odometry and how uncertain it leaves the way from one to another.
    slam, places, loops : SlamConfig, PlacesConfig, LoopConfig
    """

    _STATE: ClassVar = {"_described": [int], "_standing": [LoopEvidence], "held": [fixed(int, int, int)]}

    def __init__(
        self, store: KeyframeStore, chain: OdometryChain, slam: SlamConfig, places: PlacesConfig, loops: LoopConfig
    ) -> None:
        self._chain, self._slam, self._config = chain, slam, loops
        self._clouds = _Clouds(store, chain)
        self._detector = make_detector(places)
        self._descriptors = DescriptorFile(store.path / "descriptors.bin")
        self._described: list[int] = []
        self._maps = LocalMaps(self._clouds, loop_align_config(loops))
        self._standing: tuple[LoopEvidence, ...] = ()

    @property
    def held(self) -> list[tuple[int, int, int]]:
        """The local maps that are there: they tell in how many pieces the next search is done."""
        return self._maps.held

    @held.setter
    def held(self, maps: list[tuple[int, int, int]]) -> None:
        self._maps.hold(maps)

    def restore(self, snapshot: Snapshot) -> None:
        """Take up the state of another search over the same keyframes; descriptors come from their file.

        Raises
        ------
        DataError
            It is none of a search.
        FormatError
            The file of descriptors is not whole.
        """
        super().restore(snapshot)
        for index, descriptor in zip(self._described, self._descriptors.cut(len(self._described)), strict=True):
            self._detector.add(index, descriptor)

    def settle(self) -> None:
        """Have the file of descriptors put on the disk itself."""
        self._descriptors.settle()

    def close(self) -> None:
        """Release the file of descriptors."""
        self._descriptors.close()

    def closed(self, loops: Sequence[LoopEvidence]) -> None:
        """Take note of the loops that stand: by them the graph knows the way."""
        self._standing = tuple(loops)[-_REMEMBERED:]

    def due(self, query: int) -> bool:
        """Whether loops are to be looked for at the newest keyframe; brings the descriptors up to date besides."""
        if query <= self._config.apart:
            return False
        sigma = np.sqrt(self._chain.variances(query, query, 0, 1)[0, 3:].max())
        if sigma > 0.5 * _PULLED_IN:
            self._describe(query)  # a detector will be needed soon
        return query % self._slam.loop_every == 0 and bool(sigma >= self._slam.loop_worth)

    def candidates(self, query: int, T_map_imu: Array) -> tuple[Candidate, ...]:
        """Return the places to look at for the newest keyframe, the most promising first.

        Where the way is known well enough for a registration, the nearest keyframe is the place; elsewhere the detector
        ranks all that the covariance allows.

        Parameters
        ----------
        query : int
        T_map_imu : (K, 4, 4) float64
            Poses of all keyframes as the graph has them now.
        """
        count = query - self._config.apart
        odometry, known = self._open(query, count)
        p_odom, p_map = self._chain.T_odom_imu[:, :3, 3], T_map_imu[:, :3, 3]
        by_graph = within_reach(p_map[query], p_map[:count], known[:, 3:], self._config)
        worth = odometry[:, 3:].max(axis=1) >= self._slam.loop_worth
        sure = (known[:, 3:].max(axis=1) <= _PULLED_IN) & (known[:, :3].max(axis=1) <= _TURNED_IN)
        near = np.flatnonzero(by_graph & worth & sure)
        found = self._nearest(query, near, T_map_imu) if len(near) else []
        by_odometry = within_reach(p_odom[query], p_odom[:count], odometry[:, 3:], self._config)
        if (unsure := (by_graph | by_odometry) & worth & ~sure).any():
            found += self._alike(query, unsure, T_map_imu)
        return tuple(found)

    def verification(self, query: int, candidate: Candidate, T_map_imu: Array) -> Generator[None, None, LoopEvidence]:
        """Register the query against a candidate from the graph's pose and its guesses, in pieces."""
        return verification(
            query, candidate.match, self._maps, candidate.starts, self._relative(T_map_imu), newest=query,
            config=self._config, score=candidate.score, sure=candidate.sure,
        )  # fmt: skip

    def _relative(self, T_map_imu: Array) -> RelativePose:
        """Return ``T_a_b`` as the graph has it, and its covariance by odometry or over the loop that knows it best."""

        def relative(a: int, b: int) -> tuple[Array, Array]:
            T, covariance = self._chain.relative(a, b)
            if b - a < self._config.apart or not self._standing:
                return T, covariance
            for loop in self._standing:
                T_q_b, after = self._chain.relative(loop.query, b)
                _, before = self._chain.relative(a, loop.match)
                to_query, to_b = se3.adjoint(se3.inverse(loop.T_match_query)), se3.adjoint(se3.inverse(T_q_b))
                over = after + to_b @ (loop.covariance + to_query @ before @ to_query.T) @ to_b.T
                if np.trace(over[3:, 3:]) < np.trace(covariance[3:, 3:]):
                    covariance = over
            return np.ascontiguousarray(se3.inverse(T_map_imu[a]) @ T_map_imu[b]), np.asarray(covariance)

        return relative

    def _open(self, query: int, count: int) -> tuple[Array, Array]:
        """Return what odometry leaves open of the query's pose against each keyframe, and the graph with its loops.

        Both are (count, 6): one-sigmas of rotation and position about and along odom's axes [rad], [m].
        """
        odometry = known = self._chain.variances(query, query, 0, count)
        for loop in self._standing:
            detour = self._chain.variances(query, query, loop.query, loop.query + 1)
            detour = detour + self._chain.variances_of(query, loop.query, loop.covariance)
            known = np.minimum(known, detour + self._chain.variances(query, loop.match, 0, count))
        return np.sqrt(odometry), np.sqrt(known)

    def _nearest(self, query: int, near: np.ndarray, T_map_imu: Array) -> list[Candidate]:
        """Return the places that should share most with the query: near by, and seen in the same direction."""
        anchors = near[near % _ANCHOR == 0]
        some = anchors if len(anchors) else near
        apart = np.linalg.norm(T_map_imu[some, :3, 3] - T_map_imu[query, :3, 3], axis=1)
        turned = 1.0 - np.einsum("nij,ij->n", T_map_imu[some, :3, :3], T_map_imu[query, :3, :3]) / 3.0
        best = some[np.argsort(apart + _TURNED_APART * turned, kind="stable")[:_TRIED]]
        return [Candidate(match=int(k), sure=True) for k in best]

    def _alike(self, query: int, allowed: Mask, T_map_imu: Array) -> list[Candidate]:
        indices = np.array(self._described, dtype=np.int64)
        mask = np.zeros(len(indices), dtype=bool)
        old = indices < len(allowed)
        mask[old] = allowed[indices[old]]
        if not mask.any():
            return []
        places = self._detector.query(self._level(query), allowed=mask, top=self._config.placed)
        found = []
        for place in rank_places(query, places, self._clouds, self._relative(T_map_imu), self._config):
            poses = self._chain.pose(place.index), self._chain.pose(query)
            start = LoopStart(source="place", T_match_query=body_guess(place.T_match_query, *poses))
            # A turn alone says nothing of the position: the graph's own start has the better one.
            starts = () if place.yaw_only else (start,)
            found.append(Candidate(match=place.index, score=place.score, starts=starts))
        return found

    def _describe(self, query: int) -> None:
        """Bring the detector up to date, some keyframes at a time: it may never be needed, and then all at once."""
        begin = self._described[-1] + _DESCRIBED if self._described else 0
        for index in range(begin, query, _DESCRIBED)[:_CATCH_UP]:
            descriptor = self._detector.describe(self._level(index))
            self._detector.add(index, descriptor)
            self._descriptors.append(descriptor)
            self._described.append(index)

    def _level(self, index: int) -> Points:
        first = max(0, index - self._config.before)
        points = local_map(self._clouds, index, range(first, index + 1))
        return level_points(points[:: 1 + len(points) // _MAX_POINTS], self._chain.pose(index))
