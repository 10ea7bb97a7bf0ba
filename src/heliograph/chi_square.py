"""The chi-square distribution: how long a whitened residual, and how far off an estimated variance, may be."""

from __future__ import annotations

import math
from statistics import NormalDist

from heliograph.errors import DataError

__all__ = ["chi_square_cdf", "chi_square_quantile"]

TINY = 1e-300
TERMS = 10_000  # far more than any degree of freedom in use needs: about sqrt(dof) suffice near the median


def chi_square_cdf(x: float, dof: float) -> float:
    """Return the probability that the squared length of `dof` independent unit normals is at most `x`.

    It is the regularised incomplete gamma function P(dof/2, x/2), by its power series below the mean and by its
    continued fraction above ([1]_ sections 6.5.29 and 6.5.31, the latter by Lentz's method), each where it is fast.

    References
    ----------
    .. [1] M. Abramowitz, I. Stegun, "Handbook of Mathematical Functions", 1964.
    """
    if x <= 0.0:
        return 0.0
    a, z = 0.5 * dof, 0.5 * x
    scale = math.exp(a * math.log(z) - z - math.lgamma(a))
    return scale * _series(a, z) if z < a + 1.0 else 1.0 - scale * _fraction(a, z)


def chi_square_quantile(probability: float, dof: float) -> float:
    """Return the x with ``chi_square_cdf(x, dof) == probability``, to about 1e-12 relative.

    Newton's method on the distribution function from the cube-root approximation [1]_, kept inside a bracket.

    Parameters
    ----------
    probability : float
        In (0, 1).
    dof : float
        Degrees of freedom, at least 1; equivalent degrees of freedom need not be whole.

    Raises
    ------
    DataError
        If either is out of range.

    References
    ----------
    .. [1] E. B. Wilson, M. M. Hilferty, "The distribution of chi-square", PNAS 17, 1931.
    """
    if not 0.0 < probability < 1.0 or dof < 1:
        raise DataError(f"a chi-square quantile needs 0 < probability < 1 and dof >= 1, got {probability} and {dof}")
    third = 2.0 / (9.0 * dof)
    x = dof * max(1.0 - third + NormalDist().inv_cdf(probability) * math.sqrt(third), 1e-3) ** 3
    low, high = 0.0, math.inf
    for _ in range(200):
        error = chi_square_cdf(x, dof) - probability
        low, high = (x, high) if error < 0.0 else (low, x)
        density = math.exp((0.5 * dof - 1.0) * math.log(0.5 * x) - 0.5 * x - math.lgamma(0.5 * dof)) / 2.0
        trial = x - error / max(density, TINY)
        if not low < trial < high:
            trial = 0.5 * (low + high) if math.isfinite(high) else 2.0 * x
        if abs(trial - x) <= 1e-14 * x:
            return trial
        x = trial
    return x


def _series(a: float, z: float) -> float:
    """Return gamma(a) P(a, z) / (z^a e^-z)."""
    term = total = 1.0 / a
    for k in range(1, TERMS):
        term *= z / (a + k)
        total += term
        if term < 1e-17 * total:
            break
    return total


def _fraction(a: float, z: float) -> float:
    """Return gamma(a) (1 - P(a, z)) / (z^a e^-z)."""
    b = z + 1.0 - a
    c, d = 1.0 / TINY, 1.0 / b
    value = d
    for k in range(1, TERMS):
        numerator = -k * (k - a)
        b += 2.0
        d = 1.0 / _away_from_zero(numerator * d + b)
        c = _away_from_zero(b + numerator / c)
        value *= c * d
        if abs(c * d - 1.0) < 1e-16:
            break
    return value


def _away_from_zero(x: float) -> float:
    return x if abs(x) > TINY else TINY
