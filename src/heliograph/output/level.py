"""How well a run knows which way is up, and what that does to positions in a level frame."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import freeze
from heliograph.lie import s2, so3

__all__ = ["Level"]

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Level:
    """The level of a run, that of its last gravity, as a turn about the odom frame's origin.

    At rest an accelerometer's bias looks like a tilt, and on a straight way it stays so: the map leans, and by how much
    is one number for the whole run. Turns tell the two apart; every pose is levelled by what is known at the end, those
    before the turn as well.

    Parameters
    ----------
    covariance : (3, 3) float64
        Covariance of the turn, odom axes [rad^2]: none about gravity itself.
    reach : float
        Largest horizontal distance from where the run began [m].
    known : bool
        False without gravity, as without an IMU: up is then the sensor's own at the start.
    """

    covariance: Array = field(default_factory=lambda: np.zeros((3, 3)))
    reach: float = 0.0
    known: bool = False

    def __post_init__(self) -> None:
        freeze(self)

    @classmethod
    def of_gravity(cls, g_odom: Array, covariance: Array, reach: float) -> Level:
        """Return the level by a run's last gravity (3,), whose direction has the covariance (2, 2) on the sphere."""
        g = float(np.linalg.norm(g_odom))
        if g == 0.0 or not covariance.any():
            return cls(reach=reach)
        down = g_odom / g
        turn = so3.hat(down) @ s2.basis(down)  # levelling turns by as much as gravity is off, about an axis across both
        return cls(covariance=turn @ covariance @ turn.T, reach=reach, known=True)

    @property
    def sigma(self) -> float:
        """Sigma of the tilt about its worst axis [rad]."""
        return float(np.sqrt(max(float(np.linalg.eigvalsh(self.covariance)[-1]), 0.0)))

    @property
    def sigma_position(self) -> float:
        """Sigma of the height that the tilt leaves at the farthest place [m]."""
        return self.sigma * self.reach

    def of_positions(self, p_odom: Array) -> Array:
        """Return the covariance that the tilt adds to positions (N, 3) of the odom frame, (N, 3, 3) [m^2]."""
        lever = so3.hat(p_odom)
        return np.asarray(lever @ self.covariance @ np.swapaxes(lever, -1, -2))

    def of_rotations(self, R_odom_imu: Array) -> Array:
        """Return the covariance that the tilt adds to rotations (N, 3, 3), about body axes, (N, 3, 3) [rad^2]."""
        return np.asarray(np.swapaxes(R_odom_imu, -1, -2) @ self.covariance @ R_odom_imu)

    def sentence(self) -> str:
        """Return what a person is told, empty where nothing is known."""
        if not self.known:
            return ""
        return (
            f"level known to {np.degrees(self.sigma):.2g} deg: +- {self.sigma_position:.2g} m of height at "
            f"{self.reach:.0f} m from the start"
        )
