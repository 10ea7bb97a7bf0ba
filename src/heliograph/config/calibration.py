"""Defaults of calibration between sensors."""

from __future__ import annotations

from dataclasses import dataclass

from heliograph.config_checks import check_range

__all__ = ["CalibrationConfig"]


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationConfig:
    """`heliograph calibrate`: the prior, and what counts as observed.

    Parameters
    ----------
    prior_rotation_deg, prior_lever : float
        One-sigma of the mounting that the calibration starts from, an axis [deg], [m].
    prior_offset, prior_drift_ppm : float
        One-sigma of the clock's offset [s] and drift [1e-6].
    useful_rotation_deg, useful_lever, useful_offset, useful_drift_ppm : float
        What is known better than this counts as observed [deg], [m], [s], [1e-6].
    gain : float
        The motion must lower the sigma of a direction by this factor, or the prior is kept there.
    search : float
        Clock offsets looked at, on either side [s].
    points : int
        Largest number of points of a scan that are used.
    matches : int
        Points to place a scan with.
    passes : int
        Largest number of rounds of de-skewing, placing and solving.
    longest : float
        How much of the recording is used, from its start [s].
    plane_sigma, plane_kernel, plane_gate : float
        Range noise across planes that placing starts from, scale of its robust kernel, and largest distance of a match
        [m]; a LiDAR whose ranges scatter by more than 5 cm needs all three larger.
    """

    prior_rotation_deg: float = 5.0
    prior_lever: float = 0.3
    prior_offset: float = 0.03
    prior_drift_ppm: float = 50.0
    useful_rotation_deg: float = 0.1
    useful_lever: float = 0.005
    useful_offset: float = 2.5e-4
    useful_drift_ppm: float = 20.0
    gain: float = 3.0
    search: float = 0.2
    points: int = 12000
    matches: int = 2500
    passes: int = 10
    longest: float = 90.0
    plane_sigma: float = 0.02
    plane_kernel: float = 0.06
    plane_gate: float = 0.15

    def __post_init__(self) -> None:
        check_range(self, "prior_rotation_deg", "prior_lever", "prior_offset", "prior_drift_ppm", above=0.0)
        check_range(self, "useful_rotation_deg", "useful_lever", "useful_offset", "useful_drift_ppm", above=0.0)
        check_range(self, "search", "longest", "plane_sigma", "plane_kernel", "plane_gate", above=0.0)
        check_range(self, "gain", "passes", low=1)
        check_range(self, "points", "matches", low=100)
