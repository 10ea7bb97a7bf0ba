"""Factors of preintegrated motions: between two extended poses and the biases (docs/theory/imu.md).

The residual is ``Log(delta(b)^-1 . (X_i^-1 X_j without gravity))`` on SE_2(3): the very perturbation whose covariance
preintegration gives. Within the linear range of the biases the motion is corrected to first order; outside it is
integrated again from the samples, which the factor keeps.
"""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from heliograph import _core
from heliograph.arrays import Array
from heliograph.errors import GraphError
from heliograph.factors.gravity import STANDARD_GRAVITY, Gravity, GravityDirection, GravityVector, known_gravity
from heliograph.factors.motion_rows import kept_samples, motion_rows
from heliograph.graph import Covariance, Factor
from heliograph.graph.model.kernels import Kernel
from heliograph.imu import Preintegration
from heliograph.lie import S2, ExtendedPose, s2

__all__ = [
    "CombinedImu",
    "CombinedImuOnDirection",
    "CombinedImuOnGravity",
    "PreintegratedImu",
    "PreintegratedImuOnDirection",
    "PreintegratedImuOnGravity",
]


_FALLING = (0.0, 0.0, -STANDARD_GRAVITY)


class _Inertial(Factor):
    """What both factors share: which class serves which kind of gravity, and the data."""

    __slots__ = ()

    variables: ClassVar[tuple[Any, ...]] = (ExtendedPose, ExtendedPose, 6)
    rows = 9
    on_direction: ClassVar[type[_Inertial]]
    on_gravity: ClassVar[type[_Inertial]]

    @staticmethod
    def residual(*arguments: Array) -> Array:
        raise NotImplementedError

    def __new__(cls, *_: Any, gravity: Gravity = _FALLING, **__: Any) -> _Inertial:  # noqa: ANN401
        chosen = cls
        if isinstance(gravity, GravityDirection):
            chosen = cls.on_direction
        elif isinstance(gravity, GravityVector):
            chosen = cls.on_gravity
        return object.__new__(chosen)

    def _join(
        self,
        keys: tuple[ArrayLike, ...],
        motion: Preintegration,
        covariance: Array,
        gravity: Gravity,
        keep_samples: bool,
        kernel: Kernel | None,
    ) -> None:
        count = len(motion)
        columns = [np.atleast_1d(np.asarray(key)) for key in keys]
        if any(column.shape != (count,) for column in columns):
            raise GraphError(
                f"{self.kind}: {count} preintegrated intervals need {count} keys a variable, "
                f"got {[column.shape for column in columns]}"
            )
        scale: Array
        if isinstance(gravity, (GravityDirection, GravityVector)):
            columns.append(np.full(count, gravity.key))
            scale = np.full(count, gravity.magnitude if isinstance(gravity, GravityDirection) else 1.0)
        else:
            scale = known_gravity(gravity, count)
        samples = kept_samples(motion) if keep_samples else np.zeros((count, 0, 7))
        data, noise = (motion_rows(motion), samples, scale), Covariance(covariance)
        Factor.__init__(self, tuple(columns), data=data, noise=noise, kernel=kernel)


class PreintegratedImu(_Inertial):
    """A preintegrated motion between two extended poses, the biases constant over it (Forster et al., T-RO 2017).

    Parameters
    ----------
    i, j : int or (N,) int
        Keys of the `ExtendedPose` variables at the start and the end of each interval.
    bias : int or (N,) int
        Keys of the biases, vectors of dimension 6: gyroscope [rad/s], then accelerometer [m/s^2].
    motion : Preintegration
        Preintegrated motion of N intervals; its covariance is the factors' noise.
    gravity : (3,) float64 or GravityDirection or GravityVector
        In the world frame: known [m/s^2], or estimated, in direction or in full; then its key is the last variable.
    keep_samples : bool
        Keep the samples to integrate again outside the biases' linear range; without them the correction to first order
        has to do, and the factor is small.
    kernel : Kernel, optional
        For robust costs.

    Raises
    ------
    GraphError
        Other numbers of keys than of intervals, or gravity that is none.
    """

    __slots__ = ()

    variables: ClassVar[tuple[Any, ...]] = (ExtendedPose, ExtendedPose, 6)
    rows = 9

    def __init__(
        self,
        i: ArrayLike,
        j: ArrayLike,
        bias: ArrayLike,
        motion: Preintegration,
        *,
        gravity: Gravity = _FALLING,
        keep_samples: bool = True,
        kernel: Kernel | None = None,
    ) -> None:
        self._join((i, j, bias), motion, motion.covariance, gravity, keep_samples, kernel)

    @staticmethod
    def residual(*arguments: Array) -> Array:
        """Return residuals (N, 9) of X_i, X_j, bias, perhaps gravity, and the data."""
        return np.asarray(_motion(*arguments, jacobians=False)[0])

    @staticmethod
    def jacobians(*arguments: Array) -> tuple[Array, ...]:
        """Return the derivatives by each variable."""
        _, by_i, by_j, by_bias, by_gravity = _motion(*arguments, jacobians=True)
        return _with_gravity((by_i, by_j, by_bias), by_gravity, arguments)


