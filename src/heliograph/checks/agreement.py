"""Whether IMU and LiDAR agree in time, and whether the IMU predicts the next scan better than no IMU would."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from heliograph.checks.arrangement import mounting_of
from heliograph.checks.evidence import Evidence
from heliograph.checks.offset import ALIKE, WORTH_TELLING
from heliograph.checks.records import Finding, Number
from heliograph.checks.windows import forces_over, lever_arm, turns_over

__all__ = ["check_clock_offset", "check_prediction"]

Array = NDArray[np.float64]

_HOPELESS = 0.2  # offset that no calibration begins from [s]
_FEWEST = 20
_MEETING_NS = 1_000_000_000  # two recorders may begin and end so far apart
# By how much the predictions must differ to be counted: below it, chance and the LiDAR's noise decide [rad], [m]. Where
# the IMU tells of no change, the LiDAR must show so many times as much.
_CHANGED_TURN, _CHANGED_WAY, _PLAIN = 0.006, 0.02, 3.0
_WAY_SPAN = 2  # scans between the positions compared: over one, the LiDAR's noise is as large as most accelerations
_BETTER = {"rotation": 0.7, "translation": 0.4, "velocity": 0.5}
"""Shares of scans that the IMU must predict better than a constant velocity does: those of GLIM's IMUValidation
(K. Koide et al., GLIM: 3D range-inertial localization and mapping with GPU-accelerated scan matching factors, 2024).
docs/howto/check_imu.md gives the shares that sound and spoilt simulations reach."""


def check_clock_offset(evidence: Evidence) -> Finding:
    """Estimate roughly by how much the IMU's stamps are late: the peak of the angular speeds' correlation.

    Speeds, not vectors, so that wrong axes and mountings do not matter; the gyroscope's bias is taken out first. The
    comparisons of axes and mounting are made at the offset found, so that it does not look like a wrong mounting.
    """
    code, title = "clock-offset", "LiDAR-IMU clock offset"
    if (apart := _apart(evidence)) is not None:
        return Finding(
            code=code,
            title=title,
            verdict="fail",
            evidence=f"LiDAR and IMU are never stamped alike: their stamps lie {apart:.1f} s apart",
            remedy="stamp both by one clock (PTP, or the drivers' option to use the computer's time) and record again",
            numbers=(Number(name="apart", value=apart, unit="s", limit=0.0),),
        )
    offset = evidence.offset
    if offset is None:
        why = evidence.why or "LiDAR and IMU overlap too little in time"
        return Finding(code=code, title=title, verdict="unknown", evidence=why)
    numbers = (
        Number(name="offset", value=offset.seconds, unit="s", limit=WORTH_TELLING),
        Number(name="correlation", value=offset.correlation, limit=ALIKE),
    )
    if not offset.told:
        alike = f"too unlike to tell (correlation {offset.correlation:.2f})"
        text = f"the angular speeds are {'too even to tell' if offset.correlation >= ALIKE else alike}"
        return Finding(code=code, title=title, verdict="unknown", evidence=text, numbers=numbers)
    late, sigma = 1e3 * offset.seconds, 1e3 * offset.sigma
    way = "late" if late > 0.0 else "early"
    text = f"the angular speeds match best with the IMU's stamps {abs(late):.0f} ms (+- {max(sigma, 1.0):.0f}) {way}"
    if not offset.significant:
        return Finding(code=code, title=title, verdict="ok", evidence=text, numbers=numbers)
    return Finding(
        code=code,
        title=title,
        verdict="fail" if abs(offset.seconds) > _HOPELESS else "warn",
        evidence=text,
        remedy="`heliograph calibrate` measures the offset; synchronise the clocks (PTP, PPS) for the next recording",
        numbers=numbers,
    )


def check_prediction(evidence: Evidence) -> Finding:
    """Count the scans that the IMU predicts better than a constant velocity does, in rotation, translation, velocity.

    From three scans in a row: the LiDAR's change from one step to the next is what a constant velocity misses, and what
    it differs from the IMU's is what the IMU misses. Gyroscope bias and gravity are the medians over the recording.
    """
    code, title = "imu-prediction", "prediction"
    shares = prediction_shares(evidence)
    if shares is None:
        return Finding(
            code=code, title=title, verdict="unknown", evidence=evidence.why or "too few scans in motion to predict"
        )
    numbers = tuple(
        Number(name=name, value=share, limit=_BETTER[name]) for name, (share, count) in shares.items() if count
    )
    told = ", ".join(f"{name} of {100 * share:.0f} %" for name, (share, count) in shares.items() if count)
    text = f"the IMU predicts {told} of the scans in motion better than a constant velocity does"
    if not numbers:
        return Finding(code=code, title=title, verdict="unknown", evidence="too few scans in motion to predict")
    poor = {name for name, (share, count) in shares.items() if count and share < _BETTER[name]}
    if not poor:
        return Finding(code=code, title=title, verdict="ok", evidence=text, numbers=numbers)
    return Finding(
        code=code,
        title=title,
        verdict="fail" if "rotation" in poor else "warn",
        evidence=text,
        remedy=_blamed(poor),
        consequence=True,
        numbers=tuple(sorted(numbers, key=lambda number: number.name not in poor)),
    )


def prediction_shares(evidence: Evidence) -> dict[str, tuple[float, int]] | None:
    """Return, for rotation, translation and velocity, the share predicted better and the number of scans counted."""
    motion = evidence.motion
    if motion is None or evidence.turns is None:
        return None
    R = mounting_of(motion.rig, evidence.turns)
    if R is None:
        return None
    turns, forces = turns_over(evidence.batch, motion, 1), forces_over(evidence.batch, motion, _WAY_SPAN)
    if turns is None or forces is None:
        return None
    seen = turns.lidar @ R.T
    bias = np.median((turns.imu - seen) / turns.spans[:, None], axis=0)
    felt = turns.imu - bias * turns.spans[:, None]
    follows = np.flatnonzero(np.diff(turns.first) == 1)  # windows with one directly before them
    rotation = _compared(felt[follows + 1] - seen[follows], (seen[follows + 1] - seen[follows]), _CHANGED_TURN)
    a = forces.imu_acceleration(lever_arm(motion))
    f = np.einsum("nabc,cb->na", forces.specific, R)
    f = f - np.median(f - a, axis=0)
    way = forces.half_span[:, None] ** 2
    follows = np.flatnonzero(np.diff(forces.first) == 1)
    both = [(v[follows] + v[follows + 1]) / 2.0 * way[follows] for v in (f, a)]
    found = {
        "rotation": rotation,
        "translation": _compared(f * way, a * way, _CHANGED_WAY),
        "velocity": _compared(both[0], both[1], _CHANGED_WAY),
    }
    return {name: (share, count if count >= _FEWEST else 0) for name, (share, count) in found.items()}


def _compared(predicted: Array, actual: Array, least: float) -> tuple[float, int]:
    """Return how often ``predicted`` is nearer to ``actual`` than zero is, and how many were counted."""
    size = np.linalg.norm(actual, axis=1)
    counted = (np.linalg.norm(predicted, axis=1) > least) | (size > _PLAIN * least)
    better = np.linalg.norm(predicted - actual, axis=1) < size
    return (float(better[counted].mean()) if np.any(counted) else 0.0), int(np.count_nonzero(counted))


def _blamed(poor: set[str]) -> str:
    """Name the remedy by what is predicted badly: rotation is the gyroscope's, the rest the accelerometer's."""
    if "rotation" in poor:
        return "the gyroscope misleads: see its unit, axes, mounting and clock offset above, in this order"
    if "translation" in poor:
        return "the accelerometer misleads: see its unit and axes, the mounting and vibration above, in this order"
    return "the accelerometer's mean misleads: calibrate its bias (six positions at rest), or see the clock offset"


def _apart(evidence: Evidence) -> float | None:
    """Return how far apart the two sensors' stamps lie where they do not overlap at all [s]."""
    if evidence.motion is None or min(len(evidence.batch), len(evidence.motion)) < _FEWEST:
        return None
    imu, lidar = evidence.batch.stamps_ns, evidence.motion.trajectory.stamps_ns
    apart = max(int(lidar[0] - imu[-1]), int(imu[0] - lidar[-1]))
    return apart * 1e-9 if apart > _MEETING_NS else None
