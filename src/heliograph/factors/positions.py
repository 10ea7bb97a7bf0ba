"""Factors of what a satellite receiver measures: the position of its antenna, and its velocity."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from heliograph import _core
from heliograph.arrays import Array, Keys
from heliograph.errors import GraphError
from heliograph.graph.model.families import FAMILIES, vectors
from heliograph.graph.model.kernels import Kernel
from heliograph.graph.model.noise import Noise
from heliograph.graph.model.records import NativeRecord, key_columns
from heliograph.lie import SE3, ExtendedPose

__all__ = ["LeverArmPosition", "Velocity"]


_ON_BODY = ((FAMILIES[SE3], FAMILIES[ExtendedPose]),)
_ON_BODY_AND_ARM = (*_ON_BODY, (vectors(3),))


class LeverArmPosition(NativeRecord):
    """The position of a point on the body is measured: ``p + R l - z``.

    Parameters
    ----------
    key : int or (N,) int
        Keys of the body, `SE3` or `ExtendedPose`.
    p_world : (3,) or (N, 3) float64
        Measured, such as an antenna's position [m].
    noise : Noise
        Noise of three rows, along the axes of the world.
    lever_arm : (3,) or (N, 3) float64
        The point in the body frame [m].
    arm_key : int or (N,) int, optional
        Key of a vector variable of dimension 3 that holds the lever arm instead; then `lever_arm` is not given.
    kernel : Kernel, optional
        For robust costs.

    Raises
    ------
    GraphError
        Both or neither of `lever_arm` and `arm_key`, or numbers that do not fit the keys.
    """

    __slots__ = ()
    type: ClassVar[int] = 66

    def __init__(
        self,
        key: ArrayLike,
        p_world: ArrayLike,
        noise: Noise,
        *,
        lever_arm: ArrayLike | None = None,
        arm_key: ArrayLike | None = None,
        kernel: Kernel | None = None,
    ) -> None:
        if (lever_arm is None) == (arm_key is None):
            raise GraphError(f"{self.kind}: give the lever arm, or the key of a variable that holds it, and not both")
        keys = key_columns(self.kind, (key,) if arm_key is None else (key, arm_key))
        vectors_given = [p_world] if lever_arm is None else [lever_arm, p_world]
        measurement = _side_by_side(self.kind, vectors_given, len(keys))
        self._fill(
            keys=keys,
            measurement=measurement,
            measured=None,
            rows=3,
            noise=noise,
            kernel=kernel,
            allowed=_ON_BODY if arm_key is None else _ON_BODY_AND_ARM,
            sound=_sound(keys, measurement),
        )


class Velocity(NativeRecord):
    """The velocity of the body is measured in the world frame: ``v - z``.

    Parameters
    ----------
    key : int or (N,) int
        Keys of variables `ExtendedPose`.
    v_world : (3,) or (N, 3) float64
        Measured [m/s].
    noise : Noise
        Noise of three rows, along the axes of the world.
    kernel : Kernel, optional
        For robust costs.

    Raises
    ------
    GraphError
        Numbers that do not fit the keys.
    """

    __slots__ = ()
    type: ClassVar[int] = 67

    def __init__(self, key: ArrayLike, v_world: ArrayLike, noise: Noise, *, kernel: Kernel | None = None) -> None:
        keys = key_columns(self.kind, (key,))
        measurement = _side_by_side(self.kind, [v_world], len(keys))
        self._fill(
            keys=keys,
            measurement=measurement,
            measured=None,
            rows=3,
            noise=noise,
            kernel=kernel,
            allowed=((FAMILIES[ExtendedPose],),),
            sound=_sound(keys, measurement),
        )


def _side_by_side(kind: str, vectors_given: list[ArrayLike], count: int) -> Array:
    """Return vectors (3,) or (N, 3) in the columns of one array (N, 3 or 6)."""
    out = np.empty((count, 3 * len(vectors_given)))
    for k, given in enumerate(vectors_given):
        array = np.asarray(given, dtype=np.float64)
        if array.shape not in ((3,), (count, 3)):
            raise GraphError(f"{kind}: {count} factors need vectors (3,) or ({count}, 3), got shape {array.shape}")
        out[:, 3 * k : 3 * k + 3] = array
    return out


def _sound(keys: Keys, measurement: Array) -> bool:
    """Return whether this is one factor of which nothing need be looked at more closely."""
    if len(keys) != 1 or (keys.shape[1] == 2 and keys[0, 0] == keys[0, 1]):
        return False
    return _core.is_sound(0, measurement[0])  # a vector: all of it is finite
