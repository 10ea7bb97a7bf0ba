"""How a factor gets gravity: a known vector, or the key of a variable that holds its direction or all of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from heliograph.config import ImuConfig
from heliograph.errors import GraphError

__all__ = ["STANDARD_GRAVITY", "Gravity", "GravityDirection", "GravityVector", "known_gravity"]

STANDARD_GRAVITY = ImuConfig().gravity


@dataclass(frozen=True, slots=True, kw_only=True)
class GravityDirection:
    """The direction of gravity is estimated, its magnitude is known.

    Parameters
    ----------
    key : int
        Key of an `S2` variable: the direction in which things fall, in the world frame.
    magnitude : float
        [m/s^2].
    """

    key: int
    magnitude: float = STANDARD_GRAVITY


@dataclass(frozen=True, slots=True, kw_only=True)
class GravityVector:
    """Gravity is estimated, magnitude and all.

    Parameters
    ----------
    key : int
        Key of a vector variable of dimension 3: gravity in the world frame [m/s^2].
    """

    key: int


Gravity: TypeAlias = GravityDirection | GravityVector | ArrayLike


def known_gravity(gravity: Gravity) -> NDArray[np.float64]:
    """Return what a factor knows of gravity: the vector (3,), or the magnitude (1,) behind a variable.

    Raises
    ------
    GraphError
        It is no vector of three finite numbers.
    """
    if isinstance(gravity, GravityDirection):
        return np.array([gravity.magnitude], dtype=np.float64)
    if isinstance(gravity, GravityVector):
        return np.ones(1)
    g = np.array(gravity, dtype=np.float64)
    if g.shape != (3,) or not np.isfinite(g).all():
        raise GraphError(
            "gravity is a vector (3,) [m/s^2], GravityDirection(key=...) or GravityVector(key=...), "
            f"got shape {g.shape}"
        )
    return g
