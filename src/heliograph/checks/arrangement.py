"""Which way round the axes are: the 48 ways to label three axes, judged by what two sensors saw alike."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations, product

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import Array, freeze
from heliograph.checks.evidence import Evidence
from heliograph.checks.fit import EXCLUSION_CHI_SQUARE, TurnFit, cross, fit_turns, nearest_orthogonal, without_mean_rate
from heliograph.checks.windows import Forces, Turns
from heliograph.data import Rig
from heliograph.lie import so3

__all__ = [
    "ARRANGEMENTS",
    "Arrangement",
    "accel_arrangement",
    "gyro_arrangement",
    "is_mirrored",
    "misalignment",
    "mounting_of",
    "name_of",
    "remap",
]


_FORCE_SIGMA = 0.1  # the least that two sensors differ over one window [m/s^2]


def _arrangements() -> Array:
    """Return all signed permutations, (48, 3, 3): identity first, then by how many axes they change."""
    rows = []
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            P = np.zeros((3, 3))
            P[range(3), order] = signs
            rows.append(P)
    # Among equals the sign flips come before the swaps, and fewer flips before more: the simplest mistake is named.
    rows.sort(key=lambda P: (int(np.count_nonzero(np.diag(P) != 1.0)), np.count_nonzero(P < 0.0)))
    return np.stack(rows)


ARRANGEMENTS: Array = _arrangements()
"""Signed permutations P with ``recorded = P @ true``, (48, 3, 3); the first is the identity."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Arrangement:
    """How a sensor's axes lie, judged against the LiDAR.

    Parameters
    ----------
    possible : (48,) bool
        Arrangements that the data do not exclude.
    """

    possible: NDArray[np.bool_]

    def __post_init__(self) -> None:
        freeze(self)

    @property
    def as_expected(self) -> bool:
        """Whether the axes may be as the mounting says."""
        return bool(self.possible[0])

    @property
    def excluded(self) -> int:
        """How many of the 47 other arrangements cannot be."""
        return int(np.count_nonzero(~self.possible[1:]))


def mounting_of(rig: Rig, turns: Turns) -> Array | None:
    """Return R_imu_lidar as the recording tells it; where nothing tells, the right-handed one that fits the turns.

    None where the turns do not show it.
    """
    if rig.known:
        return np.asarray(rig.T_imu_lidar[:3, :3])
    fit = fit_turns(turns)
    return nearest_orthogonal(cross(turns)[0], handed=1.0) if fit is not None and fit.determined else None


def _mounting_by_turns(rig: Rig, turns: Turns) -> Array | None:
    """Return R_imu_lidar as the turns show it where they do: a mounting some degrees off must not look like wrong axes.

    The gyroscope's own arrangement, the one nearest to what fits, is taken out of the fit.
    """
    R, fit = mounting_of(rig, turns), fit_turns(turns)
    if R is None or fit is None or not fit.determined:
        return R
    P = ARRANGEMENTS[int(np.einsum("kij,ij->k", ARRANGEMENTS, fit.R_imu_lidar @ R.T).argmax())]
    shown = np.asarray(P.T @ fit.R_imu_lidar)
    return shown if float(np.linalg.det(shown)) > 0.0 else R


def gyro_arrangement(evidence: Evidence) -> Arrangement | None:
    """Judge the gyroscope's axes by the LiDAR's turns, where the mounting is known.

    In ``phi_imu = s P R phi_lidar + b span`` the bias b is projected out; scale s and cost of every arrangement P then
    follow from ``B = sum phi_imu phi_lidar^T`` alone: with the energies E of both sides, ``s = <P R, B> / E_lidar`` and
    ``cost = E_imu - s^2 E_lidar``. That is Wahba's problem (see `fit_turns`) over the 48 labellings of the axes,
    left-handed ones included.
    """
    turns, motion = evidence.turns, evidence.motion
    if turns is None or motion is None or not motion.rig.known:
        return None
    fit = fit_turns(turns)
    if fit is None:
        return None
    B, energy_imu, energy_lidar = cross(turns)
    R = motion.rig.T_imu_lidar[:3, :3]
    scales = np.maximum(np.einsum("kij,jl,il->k", ARRANGEMENTS, R, B), 0.0) / energy_lidar
    costs = energy_imu - scales**2 * energy_lidar
    return Arrangement(possible=costs - costs.min() < EXCLUSION_CHI_SQUARE * fit.unit)


