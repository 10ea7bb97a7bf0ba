"""What moves in a world: each mover is a small world of its own, cast in the frame that goes with it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from heliograph.arrays import freeze, frozen
from heliograph.lie import se3, so3
from heliograph.sim.world import Returns, SimulatedWorld

__all__ = ["Mover", "cast_with_movers"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Mover:
    """Something that goes to and fro between two places, at a constant speed, facing where it goes.

    Parameters
    ----------
    world : SimulatedWorld
        What it looks like, in its own frame: x ahead, origin on the ground.
    a, b : (3,) float64
        The two places, in the world [m].
    speed : float
        [m/s].
    phase : float
        How far along the way from ``a`` to ``b`` and back it is at time zero [m].
    """

    world: SimulatedWorld
    a: NDArray[np.float64]
    b: NDArray[np.float64]
    speed: float
    phase: float = 0.0

    def __post_init__(self) -> None:
        for name in ("a", "b"):
            object.__setattr__(self, name, frozen(name, getattr(self, name), np.float64, (3,), finite=True))
        freeze(self)

    def pose(self, seconds: ArrayLike) -> NDArray[np.float64]:
        """Return T_world_mover (M, 4, 4) at times (M,) [s]."""
        way = self.b - self.a
        length = float(np.linalg.norm(way))
        gone = np.mod(self.speed * np.asarray(seconds, dtype=np.float64) + self.phase, 2.0 * length)
        back = gone > length
        p = self.a + (np.where(back, 2.0 * length - gone, gone) / length)[:, None] * way
        yaw = np.arctan2(way[1], way[0]) + np.where(back, np.pi, 0.0)
        return se3.from_rotation_translation(so3.exp(yaw[:, None] * np.array([0.0, 0.0, 1.0])), p)


def cast_with_movers(
    world: SimulatedWorld,
    movers: Sequence[Mover],
    directions: NDArray[np.float64],
    T_world_sensor: NDArray[np.float64],
    seconds: NDArray[np.float64],
    *,
    min_range: float,
    max_range: float,
    threads: int = 1,
) -> Returns:
    """Return the nearest hit of every ray among a world and its movers, whose primitives count on behind the world's.

    Parameters
    ----------
    world : SimulatedWorld
    movers : sequence of Mover
    directions : (R, C, 3) float64
        Unit vectors in the sensor frame.
    T_world_sensor : (C, 4, 4) float64
        Pose of the sensor at each column's firing.
    seconds : (C,) float64
        When that is [s].
    min_range, max_range : float
        Hits outside are not seen [m].
    threads : int
        The result does not depend on it.
    """
    limits = {"min_range": min_range, "max_range": max_range, "threads": threads}
    found = world.cast(directions, T_world_sensor, **limits)  # type: ignore[arg-type]
    middle = len(seconds) // 2
    for k, mover in enumerate(movers):
        T_world_mover = mover.pose(seconds)
        if np.linalg.norm(T_world_mover[middle, :3, 3] - T_world_sensor[middle, :3, 3]) > max_range + 10.0:
            continue
        seen = mover.world.cast(directions, se3.compose(se3.inverse(T_world_mover), T_world_sensor), **limits)  # type: ignore[arg-type]
        nearer = (seen.primitive >= 0) & ((found.primitive < 0) | (seen.range < found.range))
        found = Returns(
            range=np.where(nearer, seen.range, found.range),
            brightness=np.where(nearer, seen.brightness, found.brightness),
            primitive=np.where(nearer, np.int32(len(world) + k), found.primitive),
        )
    return found
