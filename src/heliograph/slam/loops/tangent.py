"""Distances between poses, and covariances carried along chains of them."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from heliograph.arrays import Array
from heliograph.chi_square import chi_square_quantile
from heliograph.lie import se3

__all__ = ["diagonal", "gate_of", "inverse_with_covariance", "mahalanobis", "near"]


@lru_cache(maxsize=32)
def gate_of(probability: float) -> float:
    """Return the squared distance that six degrees of freedom stay below with a probability."""
    return chi_square_quantile(probability, 6)


def diagonal(angle_deg: float, distance: float) -> Array:
    """Return the covariance (6, 6) of an angle [deg] and a distance [m], one-sigma an axis."""
    return np.diag(np.repeat([np.radians(angle_deg), distance], 3) ** 2)


def mahalanobis(A: Array, B: Array, covariance: Array) -> float:
    """Return the squared length of ``Log(A^-1 B)`` in a covariance of right perturbations."""
    d = se3.log(se3.inverse(A) @ B)
    return float(d @ np.linalg.solve(covariance, d))


def near(A: Array, B: Array, distance: float, angle_deg: float) -> bool:
    """Whether two poses (4, 4) are one to within a distance of their origins [m] and an angle [deg]."""
    if math.dist(A[:3, 3], B[:3, 3]) > distance:
        return False
    cosine = 0.5 * (float(np.vdot(A[:3, :3], B[:3, :3])) - 1.0)
    return cosine >= math.cos(math.radians(min(angle_deg, 180.0)))


def inverse_with_covariance(T_a_b: Array, covariance: Array) -> tuple[Array, Array]:
    """Return ``T_b_a`` and its covariance from those of ``T_a_b``: ``(T exp(x))^-1 = T^-1 exp(-Ad(T) x)``."""
    adjoint = se3.adjoint(T_a_b)
    return se3.inverse(T_a_b), np.asarray(adjoint @ covariance @ adjoint.T)