def accel_arrangement(evidence: Evidence) -> Arrangement | None:
    """Judge the accelerometer's axes by gravity and by how the LiDAR accelerates.

    In the odom frame ``R_odom_lidar R_lidar_imu P^T f = a - g``: with the right arrangement P what the accelerometer
    shows beyond the LiDAR's acceleration is one constant vector, gravity's; its mean is projected out. A reversed
    gravity shows in the acceleration having the wrong sign.
    """
    forces, turns, motion = evidence.forces, evidence.turns, evidence.motion
    if forces is None or turns is None or motion is None:
        return None
    R = _mounting_by_turns(motion.rig, turns)
    if R is None:
        return None
    R_lidar_imu = np.einsum("ji,klj->kil", R, ARRANGEMENTS)  # R^T P^T
    costs = _force_costs(forces, R_lidar_imu)
    sigma = max(float(np.sqrt(costs.min() / (3 * len(forces.lidar)))), _FORCE_SIGMA)
    return Arrangement(possible=costs - costs.min() < EXCLUSION_CHI_SQUARE * forces.overlap * sigma**2)


def is_mirrored(gyro: Arrangement | None, accel: Arrangement | None) -> bool:
    """Whether it is the cloud that is a mirror image, and not both of the IMU's sensors that are wrong.

    In a mirror M accelerations turn to ``M a`` and turns, which are axial vectors, to ``-M phi``.
    """
    if gyro is None or accel is None or gyro.as_expected or accel.as_expected:
        return False
    if np.sum(gyro.possible) != 1 or np.sum(accel.possible) != 1:
        return False
    P_gyro, P_accel = (ARRANGEMENTS[int(np.flatnonzero(found.possible)[0])] for found in (gyro, accel))
    return bool(np.array_equal(P_accel, -P_gyro) and np.linalg.det(P_accel) < 0.0)


def _force_costs(forces: Forces, R_lidar_imu: Array) -> Array:
    """Return, for each (K, 3, 3) candidate, the scatter of specific force less acceleration, (K,).

    Gravity is what fits best, and so is the lever arm: a wrong one must not look like wrong axes.
    """
    measured = np.einsum("nabc,kbc->nak", forces.specific, R_lidar_imu)
    rest = (measured - forces.lidar[..., None]).reshape(-1, len(R_lidar_imu))
    free = [np.tile(np.eye(3), (len(forces.lidar), 1)), forces.R_odom_lidar.reshape(-1, 3)]
    basis = np.linalg.qr(np.concatenate(free, axis=1))[0]
    return np.asarray(((rest - basis @ (basis.T @ rest)) ** 2).sum(axis=0))


def name_of(P: Array) -> str:
    """Name a signed permutation: "y and z swapped, x reversed"; empty for the identity."""
    order = np.abs(P).argmax(axis=1)
    flipped = ["xyz"[i] for i in range(3) if P[i, order[i]] < 0.0]
    moved = [i for i in range(3) if order[i] != i]
    words = []
    if len(moved) == 2:
        words.append(f"{'xyz'[moved[0]]} and {'xyz'[moved[1]]} swapped")
    elif moved:
        words.append(f"x, y, z carry {', '.join('xyz'[i] for i in order)}")
    if len(flipped) == 3 and not moved:
        words.append("all axes reversed")
    elif flipped:
        words.append(f"{' and '.join(', '.join(flipped).rsplit(', ', 1))} reversed")
    return ", ".join(words)


def remap(P: Array) -> str:
    """Tell how the true axes are made of the recorded ones: "(x, y, z) = (-x, z, y)"."""
    rows = P.T  # true = P^T recorded
    order = np.abs(rows).argmax(axis=1)
    return "(x, y, z) = (" + ", ".join(("-" if rows[i, order[i]] < 0 else "") + "xyz"[order[i]] for i in range(3)) + ")"


def misalignment(turns: Turns, R_imu_lidar: Array, fit: TurnFit) -> tuple[float, float, int]:
    """Return how far a mounting is turned off about the axes that the turns show, its sigma [rad], and their number.

    Small rotations beside the mounting, by the normal equations of the same residuals; an axis about which the sigma
    stays above a degree is left out.
    """
    x = without_mean_rate(turns, turns.imu / max(fit.scale, 1e-9))
    y = without_mean_rate(turns, turns.lidar @ R_imu_lidar.T)
    H = so3.hat(y)
    unit = fit.unit / max(fit.scale, 1e-9) ** 2
    values, vectors = np.linalg.eigh(np.einsum("nij,nil->jl", H, H))
    seen = values > unit / np.radians(1.0) ** 2
    if not np.any(seen):
        return 0.0, np.inf, 0
    gradient = -np.einsum("nij,ni->j", H, x - y)
    shift = (vectors[:, seen].T @ gradient) / values[seen]
    return float(np.linalg.norm(shift)), float(np.sqrt((unit / values[seen]).max())), int(np.count_nonzero(seen))
