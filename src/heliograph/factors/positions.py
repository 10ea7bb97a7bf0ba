"""Factors of what a satellite receiver measures: the position of its antenna, and its velocity."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from heliograph.arrays import Array
from heliograph.errors import GraphError
from heliograph.graph import Factor
from heliograph.graph.model.kernels import Kernel
from heliograph.graph.model.noise import Noise
from heliograph.lie import SE3, ExtendedPose, so3

__all__ = ["LeverArmPosition", "LeverArmPositionOnArm", "Velocity"]


class LeverArmPosition(Factor):
    """The position of a point on the body is measured: ``p + R l - z``.

    Parameters
    ----------
    key : int or (N,) int
        Of the body, `SE3` or `ExtendedPose`.
    p_world : (3,) or (N, 3) float64
        Measured, such as an antenna's position [m].
    noise : Noise
        Of three rows, along the axes of the world.
    lever_arm : (3,) float64
        The point in the body frame [m].
    arm_key : int, optional
        Of a vector variable of dimension 3 that holds the lever arm instead; then `lever_arm` is not given.
    kernel : Kernel, optional
        For robust costs.

    Raises
    ------
    GraphError
        Both or neither of `lever_arm` and `arm_key`, or numbers that do not fit the keys.
    """

    __slots__ = ()

    variables: ClassVar[tuple[Any, ...]] = ((SE3, ExtendedPose),)
    rows = 3

    def __new__(cls, *_: object, arm_key: int | None = None, **__: object) -> LeverArmPosition:  # noqa: D102
        return object.__new__(cls if arm_key is None else LeverArmPositionOnArm)

    def __init__(
        self,
        key: ArrayLike,
        p_world: ArrayLike,
        noise: Noise,
        *,
        lever_arm: ArrayLike | None = None,
        arm_key: int | None = None,
        kernel: Kernel | None = None,
    ) -> None:
        if (lever_arm is None) == (arm_key is None):
            raise GraphError(f"{self.kind}: give the lever arm, or the key of a variable that holds it, and not both")
        keys = np.atleast_1d(np.asarray(key))
        measured = _rows(self.kind, p_world, len(keys))
        if arm_key is None:
            data: tuple[Array, ...] = (_rows(self.kind, lever_arm, len(keys)), measured)
            super().__init__((keys,), data=data, noise=noise, kernel=kernel)
        else:
            super().__init__((keys, np.full(len(keys), arm_key)), data=(measured,), noise=noise, kernel=kernel)

    @staticmethod
    def residual(T_world_body: Array, arm: Array, measured: Array) -> Array:
        """Return the residuals (N, 3); the arm is a datum or a variable."""
        return T_world_body[:, :3, 3] + _turned(T_world_body, arm) - measured

    @staticmethod
    def jacobians(T_world_body: Array, arm: Array, _measured: Array) -> tuple[Array, ...]:
        """Return the derivative by the body."""
        return (_by_body(T_world_body, arm),)


class LeverArmPositionOnArm(LeverArmPosition):
    """`LeverArmPosition` with the lever arm as a variable."""

    __slots__ = ()

    variables: ClassVar[tuple[Any, ...]] = ((SE3, ExtendedPose), 3)

    @staticmethod
    def jacobians(T_world_body: Array, arm: Array, _measured: Array) -> tuple[Array, ...]:
        """Return the derivatives by body and lever arm."""
        return _by_body(T_world_body, arm), T_world_body[:, :3, :3]


class Velocity(Factor):
    """The velocity of the body is measured in the world frame: ``v - z``.

    Parameters
    ----------
    key : int or (N,) int
        Of an `ExtendedPose`.
    v_world : (3,) or (N, 3) float64
        Measured [m/s].
    noise : Noise
        Of three rows, along the axes of the world.
    kernel : Kernel, optional
        For robust costs.

    Raises
    ------
    GraphError
        Numbers that do not fit the keys.
    """

    __slots__ = ()

    variables: ClassVar[tuple[Any, ...]] = (ExtendedPose,)
    rows = 3

    def __init__(self, key: ArrayLike, v_world: ArrayLike, noise: Noise, *, kernel: Kernel | None = None) -> None:
        keys = np.atleast_1d(np.asarray(key))
        super().__init__((keys,), data=(_rows(self.kind, v_world, len(keys)),), noise=noise, kernel=kernel)

    @staticmethod
    def residual(X_world_body: Array, measured: Array) -> Array:
        """Return the residuals (N, 3)."""
        return X_world_body[:, :3, 4] - measured

    @staticmethod
    def jacobians(X_world_body: Array, measured: Array) -> tuple[Array, ...]:
        """Return the derivative by the body."""
        J = np.zeros((len(measured), 3, 9))
        J[:, :, 6:] = X_world_body[:, :3, :3]
        return (J,)


def _turned(T_world_body: Array, arm: Array) -> Array:
    return np.asarray((T_world_body[:, :3, :3] @ arm[:, :, None])[..., 0])


def _by_body(T_world_body: Array, arm: Array) -> Array:
    """Return the derivative (N, 3, 6 or 9) of the point by the body; velocity does not move it."""
    R = T_world_body[:, :3, :3]
    J = np.zeros((len(arm), 3, 6 if T_world_body.shape[-1] == 4 else 9))
    J[:, :, :3] = -R @ so3.hat(arm)
    J[:, :, 3:6] = R
    return J


def _rows(kind: str, vectors: ArrayLike | None, count: int) -> Array:
    array = np.asarray(vectors, dtype=np.float64)
    if array.shape not in ((3,), (count, 3)):
        raise GraphError(f"{kind}: {count} factors need vectors (3,) or ({count}, 3), got shape {array.shape}")
    return np.broadcast_to(array, (count, 3))
