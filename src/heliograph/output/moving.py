"""What moved while the map was made: cubes that other scans saw through."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from heliograph.config import OutputConfig
from heliograph.maps import GlobalMap, Sight, count_seen_through

__all__ = ["MAX_SIGHTS", "seen_through"]

MAX_SIGHTS = 128  # scans that a tile is held against: an even choice of more
_STAYED = 6  # visits that saw a cube, from which on it is taken to stand there
_RADIUS = 0.02, 0.1  # a ray passes through a cube within half its edge of the mean, between these [m]
_GRAZING = 0.26  # sine of 15 degrees
_TOGETHER = 0.5  # share of the occupied cubes about one that go with it: edges of what stands go alone, bodies do not
_SAMPLED, _MANY = 3, 4  # of three times four scans and more a third is asked first: most cubes none of them saw through
_FILL = 0.6, 3  # share, and number, of cubes gone about one that a single ray through it is enough for


def seen_through(whole: GlobalMap, sights: Sequence[Sight], config: OutputConfig) -> NDArray[np.bool_]:
    """Return which cubes (M,) hold what moved: few visits saw it, many scans saw through it, and so about it.

    When in doubt a cube stays. Nothing is said of surfaces at grazing incidence, of what many visits saw, and of what
    stands alone among others that stay.

    Parameters
    ----------
    whole : GlobalMap
        A tile.
    sights : sequence of Sight
        Scans from its neighbourhood.
    config : OutputConfig
    """
    gone = np.zeros(len(whole), dtype=bool)
    visits = whole.visits()
    needed = np.maximum(config.moving_votes, config.moving_ratio * visits)
    asked = np.flatnonzero((visits <= _STAYED) & (needed <= len(sights))).astype(np.uint32)
    if not len(asked):
        return gone
    means = whole.means()[asked]
    every = _SAMPLED if len(sights) >= _SAMPLED * _MANY else 1
    votes = _votes(means, None, sights[::every], whole, config)
    if every > 1:
        some = votes > 0
        asked, means, votes = asked[some], means[some], votes[some]
        rest = [sight for k, sight in enumerate(sights) if k % every]
        votes = votes + _votes(means, None, rest, whole, config)
    likely = votes >= needed[asked]
    if not likely.any():
        return gone
    some = asked[likely]
    confirmed = _votes(means[likely], whole.normals(some), sights, whole, config) >= needed[some]
    gone[some[confirmed]] = True
    return _together(whole, gone, asked[votes > 0])


def _votes(
    means: NDArray[np.float64],
    normals: NDArray[np.float32] | None,
    sights: Sequence[Sight],
    whole: GlobalMap,
    config: OutputConfig,
) -> NDArray[np.uint16]:
    votes = np.zeros(len(means), dtype=np.uint16)
    radius = float(np.clip(0.5 * whole.voxel, *_RADIUS))
    for sight in sights:
        count_seen_through(
            means, sight, votes, normals=normals, radius=radius, reach=config.moving_reach,
            margin=config.moving_margin, grazing=_GRAZING,
        )  # fmt: skip
    return votes


def _together(whole: GlobalMap, gone: NDArray[np.bool_], doubtful: NDArray[np.uint32]) -> NDArray[np.bool_]:
    """Take back what would go alone, and let go what a ray passed through and has next to nothing left about it."""
    candidates = np.flatnonzero(gone).astype(np.uint32)
    near, around = whole.marked_around(candidates, gone).T
    sure = np.array(gone)
    sure[candidates[near < _TOGETHER * around]] = False
    near, around = whole.marked_around(doubtful, sure).T
    share, number = _FILL
    sure[doubtful[(near >= share * around) & (near >= number)]] = True
    return np.asarray(sure, dtype=np.bool_)
