"""What the checks read, and what they say."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import frozen
from heliograph.data import ImuRecord, Rig, Trajectory
from heliograph.errors import DataError

__all__ = ["VERDICTS", "CheckReport", "CheckedMotion", "Finding", "ImuRecord", "Number", "worst"]

VERDICTS = ("unknown", "ok", "warn", "fail")
"""Verdicts, the worse later. ``unknown``: the recording cannot tell; ``warn``: it costs accuracy, or Heliograph has
repaired what other programs will stumble over; ``fail``: no estimator can work with it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CheckedMotion:
    """How the LiDAR alone saw the sensor move.

    Parameters
    ----------
    trajectory : Trajectory
        T_odom_lidar at the middles of the sweeps, from an odometry without the IMU.
    tracked : (N,) bool
        Whether the scan was matched; elsewhere the pose is a guess.
    rig : Rig
        Mounting of the LiDAR on the IMU as the recording tells it.
    sweep : float
        Time over which the points of a scan were measured, and each pose therefore is a mean [s].
    """

    trajectory: Trajectory
    tracked: NDArray[np.bool_]
    rig: Rig
    sweep: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "tracked", frozen("tracked", self.tracked, np.bool_, (len(self.trajectory),)))

    def __len__(self) -> int:
        return len(self.trajectory)


@dataclass(frozen=True, slots=True, kw_only=True)
class Number:
    """One measured quantity.

    Parameters
    ----------
    name : str
        What it is.
    value : float or None
        None where it could not be measured.
    unit : str
        Unit of the value and the limit; empty for shares and counts.
    limit : float or None
        Where the verdict turns; None for what has none.
    """

    name: str
    value: float | None
    unit: str = ""
    limit: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """What one check found.

    Parameters
    ----------
    code : str
        Short stable name, e.g. ``"gyro-axes"``; tests and tools match on it.
    title : str
        For people.
    verdict : str
        One of `VERDICTS`.
    evidence : str
        One sentence with what was observed.
    remedy : str
        One sentence with what to do; empty when all is well.
    numbers : tuple of Number
        The first is the one that decided.
    stamps_ns : tuple of int
        When it happened, where it happened at instants; the first few [ns].
    consequence : bool
        Whether it usually follows from another finding, which is then the one to act on.
    picture : str
        Where a run's folder shows it; empty where nothing does.
    """

    code: str
    title: str
    verdict: str
    evidence: str
    remedy: str = ""
    numbers: tuple[Number, ...] = ()
    stamps_ns: tuple[int, ...] = ()
    consequence: bool = False
    picture: str = ""

    def __post_init__(self) -> None:
        if self.verdict not in VERDICTS:
            raise DataError(f"verdict '{self.verdict}' of {self.code} is not one of {', '.join(VERDICTS)}")
        if self.verdict in ("warn", "fail") and not self.remedy:
            raise DataError(f"finding {self.code} is '{self.verdict}' without a remedy; say what to do")


@dataclass(frozen=True, slots=True, kw_only=True)
class CheckReport:
    """All findings about a recording.

    Parameters
    ----------
    recording : str
        Its name.
    findings : tuple of Finding
        In the order in which causes precede consequences.
    facts : dict
        What the findings rest on: samples, seconds, scans, mounting, and what the reader inferred.
    """

    recording: str
    findings: tuple[Finding, ...]
    facts: dict[str, object] = field(default_factory=dict)

    @property
    def verdict(self) -> str:
        """The worst verdict; what is unknown counts for nothing."""
        return max((finding.verdict for finding in self.findings), key=VERDICTS.index, default="unknown")

    def as_dict(self) -> dict[str, object]:
        """Return plain values for JSON, with the overall verdict and the remedy that matters most."""
        found = worst(self.findings)
        decided = {} if found is None else {"code": found.code, "remedy": found.remedy}
        return {**asdict(self), "verdict": self.verdict, "worst": decided}


def worst(findings: tuple[Finding, ...]) -> Finding | None:
    """Return the finding to act on first; None without any.

    It is the first of the worst verdict, because causes come before consequences; what is marked as a consequence only
    counts where nothing else is wrong.
    """
    causes = [finding for finding in findings if finding.verdict in ("warn", "fail") and not finding.consequence]
    return max(causes or findings, key=lambda finding: VERDICTS.index(finding.verdict), default=None)
