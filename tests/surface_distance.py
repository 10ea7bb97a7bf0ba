"""How far points lie from the nearest surface of a simulated world."""

import numpy as np

from heliograph.sim.world import SimulatedWorld


def surface_distance(world: SimulatedWorld, points_world: np.ndarray) -> np.ndarray:
    """Distance (N,) of points (N, 3) to the nearest surface, from inside or outside [m]."""
    nearest = np.full(len(points_world), np.inf)
    for primitive in world.primitives:
        local, half = (points_world - primitive.center) @ primitive.R_world_local, primitive.half
        beyond = np.abs(local) - half
        if primitive.shape == "cylinder":
            beyond = np.column_stack([np.hypot(local[:, 0], local[:, 1]) - half[0], beyond[:, 2]])
        distance = np.linalg.norm(np.maximum(beyond, 0.0), axis=1)
        if primitive.shape != "rectangle":
            inside = (beyond <= 0.0).all(axis=1)
            distance = np.where(inside, -beyond.max(axis=1), distance)
        nearest = np.minimum(nearest, distance)
    return nearest
