"""The factor of a level: which way up is, by what an accelerometer shows on average over a long window."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from heliograph.errors import GraphError
from heliograph.graph.model.families import FAMILIES, vectors
from heliograph.graph.model.kernels import Kernel
from heliograph.graph.model.noise import Noise
from heliograph.graph.model.records import NativeRecord, key_columns
from heliograph.lie import SE3, ExtendedPose

__all__ = ["MeanForce"]

_ALLOWED = ((FAMILIES[SE3], FAMILIES[ExtendedPose]), (vectors(3),), (vectors(3),))


class MeanForce(NativeRecord):
    """The mean specific force of a window, less the mean acceleration of the way, is up: ``R' u + M b - z``.

    docs/theory/slam.md, eq. (5).

    Parameters
    ----------
    key : int or (N,) int
        Keys of the body, `SE3` or `ExtendedPose`, in whose axes the window's forces were averaged.
    up_key : int or (N,) int
        Key of a vector variable of dimension 3: the force that holds the body against gravity, in the world frame
        [m/s^2]. A held one of (0, 0, g) makes the world's z axis point up.
    bias_key : int or (N,) int
        Key of a vector variable of dimension 3: bias of the accelerometer [m/s^2].
    force : (3,) or (N, 3) float64
        The mean specific force less the mean acceleration, along the body's axes at the key [m/s^2].
    turning : (3, 3) or (N, 3, 3) float64
        Mean of the rotations from the body's axes at each sample to those at the key: what passes of the bias.
    noise : Noise
        Noise of three rows, along the body's axes.
    kernel : Kernel, optional
        For robust costs.

    Raises
    ------
    GraphError
        Numbers that do not fit the keys.
    """

    __slots__ = ()
    type: ClassVar[int] = 72

    def __init__(
        self,
        key: ArrayLike,
        up_key: ArrayLike,
        bias_key: ArrayLike,
        force: ArrayLike,
        turning: ArrayLike,
        noise: Noise,
        *,
        kernel: Kernel | None = None,
    ) -> None:
        keys = key_columns(self.kind, (key, up_key, bias_key))
        z, M = np.asarray(force, dtype=np.float64), np.asarray(turning, dtype=np.float64)
        if z.shape not in ((3,), (len(keys), 3)) or M.shape not in ((3, 3), (len(keys), 3, 3)):
            raise GraphError(
                f"{self.kind}: {len(keys)} factors need a force (3,) and a turning (3, 3) each, got shapes {z.shape} "
                f"and {M.shape}"
            )
        measurement = np.empty((len(keys), 12))
        measurement[:, :3], measurement[:, 3:] = z, M.reshape(*M.shape[:-2], 9)
        self._fill(
            keys=keys, measurement=measurement, measured=None, rows=3, noise=noise, kernel=kernel, allowed=_ALLOWED
        )
