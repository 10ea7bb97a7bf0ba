"""Defaults of satellite fixes: what they are trusted with, and when they say where the map lies on Earth."""

from __future__ import annotations

from dataclasses import dataclass

from heliograph.config_checks import check_range
from heliograph.errors import ConfigError

__all__ = ["GnssConfig"]


@dataclass(frozen=True, slots=True, kw_only=True)
class GnssConfig:
    """Satellite fixes in the graph.

    Parameters
    ----------
    use : bool
        Whether fixes are used where there are any.
    file : str
        Fixes from a file beside the recording: NMEA, an RTKLIB ``.pos``, or a CSV with a header; they replace the
        recording's own. See docs/howto/gnss.md.
    clock_offset : float
        What the file's clock, in UTC, shows more than the recording's [s].
    lever_arm : tuple of float
        The antenna in the imu frame [m]: three numbers. Empty: from the recording's transforms, else it is estimated.
    lever_arm_sigma : float
        How far off an antenna that nobody gave may be, a coordinate [m].
    floor_single, floor_sbas, floor_float, floor_fixed : float
        Least one-sigma of a fix, a horizontal coordinate, by how the receiver came by it, whatever it reports [m]; its
        height gets 1.5 times as much. Where a receiver reports no covariance, four times this is taken.
    acceptance : float
        Probability with which a sound fix passes the test of its residual.
    max_heading_sigma_deg : float
        The map is placed on Earth once the motion tells its heading this well [deg].
    correct_delay : bool
        Whether a constant delay of the fixes' stamps is estimated, and taken out where it is told.
    """

    use: bool = True
    file: str = ""
    clock_offset: float = 0.0
    lever_arm: tuple[float, ...] = ()
    lever_arm_sigma: float = 1.0
    floor_single: float = 0.3
    floor_sbas: float = 0.2
    floor_float: float = 0.05
    floor_fixed: float = 0.01
    acceptance: float = 0.999
    max_heading_sigma_deg: float = 3.0
    correct_delay: bool = True

    def __post_init__(self) -> None:
        check_range(self, "lever_arm_sigma", "floor_single", "floor_sbas", "floor_float", "floor_fixed", above=0.0)
        check_range(self, "acceptance", above=0.5, below=1.0)
        check_range(self, "max_heading_sigma_deg", above=0.0, high=45.0)
        if len(self.lever_arm) not in (0, 3):
            raise ConfigError(f"lever_arm has {len(self.lever_arm)} numbers; give x, y and z of the antenna, or none")

    def floor(self, solution: str) -> float:
        """Return the least one-sigma of a fix by its solution [m]."""
        floors = {"fixed": self.floor_fixed, "float": self.floor_float, "sbas": self.floor_sbas}
        return floors.get(solution, self.floor_single)
