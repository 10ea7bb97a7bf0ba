"""Pose graphs of any size whose truth is known, for tests, benchmarks and experiments."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import Array, Indices, freeze
from heliograph.errors import ConfigError
from heliograph.graph.files.posegraph import PoseGraphFile
from heliograph.lie import SE2, SE3, se2, se3, so2, so3

__all__ = ["World", "drive", "grid_walk", "manhattan", "sphere", "torus", "uneven", "with_false_loops"]


_TURNS = np.array([0, 1, -1])
_RECENT = 10  # poses back to which no loop is closed: odometry says the same


@dataclass(frozen=True, kw_only=True, eq=False)  # without slots: the file is kept once made
class World:
    """True poses and noisy relative poses between them.

    Parameters
    ----------
    truth : SE2 or SE3, batch of N
        T_world_i; pose i has the id i, and pose 0 is at the origin.
    i, j : (E,) int64
        What each relative pose joins; the first N - 1 are the odometry, in order.
    T_i_j : SE2 or SE3, batch of E
        Measured relative poses: the true ones, perturbed on the right.
    information : (d, d) or (E, d, d) float64
        Inverse covariance of all or of each, rotation first.
    false : (E,) bool
        Loops that are none, see `with_false_loops`.
    """

    truth: SE2 | SE3
    i: Indices
    j: Indices
    T_i_j: SE2 | SE3
    information: Array
    false: NDArray[np.bool_]

    def __post_init__(self) -> None:
        freeze(self)

    @cached_property
    def file(self) -> PoseGraphFile:
        """The pose graph without any value: a start has to come from its relative poses."""
        information = np.broadcast_to(self.information, (len(self.i), *self.information.shape[-2:]))
        return PoseGraphFile.of(self.truth.space, edges=(self.i, self.j, self.T_i_j.matrix, information))

    @property
    def loops(self) -> int:
        """Number of relative poses beside the odometry."""
        return len(self.i) - len(self.truth) + 1


def manhattan(
    poses: int,
    rng: np.random.Generator,
    *,
    block: int = 4,
    step: float = 1.0,
    visits: float = 4.0,
    loops: float = 0.56,
    sigmas: tuple[float, float] = (0.01, 0.02),
) -> World:
    """Return a walk through a city of square blocks, as M3500 is one.

    The city's area grows with the number of poses, so that a place is visited equally often in a walk of any length:
    the graph gets larger, not denser.

    Parameters
    ----------
    poses : int
        How many, at least 2.
    rng : numpy Generator
        Where chance comes from.
    block : int
        Steps from corner to corner, where the walk goes straight on, left or right with equal chance; it turns round
        at the edge of the city.
    step : float
        Length of a step [m].
    visits : float
        Mean number of visits to a place.
    loops : float
        Loops a pose, to the last visit of the same place or of one a step away; fewer where visits are too few
        (M3500: 0.56).
    sigmas : (float, float)
        Standard deviation of a relative pose's rotation [rad] and translation [m] along each axis.
    """
    _check(poses, sigmas)
    corners = poses / (visits * (2 * block - 1))
    side = block * max(int(np.ceil(np.sqrt(corners))) - 1, 1)
    stretches = -(-poses // block)
    turns = rng.choice(_TURNS, size=stretches)
    turns[0] = 0
    heading = np.repeat(np.cumsum(turns) % 4, block)[: poses - 1]
    axis, sign = heading % 2, 1 - 2 * (heading // 2)
    moves = np.where(axis[:, None] == np.arange(2), sign[:, None], 0)
    cells = _folded(moves, np.array([side, side]))
    R = so2.exp(np.array([0.0, 0.5 * np.pi, np.pi, -0.5 * np.pi])[_direction(cells)][:, None])
    i, j = _loops(cells, loops, rng)
    truth = _from_first(SE2.from_rotation_translation(R, step * cells.astype(np.float64)))
    return _measured(truth, i, j, sigmas, rng)


def drive(
    poses: int, rng: np.random.Generator, *, loops: float = 137 / 4541, sigmas: tuple[float, float] = (0.0018, 0.05)
) -> World:
    """Return a long drive through a city with few loops, as kitti_00 is one; arguments as for `manhattan`."""
    return manhattan(poses, rng, block=120, step=0.8, visits=2.0, loops=loops, sigmas=sigmas)


def grid_walk(
    poses: int,
    rng: np.random.Generator,
    *,
    levels: int | None = None,
    visits: float = 4.0,
    loops: float = 0.56,
    sigmas: tuple[float, float] = (0.01, 0.02),
) -> World:
    """Return a walk along the lines of a grid of 1 m in space; arguments as for `manhattan`.

    The axis of motion changes with chance 2/3 at every step; the body looks along it.

    Parameters
    ----------
    levels : int, optional
        Cells along z, the floors of a building; a cube without. To eliminate a cube of n poses takes work of
        order n^2 whatever the solver, for every cut through it is a face; a building grows as a city does.
    """
    _check(poses, sigmas)
    if levels is not None and levels < 2:
        raise ConfigError(f"a walk in space needs at least 2 levels, not {levels}; use manhattan for one")
    cells_wanted = poses / visits
    across = np.cbrt(cells_wanted) if levels is None else np.sqrt(cells_wanted / levels)
    side = max(int(np.ceil(across)) - 1, 1)
    sides = np.array([side, side, side if levels is None else levels - 1])
    change = rng.integers(0, 3, size=poses - 1)
    change[0] = 0
    axis = np.cumsum(change) % 3
    # The sense of motion is drawn where the axis changes and kept until it does again.
    chosen = np.maximum.accumulate(np.where(change > 0, np.arange(poses - 1), 0))
    sign = (2 * rng.integers(0, 2, size=poses - 1) - 1)[chosen]
    cells = _folded(np.where(axis[:, None] == np.arange(3), sign[:, None], 0), sides)
    R = _LOOKING[_direction(cells)]
    i, j = _loops(cells, loops, rng)
    truth = _from_first(SE3.from_rotation_translation(R, cells.astype(np.float64)))
    return _measured(truth, i, j, sigmas, rng)


def sphere(
    rings: int,
    per_ring: int,
    rng: np.random.Generator,
    *,
    radius: float = 50.0,
    sigmas: tuple[float, float] = (0.05, 0.1),
) -> World:
    """Return a spiral over a sphere, every pose joined with the one a turn before, as in sphere2500 (50 of 50)."""
    n = rings * per_ring
    k = np.arange(n)
    turn = 2.0 * np.pi * k / per_ring
    height = np.pi * (k + 0.5) / n
    across = np.sin(height)
    p = radius * np.stack([across * np.cos(turn), across * np.sin(turn), -np.cos(height)], axis=1)
    return _surface(p, turn, per_ring, sigmas, rng)


def torus(
    rings: int,
    per_ring: int,
    rng: np.random.Generator,
    *,
    radii: tuple[float, float] = (20.0, 8.0),
    sigmas: tuple[float, float] = (0.05, 0.1),
) -> World:
    """Return a coil round a torus, every pose joined with the one a turn before (torus3D: 100 rings of 50)."""
    k = np.arange(rings * per_ring)
    turn, along = 2.0 * np.pi * k / per_ring, 2.0 * np.pi * k / (rings * per_ring)
    across = radii[0] + radii[1] * np.cos(turn)
    p = np.stack([across * np.cos(along), across * np.sin(along), radii[1] * np.sin(turn)], axis=1)
    return _surface(p, turn, per_ring, sigmas, rng)


def uneven(rng: np.random.Generator, *, poses: int = 600, every: int = 60) -> World:
    """Return a walk with stops, whose information reaches from 20 to 4e8.

    On the way a step is known to 0.22 m, during a stop the body is known to stand to 0.05 mm. Nothing in the graph is
    singular, but a solver that takes a pivot for zero because 10^7 times as much was subtracted calls it so.

    Parameters
    ----------
    rng : numpy Generator
        Where chance comes from.
    poses : int
        How many.
    every : int
        Poses from one stop, four poses long, to the next.
    """
    world = manhattan(poses, rng, step=5.0, sigmas=(0.005, 0.22))
    T = world.truth.matrix.copy()
    stop = np.arange(every, poses - 4, every)
    for k in range(1, 4):
        T[stop + k] = T[stop]
    truth = type(world.truth)(T)
    sigma = np.tile([0.005, 0.22, 0.22], (len(world.i), 1))
    for k in range(3):
        sigma[stop + k, 1:] = 5e-5
    relative = type(truth)(truth.ops.inverse(T[world.i]) @ T[world.j])
    return replace(
        world,
        truth=truth,
        T_i_j=relative.retract(sigma * rng.standard_normal(sigma.shape)),
        information=np.einsum("ni,ij->nij", sigma**-2.0, np.eye(3)),
    )


def with_false_loops(world: World, fraction: float, rng: np.random.Generator) -> World:
    """Return the world with false loops added: random pairs of poses with random relative poses.

    Parameters
    ----------
    world : World
        What to spoil.
    fraction : float
        How many, as a part of its loops: 0.5 adds half as many again.
    rng : numpy Generator
        Where chance comes from. Rotations are uniform, translations as far as the world's poses are apart; where each
        relative pose has its own information, a false one claims that of a loop.
    """
    count = round(fraction * world.loops)
    n = len(world.truth)
    first = rng.integers(0, n, size=count)
    second = (first + rng.integers(2, max(n - 1, 3), size=count)) % n
    t = rng.permutation(world.truth.translation)[first] - world.truth.translation[second]
    if isinstance(world.truth, SE2):
        drawn: Array = se2.from_rotation_translation(so2.exp(rng.uniform(-np.pi, np.pi, size=(count, 1))), t)
    else:
        drawn = se3.from_rotation_translation(so3.from_quaternion(rng.normal(size=(count, 4))), t)
    information = world.information
    if information.ndim == 3 and count:
        claimed = rng.integers(n - 1 if world.loops else 0, len(information), size=count)
        information = np.concatenate([information, information[claimed]])
    return replace(
        world,
        information=information,
        i=np.concatenate([world.i, np.minimum(first, second)]),
        j=np.concatenate([world.j, np.maximum(first, second)]),
        T_i_j=type(world.T_i_j)(np.concatenate([world.T_i_j.matrix, drawn])),
        false=np.concatenate([world.false, np.ones(count, dtype=bool)]),
    )


def _check(poses: int, sigmas: tuple[float, float]) -> None:
    if poses < 2:
        raise ConfigError(f"a walk of {poses} poses has no relative pose; ask for at least 2")
    if not min(sigmas) > 0.0:
        raise ConfigError(f"sigmas {sigmas} must be positive: the information is their inverse square")


def _folded(moves: Indices, side: Indices) -> Indices:
    """Return the cells of a walk that is thrown back at the edges of [0, side] along each axis, side (d,)."""
    start = np.zeros((1, moves.shape[1]), dtype=np.int64)
    free = np.concatenate([start, np.cumsum(moves, axis=0)])
    return np.asarray(side - np.abs(free % (2 * side) - side))


def _direction(cells: Indices) -> Indices:
    """Return the direction from which each cell was reached: axis, or axis + d against it; the first looks along x."""
    d = cells.shape[1]
    step = np.diff(cells, axis=0)
    axis = np.argmax(step != 0, axis=1)
    back = np.take_along_axis(step, axis[:, None], axis=1)[:, 0] < 0
    return np.concatenate([[0], axis + d * back])


# The body's x axis looks along +x, +y, +z, -x, -y, -z.
_LOOKING = np.stack(
    [
        so3.exp(phi)
        for phi in 0.5
        * np.pi
        * np.array([[0, 0, 0], [0, 0, 1], [0, -1, 0], [0, 0, 2], [0, 0, -1], [0, 1, 0]], dtype=float)
    ]
)


def _loops(cells: Indices, per_pose: float, rng: np.random.Generator) -> tuple[Indices, Indices]:
    """Return loops (earlier, later): each to the last visit of the same cell or of a neighbouring one."""
    n, d = cells.shape
    offset = np.zeros((n, d), dtype=np.int64)
    near = np.flatnonzero(rng.random(n) < 0.5)
    offset[near, rng.integers(0, d, size=len(near))] = 2 * rng.integers(0, 2, size=len(near)) - 1
    weights = (int(cells.max()) + 3) ** np.arange(d)
    place = (cells + 1) @ weights
    # Visits sorted by place, then time: the last one before a time is found by bisection.
    visits = np.sort(place * n + np.arange(n))
    wanted = (cells + offset + 1) @ weights
    found = visits[np.searchsorted(visits, wanted * n + np.arange(n) - _RECENT) - 1]
    later = np.flatnonzero(found // n == wanted)
    count = min(round(per_pose * n), len(later))
    later = np.sort(rng.choice(later, size=count, replace=False))
    return found[later] % n, later


def _surface(p: Array, turn: Array, per_ring: int, sigmas: tuple[float, float], rng: np.random.Generator) -> World:
    R = so3.exp(np.stack([np.zeros_like(turn), np.zeros_like(turn), turn], axis=1))
    later = np.arange(per_ring, len(p))
    truth = _from_first(SE3.from_rotation_translation(R, p))
    return _measured(truth, later - per_ring, later, sigmas, rng)


def _from_first(T: SE2 | SE3) -> SE2 | SE3:
    """Return the poses seen from the first one."""
    return type(T)(T[0].inverse().matrix @ T.matrix)


def _measured(truth: SE2 | SE3, i: Indices, j: Indices, sigmas: tuple[float, float], rng: np.random.Generator) -> World:
    """Return the world of these poses with odometry and the given loops measured."""
    n = len(truth)
    first = np.concatenate([np.arange(n - 1), i])
    second = np.concatenate([np.arange(1, n), j])
    turns = truth.dof - truth.space
    sigma = np.repeat(sigmas, [turns, truth.space])
    noise = sigma * rng.standard_normal((len(first), truth.dof))
    group = type(truth)
    relative = group(truth.ops.inverse(truth.matrix[first]) @ truth.matrix[second])
    return World(
        truth=truth,
        i=first,
        j=second,
        T_i_j=relative.retract(noise),
        information=np.diag(sigma**-2.0),
        false=np.zeros(len(first), dtype=bool),
    )
