"""How much of a registration's information is true, and how much of it the noise of its planes' normals feigns.

A row of the residuals is ``J = L n`` with a lever L and a normal that is an estimate. Its noise adds ``sum w/s^2 E[dJ^T
dJ]`` to the information: six thousand planes of which none faces an axis, each off by a degree, seem to know the place
along it to a centimetre. That is regression with errors in the regressors. The residual itself does not depend on them
in expectation: with ``H`` the information as summed and ``F`` what noise feigns, the gradient is ``(H - F) d`` for a
true error d, and its covariance is H. What can be known of d from it is

    (H - F) H^-1 (H - F) = S^T H S,   gradient S^T b,   S = 1 - H^-1 F

(W. Fuller, "Measurement Error Models", 1987, section 2.2, as an information). Along an eigenvector of F against H with
eigenvalue q the share ``1 - q`` of the Jacobian is true.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import freeze
from heliograph.registration.linearize import NormalEquations

__all__ = ["TrueShare", "feigned_deviation", "split_information", "true_share"]

Array = NDArray[np.float64]

_SIGMAS = 3.0  # that what noise feigns may exceed its expectation by before it counts as seen
_PER_PLANE = 2.0  # matches that share a plane, and so its normal's error, in a scan thinned to a cube's size
_UNSEEN = 1e-10  # eigenvalue of the scaled information below which a direction was not seen at all


@dataclass(frozen=True, slots=True, kw_only=True)
class TrueShare:
    """The eigenvectors of what is feigned against the whole, and the share of each that is true.

    Parameters
    ----------
    feigned : (C,) float64
        Feigned part of the information along each direction, descending; 1 where it is expected to be all of it.
    share : (C,) float64
        Share of the Jacobian that counts, in [0, 1]; 0 where chance could have feigned all.
    directions : (C, C) float64
        The directions as columns, in units of their sigma: ``directions^T H directions = 1``; zero where nothing was
        seen at all.
    duals : (C, C) float64
        ``directions^T H``: what of each direction is in an error.
    matches : float
        Sum of the matches' robust weights.
    """

    feigned: Array
    share: Array
    directions: Array
    duals: Array
    matches: float

    def __post_init__(self) -> None:
        freeze(self)

    def information(self) -> Array:
        """Return what can be known, ``S^T H S`` (C, C)."""
        return np.asarray((self.duals.T * self.share**2) @ self.duals)

    def of(self, information: Array) -> Array:
        """Return what can be known, ``S^T H S`` (C, C), by an information H of which the same shares are true."""
        S = (self.directions * self.share) @ self.duals
        return np.asarray(S.T @ information @ S)

    def covariance(self) -> Array:
        """Return the inverse of that over what is seen, and nothing along the rest, (C, C)."""
        seen = self.share > 0.0
        V = self.directions[:, seen]
        return np.asarray((V / self.share[seen] ** 2) @ V.T)

    def spread(self, score: Array) -> Array:
        """Return the covariance (C, C) that one of the gradient, ``score`` (C, C), has over what is seen."""
        seen = self.share > 0.0
        G = (self.directions[:, seen] / self.share[seen]) @ self.directions[:, seen].T
        return np.asarray(G @ score @ G.T)

    def gradient(self, gradient: Array) -> Array:
        """Return the part ``S^T b`` (C,) of a gradient that goes with it."""
        return np.asarray(self.duals.T @ (self.share * (self.directions.T @ gradient)))

    def blind(self) -> Array:
        """Return the projection (C, C) of an error onto what is not seen, along what is."""
        seen = self.share > 0.0
        return np.asarray(np.eye(len(self.share)) - self.directions[:, seen] @ self.duals[seen])


def true_share(equations: NormalEquations, columns: slice = slice(None)) -> TrueShare:
    """Tell the true information of a registration from what noise of the normals feigns.

    Parameters
    ----------
    equations : NormalEquations
    columns : slice, optional
        Columns to look at, the others being known; all of them by default.
    """
    H, F = equations.information[columns, columns], equations.feigned[columns, columns]
    total = 0.5 * float(np.trace(_of_position(equations)))
    scatter = feigned_deviation(equations) / total if total > 0.0 else 0.0
    return split_information(H, F, scatter, equations.robust_weight)


def split_information(information: Array, feigned: Array, scatter: float, matches: float) -> TrueShare:
    """Tell the true part of an information from what noise of the normals feigns.

    Parameters
    ----------
    information, feigned : (C, C) float64
        As summed, and what noise alone is expected to have added.
    scatter : float
        Relative deviation of the latter by chance.
    matches : float
        Sum of the matches' robust weights.
    """
    whitening, unseen = _whitening(information)
    parts, turn = np.linalg.eigh(whitening.T @ feigned @ whitening + np.diag(2.0 * unseen))
    parts, directions = parts[::-1], (whitening @ turn)[:, ::-1]
    chance = (1.0 + _SIGMAS * scatter) * parts
    share = np.where(chance < 1.0, 1.0 - parts, 0.0)
    return TrueShare(
        feigned=parts, share=share, directions=directions, duals=directions.T @ information, matches=matches
    )


def feigned_deviation(equations: NormalEquations) -> float:
    """Return the deviation of what noise feigns of the position: a sum of squares, one degree of freedom a plane."""
    return float(np.sqrt(2.0 * _PER_PLANE * equations.feigned_square))


def _whitening(H: Array) -> tuple[Array, Array]:
    """Return W with ``W^T H W = 1``, and 1 for each of its columns that stands for something not seen at all."""
    diagonal = np.diag(H)
    scale = np.where(diagonal > 0.0, 1.0 / np.sqrt(np.maximum(diagonal, 1e-300)), 0.0)
    values, vectors = np.linalg.eigh(H * np.outer(scale, scale))
    seen = values > _UNSEEN
    root = np.where(seen, 1.0 / np.sqrt(np.where(seen, values, 1.0)), 0.0)
    return scale[:, None] * vectors * root, np.where(seen, 0.0, 1.0)


def _of_position(equations: NormalEquations) -> Array:
    pose = equations.columns_of("pose")
    return np.asarray(equations.feigned[pose, pose][3:, 3:])