class CombinedImu(_Inertial):
    """A preintegrated motion and the walk of the biases, with all their correlations.

    Parameters
    ----------
    i, bias_i, j, bias_j : int or (N,) int
        Keys of the `ExtendedPose` variables and of the biases, vectors of dimension 6 (gyroscope [rad/s], then
        accelerometer [m/s^2]), at the start and at the end of each interval.
    motion, gravity, keep_samples, kernel
        As of `PreintegratedImu`; the noise is the motion's combined covariance.

    Raises
    ------
    GraphError
        Other numbers of keys than of intervals, or gravity that is none.
    """

    __slots__ = ()

    variables: ClassVar[tuple[Any, ...]] = (ExtendedPose, 6, ExtendedPose, 6)
    rows = 15

    def __init__(
        self,
        i: ArrayLike,
        bias_i: ArrayLike,
        j: ArrayLike,
        bias_j: ArrayLike,
        motion: Preintegration,
        *,
        gravity: Gravity = _FALLING,
        keep_samples: bool = True,
        kernel: Kernel | None = None,
    ) -> None:
        self._join((i, bias_i, j, bias_j), motion, motion.combined, gravity, keep_samples, kernel)

    @staticmethod
    def residual(*arguments: Array) -> Array:
        """Return residuals (N, 15) of X_i, bias_i, X_j, bias_j, perhaps gravity, and the data."""
        X_i, bias_i, X_j, bias_j, *others = arguments
        return np.hstack([_motion(X_i, X_j, bias_i, *others, jacobians=False)[0], bias_j - bias_i])

    @staticmethod
    def jacobians(*arguments: Array) -> tuple[Array, ...]:
        """Return the derivatives by each variable."""
        X_i, bias_i, X_j, _, *others = arguments
        _, by_i, by_j, by_bias, by_gravity = _motion(X_i, X_j, bias_i, *others, jacobians=True)
        one, none = np.broadcast_to(np.eye(6), (len(X_i), 6, 6)), np.zeros((len(X_i), 6, 9))
        parts = (
            np.concatenate([by_i, none], axis=1),
            np.concatenate([by_bias, -one], axis=1),
            np.concatenate([by_j, none], axis=1),
            np.concatenate([np.zeros((len(X_i), 9, 6)), one], axis=1),
        )
        return _with_gravity(parts, np.concatenate([by_gravity, none[..., :3]], axis=1), arguments)


def _motion(*arguments: Array, jacobians: bool) -> tuple[Array, ...]:
    """Evaluate X_i, X_j, bias, perhaps gravity's variable, and of the data rows, samples and gravity or its scale."""
    X_i, X_j, bias, *variable, rows, samples, scale = arguments
    gravity = variable[0] * scale[:, None] if variable else scale
    flat = np.ascontiguousarray
    found: tuple[Array, ...] = _core.motion_residuals(
        flat(X_i), flat(X_j), flat(bias), flat(gravity), flat(rows), flat(samples), jacobians
    )
    return found


def _with_gravity(parts: tuple[Array, ...], by_gravity: Array, arguments: tuple[Array, ...]) -> tuple[Array, ...]:
    """Return the parts, and the derivative by a vector of gravity where it is a variable."""
    scale = arguments[-1]
    return (*parts, by_gravity * scale[:, None, None]) if scale.ndim == 1 else parts


def _on_sphere(found: tuple[Array, ...], down: Array) -> tuple[Array, ...]:
    return (*found[:-1], found[-1] @ s2.basis(down))


class PreintegratedImuOnGravity(PreintegratedImu):
    """`PreintegratedImu` with gravity as a vector variable."""

    __slots__ = ()
    variables: ClassVar[tuple[Any, ...]] = (*PreintegratedImu.variables, 3)


class PreintegratedImuOnDirection(PreintegratedImu):
    """`PreintegratedImu` with the direction of gravity as a variable."""

    __slots__ = ()
    variables: ClassVar[tuple[Any, ...]] = (*PreintegratedImu.variables, S2)

    @staticmethod
    def jacobians(*arguments: Array) -> tuple[Array, ...]:
        """Return the derivatives by each variable."""
        return _on_sphere(PreintegratedImu.jacobians(*arguments), arguments[3])


class CombinedImuOnGravity(CombinedImu):
    """`CombinedImu` with gravity as a vector variable."""

    __slots__ = ()
    variables: ClassVar[tuple[Any, ...]] = (*CombinedImu.variables, 3)


class CombinedImuOnDirection(CombinedImu):
    """`CombinedImu` with the direction of gravity as a variable."""

    __slots__ = ()
    variables: ClassVar[tuple[Any, ...]] = (*CombinedImu.variables, S2)

    @staticmethod
    def jacobians(*arguments: Array) -> tuple[Array, ...]:
        """Return the derivatives by each variable."""
        return _on_sphere(CombinedImu.jacobians(*arguments), arguments[4])


PreintegratedImu.on_direction, PreintegratedImu.on_gravity = PreintegratedImuOnDirection, PreintegratedImuOnGravity
CombinedImu.on_direction, CombinedImu.on_gravity = CombinedImuOnDirection, CombinedImuOnGravity
