"""Which directions a registration cannot see: eigenvalues, and how much of them the noise of normals feigns."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import freeze
from heliograph.lie import so3

__all__ = ["DirectionInformation", "InformationAnalysis", "analyse_information", "analyse_planes"]

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class DirectionInformation:
    """What is known along one direction.

    Parameters
    ----------
    kind : str
        ``"rotation"`` about `direction`, or ``"translation"`` along it.
    direction : (3,) float64
        Unit vector, source frame; its largest component is positive.
    information : float
        Eigenvalue [1/rad^2] or [1/m^2].
    noise : float
        Information that the noise of the normals alone is expected to feign there; 0 where it is not known.
    probability : float
        That the direction is unobservable: that its true information is below ``gain`` times `noise`.
    blind : bool
        Whether that is at least the probability asked for.
    """

    kind: str
    direction: Array
    information: float
    noise: float
    probability: float
    blind: bool

    def __post_init__(self) -> None:
        freeze(self)

    def __str__(self) -> str:
        x, y, z = self.direction
        way = "about" if self.kind == "rotation" else "along"
        return f"{self.kind} {way} ({x:+.2f}, {y:+.2f}, {z:+.2f})"


@dataclass(frozen=True, slots=True, kw_only=True)
class InformationAnalysis:
    """Rotation and translation apart: ascending eigenvalues, directions, noise and the probability of blindness.

    Parameters
    ----------
    rotation, translation : tuple of DirectionInformation
        Three each, the least known first. Rotation is what remains of it when the translation is unknown as well (its
        Schur complement), which does not depend on the point it is about; translation is that for a known rotation.
    information : (6, 6) float64
        The matrix they are of, right perturbation (rotation, translation).
    """

    rotation: tuple[DirectionInformation, ...]
    translation: tuple[DirectionInformation, ...]
    information: Array

    def __post_init__(self) -> None:
        freeze(self)

    @property
    def blind(self) -> tuple[DirectionInformation, ...]:
        """The directions that are not seen, rotations first."""
        return tuple(d for d in (*self.rotation, *self.translation) if d.blind)

    @property
    def condition_rotation(self) -> float:
        """Largest over smallest eigenvalue of rotation; infinite where the smallest is 0."""
        return _ratio(self.rotation)

    @property
    def condition_translation(self) -> float:
        """Largest over smallest eigenvalue of translation; infinite where the smallest is 0."""
        return _ratio(self.translation)

    def blind_basis(self) -> Array:
        """Return the motions that are not seen as columns of right perturbations, (6, K), not of unit length.

        A blind rotation turns about the point about which it moves nothing that is seen: its translation is the one
        that the information asks for.
        """
        R_t = self.information[3:, :3]
        values, vectors = np.linalg.eigh(self.information[3:, 3:])
        seen = np.array([not d.blind for d in self.translation]) & (values > 0.0)
        inverse = (vectors[:, seen] / values[seen]) @ vectors[:, seen].T
        columns = []
        for d in self.blind:
            if d.kind == "rotation":
                columns.append(np.concatenate([d.direction, -inverse @ R_t @ d.direction]))
            else:
                columns.append(np.concatenate([np.zeros(3), d.direction]))
        return np.stack(columns, axis=1) if columns else np.zeros((6, 0))


def _ratio(directions: tuple[DirectionInformation, ...]) -> float:
    low, high = directions[0].information, directions[-1].information
    return high / low if low > 0.0 else math.inf


def analyse_information(information: Array, *, threshold: float) -> InformationAnalysis:
    """Name the eigenvectors of an information matrix whose eigenvalue is below a fixed threshold as blind.

    That is the textbook's test (J. Zhang, M. Kaess, S. Singh, "On degeneracy of optimization-based state estimation
    problems", ICRA 2016): it needs no model of the noise, and a threshold for every sensor and scene.

    Parameters
    ----------
    information : (6, 6) float64
        Right perturbation (rotation, translation).
    threshold : float
        Smallest eigenvalue that counts as seen.
    """
    H = np.asarray(information, dtype=np.float64)
    rotation, _ = _marginal_rotation(H)
    sides = []
    for kind, block in (("rotation", rotation), ("translation", H[3:, 3:])):
        values, vectors = np.linalg.eigh(block)
        sides.append(
            tuple(
                _direction(kind, v, max(float(x), 0.0), 0.0, float(x < threshold), x < threshold)
                for x, v in zip(values, vectors.T, strict=True)
            )
        )
    return InformationAnalysis(rotation=sides[0], translation=sides[1], information=H)


def analyse_planes(
    points: Array,
    normals: Array,
    weights: Array,
    normal_variance: Array,
    *,
    probability: float = 0.5,
    gain: float = 3.0,
) -> InformationAnalysis:
    """Analyse point-to-plane matches, calibrated by the noise of their normals.

    Noise turns a normal ``n`` by ``e``, across it, with variance ``s^2`` in each direction. A direction ``v`` that the
    true normals do not see receives, in expectation, ``B = sum w s^2 u`` from that alone, with ``u = 1 - (n . v)^2``,
    and its variance is ``sum w^2 (4 (n . v)^2 s^2 u + 2 s^4 u^2)``; for rotation a turn of the normal enters through
    the point's lever. What is left after ``B`` is taken off is compared with ``gain B`` (after J. Hatleskog,
    K. Alexis, "Probabilistic degeneracy detection for point-to-plane error minimization", RA-L 2024).

    Parameters
    ----------
    points, normals : (M, 3) float64
        Source frame [m]; normals of unit length.
    weights : (M,) float64
        Inverse variance of each residual, times its robust weight [1/m^2].
    normal_variance : (M,) float64
        Normal_variance of each normal's direction, a direction [rad^2].
    probability : float
        From which a direction counts as blind.
    gain : float
        Information needed, in multiples of what noise feigns.
    """
    m = np.cross(points, normals)
    J = np.hstack([m, normals])
    H = (J * weights[:, None]).T @ J
    translation = _side("translation", H[3:, 3:], normals, normals, None, weights, normal_variance, probability, gain)
    seen = np.array([not d.blind for d in translation])
    values, vectors = np.linalg.eigh(H[3:, 3:])
    use = seen & (values > 1e-12 * max(values[-1], 1e-300))
    C = H[:3, 3:] @ (vectors[:, use] / values[use]) @ vectors[:, use].T
    rows = m - normals @ C.T
    block = (rows * weights[:, None]).T @ rows
    levers = (points, C)
    rotation = _side("rotation", block, rows, normals, levers, weights, normal_variance, probability, gain)
    return InformationAnalysis(rotation=rotation, translation=translation, information=H)


def _marginal_rotation(H: Array) -> tuple[Array, Array]:
    values, vectors = np.linalg.eigh(H[3:, 3:])
    use = values > 1e-9 * max(float(values[-1]), 1e-300)
    inverse = (vectors[:, use] / values[use]) @ vectors[:, use].T
    return H[:3, :3] - H[:3, 3:] @ inverse @ H[3:, :3], inverse


def _side(
    kind: str,
    block: Array,
    rows: Array,
    normals: Array,
    levers: tuple[Array, Array] | None,
    weights: Array,
    variance: Array,
    probability: float,
    gain: float,
) -> tuple[DirectionInformation, ...]:
    """Judge the eigenvectors of one side; `rows` is what each match says of it, `levers` how noise enters rotation."""
    values, vectors = np.linalg.eigh(block)
    found = []
    for value, v in zip(values, vectors.T, strict=True):
        along = rows @ v
        # How much a unit turn of the normal changes this row along v: the part of the arm across the normal, squared.
        if levers is None:
            across = np.maximum(1.0 - along**2, 0.0)
        else:
            arm = levers[0] @ so3.hat(v).T - v @ levers[1]
            across = np.maximum(np.einsum("ij,ij->i", arm, arm) - np.einsum("ij,ij->i", arm, normals) ** 2, 0.0)
        feigned = variance * across
        noise = float(weights @ feigned)
        spread = math.sqrt(float(weights**2 @ (4.0 * along**2 * feigned + 2.0 * feigned**2)))
        left = float(value) - noise
        p = _normal_cdf((gain * noise - left) / spread) if spread > 0.0 else float(left <= gain * noise)
        found.append(_direction(kind, v, max(float(value), 0.0), noise, p, p >= probability))
    return tuple(found)


def _direction(
    kind: str, v: Array, information: float, noise: float, probability: float, blind: bool
) -> DirectionInformation:
    turned = v * (np.sign(v[np.argmax(np.abs(v))]) or 1.0)
    return DirectionInformation(
        kind=kind,
        direction=turned,
        information=information,
        noise=noise,
        probability=probability,
        blind=bool(blind),
    )


def _normal_cdf(x: float) -> float:
    return 0.5 * math.erfc(-x / math.sqrt(2.0))
