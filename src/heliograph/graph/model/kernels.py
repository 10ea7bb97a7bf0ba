"""Robust kernels: costs of a whitened residual's length that grow more slowly than its square.

A factor with the whitened length e costs ``2 rho(e)``. `weight` is ``rho'(e) / e``: what the factor counts for in the
normal equations.

References
----------
.. [1] Z. Zhang, "Parameter estimation techniques: a tutorial with application to conic fitting", Image and Vision
   Computing, 1997 (Huber, Cauchy, Geman-McClure, Tukey).
.. [2] P. Agarwal et al., "Robust map optimization using dynamic covariance scaling", ICRA 2013.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from heliograph.arrays import Array
from heliograph.errors import GraphError

__all__ = ["DCS", "Cauchy", "GemanMcClure", "Huber", "Kernel", "TruncatedLeastSquares", "Tukey"]


@dataclass(frozen=True, slots=True)
class Kernel:
    """What the kernels share; use a subclass.

    Parameters
    ----------
    width : float
        Where it begins to differ from least squares, in standard deviations.

    Raises
    ------
    GraphError
        The width is not positive and finite.
    """

    width: float

    code: ClassVar[int]  # by which the native side knows it

    def __post_init__(self) -> None:
        if not (np.isfinite(self.width) and self.width > 0.0):
            raise GraphError(
                f"{type(self).__name__}({self.width}): a kernel's width is a positive number of standard deviations"
            )

    def cost(self, residual: ArrayLike) -> Array:
        """Return rho(r), elementwise; ``r^2 / 2`` for small residuals."""
        return self._cost(np.abs(np.asarray(residual, dtype=np.float64)))

    def weight(self, residual: ArrayLike) -> Array:
        """Return ``rho'(r) / r``, elementwise; 1 at zero."""
        return self._weight(np.abs(np.asarray(residual, dtype=np.float64)))

    def _cost(self, r: Array) -> Array:
        raise NotImplementedError

    def _weight(self, r: Array) -> Array:
        raise NotImplementedError


@dataclass(frozen=True, slots=True)
class Huber(Kernel):
    """Squares up to the width, then straight lines: ``r^2/2`` or ``k (|r| - k/2)`` [1]_."""

    code: ClassVar[int] = 1

    def _cost(self, r: Array) -> Array:
        k = self.width
        return np.where(r <= k, 0.5 * np.minimum(r, k) ** 2, k * (r - 0.5 * k))

    def _weight(self, r: Array) -> Array:
        return self.width / np.maximum(r, self.width)


@dataclass(frozen=True, slots=True)
class Cauchy(Kernel):
    """Grows with the logarithm: ``k^2/2 log(1 + r^2/k^2)`` [1]_."""

    code: ClassVar[int] = 2

    def _cost(self, r: Array) -> Array:
        return 0.5 * self.width**2 * np.log1p((r / self.width) ** 2)

    def _weight(self, r: Array) -> Array:
        return 1.0 / (1.0 + (r / self.width) ** 2)


@dataclass(frozen=True, slots=True)
class GemanMcClure(Kernel):
    """Saturates smoothly: ``r^2/2 / (1 + r^2/k^2)`` [1]_."""

    code: ClassVar[int] = 3

    def _cost(self, r: Array) -> Array:
        return 0.5 * r * r / (1.0 + (r / self.width) ** 2)

    def _weight(self, r: Array) -> Array:
        return 1.0 / (1.0 + (r / self.width) ** 2) ** 2


@dataclass(frozen=True, slots=True)
class Tukey(Kernel):
    """Tukey's biweight: ``k^2/6 (1 - (1 - r^2/k^2)^3)``, constant beyond the width [1]_."""

    code: ClassVar[int] = 4

    def _cost(self, r: Array) -> Array:
        s = np.minimum(r / self.width, 1.0) ** 2
        # Written out, 1 - (1 - s)^3 keeps its digits where s is small.
        return np.asarray(self.width**2 / 6.0 * s * (3.0 - 3.0 * s + s * s), dtype=np.float64)

    def _weight(self, r: Array) -> Array:
        return np.asarray((1.0 - np.minimum(r / self.width, 1.0) ** 2) ** 2, dtype=np.float64)


@dataclass(frozen=True, slots=True)
class DCS(Kernel):
    """Dynamic covariance scaling [2]_: weight ``s^2`` with ``s = min(1, 2 phi / (phi + r^2))``.

    Parameters
    ----------
    width : float
        phi, on the scale of the *squared* whitened residual.
    """

    code: ClassVar[int] = 5

    def _cost(self, r: Array) -> Array:
        phi, r2 = self.width, r * r
        return np.where(r2 <= phi, 0.5 * np.minimum(r2, phi), 1.5 * phi - 2.0 * phi * phi / (phi + r2))

    def _weight(self, r: Array) -> Array:
        return np.asarray(np.minimum(1.0, 2.0 * self.width / (self.width + r * r)) ** 2, dtype=np.float64)


@dataclass(frozen=True, slots=True)
class TruncatedLeastSquares(Kernel):
    """Squares up to the width, constant beyond it: ``min(r^2, k^2) / 2``."""

    code: ClassVar[int] = 6

    def _cost(self, r: Array) -> Array:
        return 0.5 * np.minimum(r, self.width) ** 2

    def _weight(self, r: Array) -> Array:
        return np.where(r < self.width, 1.0, 0.0)
