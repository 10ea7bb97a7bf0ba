"""What was estimated of a mounting and a clock beforehand."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from heliograph.errors import GraphError
from heliograph.graph.model.families import FAMILIES, vectors
from heliograph.graph.model.kernels import Kernel
from heliograph.graph.model.noise import Noise
from heliograph.graph.model.records import NativeRecord, as_measurement, key_columns
from heliograph.lie import SE3

__all__ = ["CalibrationPrior"]


class CalibrationPrior(NativeRecord):
    """A joint prior of a mounting (SE3) and a clock (2), so that one direction that mixes both can be held.

    ``r = (phi, l - l_0, clock - clock_0)`` with ``R = exp(phi) R_0``: rotation about and lever arm along the axes of
    the imu [rad], [m], offset [s], drift [s/s].

    Parameters
    ----------
    mounting : int or (N,) int
        Key of the mounting, an SE3.
    clock : int or (N,) int
        Key of the clock, a vector of dimension 2.
    T_imu_lidar : SE3
        E_0 = (R_0, l_0).
    clock_0 : (2,) or (N, 2) float64
        Offset [s] and drift [s/s].
    noise : Noise
        Noise of eight rows.
    kernel : Kernel, optional
        For robust costs.

    Raises
    ------
    GraphError
        Numbers that do not fit the keys.
    """

    __slots__ = ()
    type: ClassVar[int] = 69

    def __init__(
        self,
        mounting: ArrayLike,
        clock: ArrayLike,
        T_imu_lidar: SE3,
        clock_0: ArrayLike,
        noise: Noise,
        *,
        kernel: Kernel | None = None,
    ) -> None:
        keys = key_columns("CalibrationPrior", (mounting, clock))
        if not isinstance(T_imu_lidar, SE3):
            raise GraphError(f"CalibrationPrior: a mounting is an SE3, not a {type(T_imu_lidar).__name__}")
        E = as_measurement("CalibrationPrior", T_imu_lidar, len(keys))[0]
        both = as_measurement("CalibrationPrior", clock_0, len(keys))[0]
        if both.shape[1] != 2:
            raise GraphError(f"CalibrationPrior: a clock has 2 numbers, offset and drift, got {both.shape[1]}")
        self._fill(
            keys=keys,
            measurement=np.concatenate([E, both], axis=1),
            measured=None,
            rows=8,
            noise=noise,
            kernel=kernel,
            allowed=((FAMILIES[SE3],), (vectors(2),)),
        )
