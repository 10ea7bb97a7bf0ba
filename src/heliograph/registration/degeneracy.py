"""Which directions a registration sees: eigenvalues of its information matrix, per measurement."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import freeze
from heliograph.registration.linearize import NormalEquations

__all__ = ["Observability", "observability"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Observability:
    """Eigenvalues of the per-measurement information, rotation and translation apart.

    Parameters
    ----------
    rotation, translation : (3,) float64
        Ascending, without unit. Those of translation sum to 1: the mean of ``n n^T``. Those of rotation are of the mean
        of ``(p x n)(p x n)^T`` divided by the mean square of the points' distances, so that they do not grow with
        range.
    rotation_directions, translation_directions : (3, 3) float64
        Eigenvectors as columns: of rotation in the imu frame, of translation in the odom frame.
    """

    rotation: NDArray[np.float64]
    translation: NDArray[np.float64]
    rotation_directions: NDArray[np.float64]
    translation_directions: NDArray[np.float64]

    def __post_init__(self) -> None:
        freeze(self)

    @property
    def weak_direction(self) -> NDArray[np.float64]:
        """The translation seen least, odom frame, (3,); its largest component is positive."""
        v = self.translation_directions[:, 0]
        return np.asarray(v * np.sign(v[np.argmax(np.abs(v))]))


def observability(equations: NormalEquations, mean_square_range: float) -> Observability:
    """Return the eigenvalues of the information of one registration (J. Zhang et al., "On degeneracy", ICRA 2016).

    What noise of the planes' normals feigns is taken off. Unlike eigenvalues of the raw sum they do not count points,
    and unlike those of the joint 6x6 matrix they do not mix radians with metres; one threshold therefore serves a small
    room and a wide street.

    Parameters
    ----------
    equations : NormalEquations
        Its block of the pose is used.
    mean_square_range : float
        Mean of the points' squared distances [m^2].
    """
    if equations.weight <= 0.0:
        zero, eye = np.zeros(3), np.eye(3)
        return Observability(rotation=zero, translation=zero, rotation_directions=eye, translation_directions=eye)
    pose = equations.columns_of("pose")
    H = (equations.information[pose, pose] - equations.feigned[pose, pose]) / equations.weight
    rotation, rotation_directions = np.linalg.eigh(H[:3, :3] / max(mean_square_range, 1e-12))
    translation, translation_directions = np.linalg.eigh(H[3:, 3:])
    return Observability(
        rotation=np.maximum(rotation, 0.0),
        translation=np.maximum(translation, 0.0),
        rotation_directions=rotation_directions,
        translation_directions=translation_directions,
    )
