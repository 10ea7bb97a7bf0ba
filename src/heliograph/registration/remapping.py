"""Steps of a least-squares problem that does not see every direction: none, remapped, or held softly."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["remapped_step", "seen_step", "soft_step"]

Array = NDArray[np.float64]


def remapped_step(information: Array, gradient: Array, *, threshold: float) -> tuple[Array, NDArray[np.bool_]]:
    """Return the step without its part along weak eigenvectors, and which eigenvectors (ascending) are weak.

    ``d = -V_s L_s^-1 V_s^T g`` with the eigenvectors ``V_s`` whose eigenvalue reaches the threshold: solution remapping
    (J. Zhang, M. Kaess, S. Singh, ICRA 2016), which leaves the guess as it was in the other directions.

    Parameters
    ----------
    information : (n, n) float64
        Symmetric; its units must suit one threshold, so give rotation and translation apart, or scaled.
    gradient : (n,) float64
        Gradient of the cost.
    threshold : float
        Smallest eigenvalue that is used.
    """
    values, vectors = np.linalg.eigh(information)
    weak = values < threshold
    strong = vectors[:, ~weak]
    return -strong @ ((strong.T @ gradient) / values[~weak]), weak


def soft_step(information: Array, gradient: Array, *, prior: Array | float) -> Array:
    """Return the step with a prior on it: ``-(H + P)^-1 g``.

    Along an eigenvector it is the full step times ``l / (l + p)``: what is known well is used, what is known badly is
    held, and nothing switches when an eigenvalue crosses a threshold.

    Parameters
    ----------
    information : (n, n) float64
    gradient : (n,) float64
    prior : (n, n) float64 or float
        Information of the guess [unit of ``information``]; a number is taken for each direction alike.
    """
    P = prior * np.eye(len(gradient)) if np.ndim(prior) == 0 else np.asarray(prior)
    return np.asarray(-np.linalg.solve(information + P, gradient))


def seen_step(information: Array, gradient: Array, blind: Array) -> Array:
    """Return the least-squares step among those without a part in ``blind`` (n, K), columns of any length.

    The parts are apart in the sense of rows and columns scaled to a unit diagonal, so that metres and radians weigh
    alike.
    """
    if blind.shape[1] == 0:
        return np.asarray(-np.linalg.solve(information, gradient))
    scale = 1.0 / np.sqrt(np.maximum(np.diag(information), 1e-12 * max(float(np.diag(information).max()), 1e-300)))
    q, _ = np.linalg.qr(blind / scale[:, None], mode="complete")
    seen = scale[:, None] * q[:, blind.shape[1] :]
    return np.asarray(-seen @ np.linalg.solve(seen.T @ information @ seen, seen.T @ gradient))
