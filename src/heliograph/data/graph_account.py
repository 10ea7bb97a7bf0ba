"""What a back-end made of a run."""

from __future__ import annotations

from dataclasses import dataclass

from heliograph.data.gnss_account import GnssAccount
from heliograph.data.wheels import WheelAccount

__all__ = ["GraphAccount"]


@dataclass(frozen=True, slots=True, kw_only=True)
class GraphAccount:
    """Counts of a run's graph, and the files that it left beside the others.

    Parameters
    ----------
    keyframes : int
    candidates, accepted, held, rejected, revoked : int
        Loops that were looked at, that stand, that too little speaks for yet, that were refused, and that stood and
        were taken back.
    moved : float
        How far the keyframe that loops moved most lies from odometry, seen from the first one [m].
    gnss : GnssAccount or None
        What became of satellite fixes; None where there were none.
    wheels : WheelAccount or None
        What became of speeds by wheels or legs; None where there were none.
    files : tuple of str
        Names in the run's folder.
    """

    keyframes: int = 0
    candidates: int = 0
    accepted: int = 0
    held: int = 0
    rejected: int = 0
    revoked: int = 0
    moved: float = 0.0
    gnss: GnssAccount | None = None
    wheels: WheelAccount | None = None
    files: tuple[str, ...] = ()
