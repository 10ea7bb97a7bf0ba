"""Factors of preintegrated motions: between two extended poses and the biases (docs/theory/imu.md).

The residual is ``Log(delta(b)^-1 . (X_i^-1 X_j without gravity))`` on SE_2(3): the very perturbation whose covariance
preintegration gives. Within the linear range of the biases the motion is corrected to first order; outside it is
integrated again from the samples, which the factor keeps.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from heliograph.arrays import Array, Keys
from heliograph.errors import GraphError
from heliograph.factors.gravity import STANDARD_GRAVITY, Gravity, GravityDirection, GravityVector, known_gravity
from heliograph.factors.motion_rows import motion_measurements
from heliograph.graph import Covariance
from heliograph.graph.model.families import FAMILIES, Family, vectors
from heliograph.graph.model.kernels import Kernel
from heliograph.graph.model.records import NativeRecord, key_columns, plain_key
from heliograph.imu import Preintegration
from heliograph.lie import S2, ExtendedPose

__all__ = ["CombinedImu", "PreintegratedImu"]


_FALLING = (0.0, 0.0, -STANDARD_GRAVITY)
_STATE, _BIAS = (FAMILIES[ExtendedPose],), (vectors(6),)


class _Inertial(NativeRecord):
    """What both factors share: keys and data, with known gravity or with its variable behind the others."""

    __slots__ = ()

    def _join(
        self,
        keys: tuple[ArrayLike, ...],
        families: tuple[tuple[Family, ...], ...],
        motion: Preintegration,
        covariance: Array,
        gravity: Gravity,
        keep_samples: bool,
        kernel: Kernel | None,
    ) -> None:
        count = len(motion)
        known = known_gravity(gravity)
        if isinstance(gravity, (GravityDirection, GravityVector)):
            families = (*families, (FAMILIES[S2] if isinstance(gravity, GravityDirection) else vectors(3),))
        measurement, finite = motion_measurements(motion, known, keep_samples)
        array, distinct = _keys_of_intervals(self.kind, keys, gravity, count)
        self._fill(
            keys=array,
            measurement=measurement,
            measured=None,
            rows=covariance.shape[-1],
            noise=Covariance(covariance),
            kernel=kernel,
            allowed=families,
            sound=finite and distinct,
        )


def _keys_of_intervals(kind: str, keys: tuple[ArrayLike, ...], gravity: Gravity, count: int) -> tuple[Keys, bool]:
    """Return the keys (N, arity), and whether they are one interval's and all different."""
    if isinstance(gravity, (GravityDirection, GravityVector)):
        keys = (*keys, gravity.key if count == 1 else np.full(count, gravity.key))
    if count == 1 and all(map(plain_key, keys)):
        return key_columns(kind, keys), len(set(keys)) == len(keys)
    columns = [np.atleast_1d(np.asarray(key)) for key in keys]
    if any(column.shape != (count,) for column in columns):
        raise GraphError(
            f"{kind}: {count} preintegrated intervals need {count} keys a variable, "
            f"got {[column.shape for column in columns]}"
        )
    array = key_columns(kind, tuple(columns))
    return array, count == 1 and len(set(array[0].tolist())) == len(columns)


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
    type: ClassVar[int] = 64

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
        families = (_STATE, _STATE, _BIAS)
        self._join((i, j, bias), families, motion, motion.covariance, gravity, keep_samples, kernel)


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
    type: ClassVar[int] = 65

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
        families = (_STATE, _BIAS, _STATE, _BIAS)
        self._join((i, bias_i, j, bias_j), families, motion, motion.combined, gravity, keep_samples, kernel)
