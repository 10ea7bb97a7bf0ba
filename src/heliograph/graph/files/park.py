"""A park whose trees a vehicle sees again and again while its odometry drifts: landmark SLAM whose truth is known."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from heliograph.arrays import Array, Indices, freeze
from heliograph.errors import ConfigError
from heliograph.graph.files.posegraph import PoseGraphFile
from heliograph.graph.files.row_kinds import KINDS, numbers_of
from heliograph.graph.files.tables import Table
from heliograph.lie import SE2, se2

__all__ = ["Park", "park"]


_TURN = 0.12  # [rad] largest turn a step


@dataclass(frozen=True, kw_only=True, eq=False)  # without slots: the file is kept once made
class Park:
    """True poses and trees, odometry and sightings.

    Parameters
    ----------
    truth : SE2, batch of N
        T_world_i; pose i has the id i, and pose 0 is at the origin.
    trees : (M, 2) float64
        p_world of the trees that are seen; tree k has the id N + k.
    T_i_j : SE2, batch of N - 1
        Measured odometry.
    pose, tree : (S,) int64
        Who sees what.
    p_i : (S, 2) float64
        Measured, in the frame of the pose [m].
    sigmas : (float, float, float)
        Standard deviation of a step's rotation [rad] and translation [m], and of a sighting [m].
    """

    truth: SE2
    trees: Array
    T_i_j: SE2
    pose: Indices
    tree: Indices
    p_i: Array
    sigmas: tuple[float, float, float]

    def __post_init__(self) -> None:
        freeze(self)

    @cached_property
    def file(self) -> PoseGraphFile:
        """The graph without any value: a start has to come from its odometry."""
        n = len(self.truth)
        turn, shift, sight = self.sigmas
        ends = np.stack([np.arange(n - 1), np.arange(1, n)], axis=1)
        seen = np.stack([self.pose, n + self.tree], axis=1)
        step = KINDS["EDGE_SE2"]
        tables = (
            Table.of(step, ends, numbers_of(step, self.T_i_j.matrix), _tiled(np.array([turn, shift, shift]), n - 1)),
            Table.of(KINDS["EDGE_SE2_XY"], seen, self.p_i, _tiled(np.array([sight, sight]), len(seen))),
        )
        none = np.zeros(0, dtype=np.int64)
        return PoseGraphFile(dimension=2, tables=tables, fixed=none, fixed_line=none)


def _tiled(sigmas: Array, count: int) -> Array:
    return np.broadcast_to(np.diag(sigmas**-2.0), (count, len(sigmas), len(sigmas)))


def park(
    poses: int,
    rng: np.random.Generator,
    *,
    trees: int = 150,
    side: float = 150.0,
    reach: float = 25.0,
    seen: float = 0.5,
    step: float = 0.6,
    sigmas: tuple[float, float, float] = (0.03, 0.1, 0.3),
) -> Park:
    """Return a drive from one random place of a square to the next, past trees, as Victoria Park is one.

    Parameters
    ----------
    poses : int
        How many, at least 2.
    rng : numpy Generator
        Where chance comes from.
    trees : int
        Trees in the square.
    side : float
        Side of the square [m].
    reach : float
        How far ahead a tree is seen [m].
    seen : float
        Sightings a pose on average, where as many trees are in view.
    step : float
        Length of a step [m].
    sigmas : (float, float, float)
        Standard deviation of a step's rotation [rad] and translation [m] along each axis, and of a sighting [m].
    """
    if poses < 2 or trees < 1 or not min(sigmas) > 0.0:
        raise ConfigError(f"a park needs at least 2 poses, a tree and positive sigmas, not {poses}, {trees}, {sigmas}")
    truth = _drive(poses, rng, side, step)
    places = rng.uniform(0.0, side, size=(trees, 2))
    first = truth[0].inverse()
    T, places = first.matrix @ truth.matrix, (first.matrix @ np.c_[places, np.ones(trees)].T).T[:, :2]
    p = np.einsum("nab,nma->nmb", T[:, :2, :2], places[None] - T[:, None, :2, 2])
    view = (p[:, :, 0] > 0.0) & (np.linalg.norm(p, axis=2) < reach)
    count = view.sum(axis=1, keepdims=True)
    chosen = view & (rng.random(view.shape) < seen / np.maximum(count, seen))
    pose, tree = np.nonzero(chosen)
    kept, tree = np.unique(tree, return_inverse=True)
    relative = SE2(se2.inverse(T[:-1]) @ T[1:])
    turn, shift, sight = sigmas
    return Park(
        truth=SE2(T),
        trees=places[kept],
        T_i_j=relative.retract(np.array([turn, shift, shift]) * rng.standard_normal((poses - 1, 3))),
        pose=pose,
        tree=tree.reshape(-1),
        p_i=p[pose, kept[tree.reshape(-1)]] + sight * rng.standard_normal((len(pose), 2)),
        sigmas=sigmas,
    )


def _drive(poses: int, rng: np.random.Generator, side: float, step: float) -> SE2:
    """Return poses that steer to random places with a bounded turn a step."""
    place, heading = np.array([0.5 * side, 0.5 * side]), 0.0
    goal = rng.uniform(0.0, side, size=2)
    rows = np.empty((poses, 3))
    for k in range(poses):
        rows[k] = heading, *place
        away = goal - place
        if np.hypot(*away) < 0.1 * side:
            goal = rng.uniform(0.0, side, size=2)
        off = (np.arctan2(away[1], away[0]) - heading + np.pi) % (2.0 * np.pi) - np.pi
        heading += float(np.clip(off, -_TURN, _TURN))
        place = place + step * np.array([np.cos(heading), np.sin(heading)])
    R = np.stack([[np.cos(rows[:, 0]), -np.sin(rows[:, 0])], [np.sin(rows[:, 0]), np.cos(rows[:, 0])]])
    return SE2.from_rotation_translation(np.moveaxis(R, 2, 0), rows[:, 1:])
