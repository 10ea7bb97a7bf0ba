"""Trigonometric coefficients of the exponential maps, accurate at every angle.

Each is a function of the *squared* angle, for a float or an array. Below a limit a power series is used: the closed
forms subtract nearly equal numbers there.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

__all__ = ["cubic_defect", "half_cotangent_defect", "quartic_defect", "quintic_defect", "sinc", "sinc_slope", "versine"]

Angle = TypeVar("Angle", float, NDArray[np.float64])
_LIMIT = 4.0
_TERMS = 14


def _horner(series: Sequence[float], x: Angle) -> Angle:
    total = x * 0.0 + series[-1]
    for coefficient in reversed(series[:-1]):
        total = total * x + coefficient
    return total


def _evaluate(
    theta2: Angle, series: Sequence[float], closed: Callable[[Any, Any], Any], limit: float = _LIMIT
) -> Angle:
    if isinstance(theta2, float):
        if theta2 < limit:
            return _horner(series, theta2)
        # The sine of infinity is an error in `math`, and not a number in NumPy.
        return closed(math.sqrt(theta2), math) if theta2 < math.inf else math.nan
    small = theta2 < limit
    near = _horner(series, np.minimum(theta2, limit))
    if small.all():
        return near
    far = closed(np.sqrt(np.maximum(theta2, limit)), np)
    return np.where(small, near, far)


def _alternating(first: int, slope: int, offset: int) -> tuple[float, ...]:
    """Return ``(-1)^k (first + slope k) / (2k + offset)!`` for k = 0, 1, ..."""
    return tuple((-1) ** k * (first + slope * k) / math.factorial(2 * k + offset) for k in range(_TERMS))


_SINC = _alternating(1, 0, 1)
_VERSINE = _alternating(1, 0, 2)
_CUBIC = _alternating(1, 0, 3)
_QUARTIC = _alternating(1, 0, 4)
_QUINTIC = _alternating(1, 1, 5)
_SLOPE = _alternating(-2, -2, 3)
# |B_2n| / (2n)!, from the Bernoulli numbers 1/6, 1/30, 1/42, 1/30, 5/66, 691/2730, 7/6, 3617/510.
_COTANGENT = (
    1 / 12,
    1 / 720,
    1 / 30240,
    1 / 1209600,
    1 / 47900160,
    691 / 1307674368000,
    1 / 74724249600,
    3617 / 10670622842880000,
)


def sinc(theta2: Angle) -> Angle:
    """Return sin(t) / t."""
    return _evaluate(theta2, _SINC, lambda t, m: m.sin(t) / t)


def versine(theta2: Angle) -> Angle:
    """Return (1 - cos(t)) / t^2."""
    return _evaluate(theta2, _VERSINE, lambda t, m: 2.0 * (m.sin(0.5 * t) / t) ** 2)


def cubic_defect(theta2: Angle) -> Angle:
    """Return (t - sin(t)) / t^3."""
    return _evaluate(theta2, _CUBIC, lambda t, m: (t - m.sin(t)) / t**3)


def quartic_defect(theta2: Angle) -> Angle:
    """Return (t^2 / 2 + cos(t) - 1) / t^4."""
    return _evaluate(theta2, _QUARTIC, lambda t, m: (0.5 * t * t + m.cos(t) - 1.0) / t**4)


def quintic_defect(theta2: Angle) -> Angle:
    """Return (2 t - 3 sin(t) + t cos(t)) / (2 t^5)."""
    return _evaluate(theta2, _QUINTIC, lambda t, m: (2.0 * t - 3.0 * m.sin(t) + t * m.cos(t)) / (2.0 * t**5))


def sinc_slope(theta2: Angle) -> Angle:
    """Return (cos(t) - sin(t) / t) / t^2, the derivative of sinc divided by t."""
    return _evaluate(theta2, _SLOPE, lambda t, m: (m.cos(t) - m.sin(t) / t) / t**2)


def half_cotangent_defect(theta2: Angle) -> Angle:
    """Return (1 - (t / 2) cot(t / 2)) / t^2; infinite at a full turn."""
    return _evaluate(theta2, _COTANGENT, lambda t, m: (1.0 - 0.5 * t / m.tan(0.5 * t)) / t**2, limit=0.5)
