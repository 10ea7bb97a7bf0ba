"""Factors of where a point on the body is and how far it came: satellite receivers, wheels and legs."""

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

__all__ = ["AnchoredPosition", "LeverArmPosition", "ScaledMotion", "Velocity"]


_ON_BODY = ((FAMILIES[SE3], FAMILIES[ExtendedPose]),)
_ON_BODY_AND_ARM = (*_ON_BODY, (vectors(3),))
_IN_FRAME = (*_ON_BODY, (FAMILIES[SE3],))
_IN_FRAME_WITH_ARM = (*_IN_FRAME, (vectors(3),))
_BETWEEN_BODIES = (*_ON_BODY, *_ON_BODY, (vectors(1),))


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


class AnchoredPosition(NativeRecord):
    """The position of a point on the body is measured in a frame whose own pose is a variable.

    The residual is ``inverse(T_map_frame) @ (p + R (offset + l)) - z``: of an antenna in east-north-up, whose
    heading and origin in the map are estimated (docs/theory/gnss.md, eq. (1)).

    Parameters
    ----------
    key : int or (N,) int
        Keys of the body, `SE3` or `ExtendedPose`.
    frame_key : int or (N,) int
        Keys of the frame's pose ``T_map_frame``, `SE3`.
    p_frame : (3,) or (N, 3) float64
        Measured [m].
    noise : Noise
        Noise of three rows, along the axes of the frame.
    offset : (3,) or (N, 3) float64
        The point in the body frame, or what is to be added to the lever arm [m].
    arm_key : int or (N,) int, optional
        Key of a vector variable of dimension 3, the lever arm, which is added to the offset.
    kernel : Kernel, optional
        For robust costs.

    Raises
    ------
    GraphError
        Numbers that do not fit the keys.
    """

    __slots__ = ()
    type: ClassVar[int] = 70

    def __init__(
        self,
        key: ArrayLike,
        frame_key: ArrayLike,
        p_frame: ArrayLike,
        noise: Noise,
        *,
        offset: ArrayLike = (0.0, 0.0, 0.0),
        arm_key: ArrayLike | None = None,
        kernel: Kernel | None = None,
    ) -> None:
        keys = key_columns(self.kind, (key, frame_key) if arm_key is None else (key, frame_key, arm_key))
        self._fill(
            keys=keys,
            measurement=_side_by_side(self.kind, [offset, p_frame], len(keys)),
            measured=None,
            rows=3,
            noise=noise,
            kernel=kernel,
            allowed=_IN_FRAME if arm_key is None else _IN_FRAME_WITH_ARM,
        )


class ScaledMotion(NativeRecord):
    """The way of a point on the body between two instants is measured, by wheels or legs whose scale is a variable.

    The residual is ``inverse(T_i) @ (p_j + R_j l) - l - k d`` (docs/theory/gnss.md, eq. (6)).

    Parameters
    ----------
    key_i, key_j : int or (N,) int
        Keys of the body at the two instants, both `SE3` or both `ExtendedPose`.
    scale_key : int or (N,) int
        Key of a vector variable of dimension 1: metres a measured metre.
    displacement : (3,) or (N, 3) float64
        Measured, along the body's axes at the first instant [m].
    noise : Noise
        Noise of three rows, along the body's axes at the first instant.
    lever_arm : (3,) or (N, 3) float64
        The point in the body frame [m].
    kernel : Kernel, optional
        For robust costs.

    Raises
    ------
    GraphError
        Numbers that do not fit the keys.
    """

    __slots__ = ()
    type: ClassVar[int] = 71

    def __init__(
        self,
        key_i: ArrayLike,
        key_j: ArrayLike,
        scale_key: ArrayLike,
        displacement: ArrayLike,
        noise: Noise,
        *,
        lever_arm: ArrayLike = (0.0, 0.0, 0.0),
        kernel: Kernel | None = None,
    ) -> None:
        keys = key_columns(self.kind, (key_i, key_j, scale_key))
        self._fill(
            keys=keys,
            measurement=_side_by_side(self.kind, [lever_arm, displacement], len(keys)),
            measured=None,
            rows=3,
            noise=noise,
            kernel=kernel,
            allowed=_BETWEEN_BODIES,
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
