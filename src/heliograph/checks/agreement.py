"""Whether IMU and LiDAR agree in time, and whether the IMU predicts the next scan better than no IMU would."""

from __future__ import annotations

import numpy as np

from heliograph.arrays import Array
from heliograph.checks.arrangement import mounting_of
from heliograph.checks.evidence import FORCE_SPAN, Evidence
from heliograph.checks.offset import MIN_CORRELATION
from heliograph.checks.records import CheckedMotion, Finding, Number
from heliograph.checks.windows import Forces, forces_over, lever_arm, turns_over

__all__ = ["check_clock_offset", "check_prediction"]


_MIN_SCANS = 20
_MAX_APART_NS = 1_000_000_000  # by which the beginnings and ends of two recorders may differ [ns]
# By how much the predictions must differ to be counted: below it, chance and the LiDAR's noise decide [rad], [m]. Where
# the IMU shows no change, the LiDAR must show that factor more.
_MIN_TURN_CHANGE, _MIN_WAY_CHANGE, _LIDAR_CHANGE_FACTOR = 0.006, 0.02, 3.0
_MIN_SHARES = {"rotation": 0.7, "translation": 0.4, "velocity": 0.5}
"""Shares of scans that the IMU must predict better than a constant velocity does: those of GLIM's IMUValidation
(K. Koide et al., GLIM: 3D range-inertial localization and mapping with GPU-accelerated scan matching factors, 2024).
docs/howto/check_imu.md gives the shares that sound and spoilt simulations reach."""


def check_clock_offset(evidence: Evidence) -> Finding:
    """Estimate roughly by how much the IMU's stamps are late: the peak of the angular speeds' correlation.

    Speeds, not vectors, so that wrong axes and mountings do not matter; the gyroscope's bias is taken out first. The
    comparisons of axes and mounting are made at the offset found, so that it does not look like a wrong mounting.
    """
    code, title = "clock-offset", "LiDAR-IMU clock offset"
    if (apart := _stamp_distance(evidence)) is not None:
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
        Number(name="offset", value=offset.seconds, unit="s", limit=evidence.config.warn_offset),
        Number(name="correlation", value=offset.correlation, limit=MIN_CORRELATION),
    )
    if not offset.determined:
        alike = f"too unlike to tell (correlation {offset.correlation:.2f})"
        text = f"the angular speeds are {'too even to tell' if offset.correlation >= MIN_CORRELATION else alike}"
        return Finding(code=code, title=title, verdict="unknown", evidence=text, numbers=numbers)
    late, sigma = 1e3 * offset.seconds, 1e3 * offset.sigma
    way = "late" if late > 0.0 else "early"
    text = f"the angular speeds match best with the IMU's stamps {abs(late):.0f} ms (+- {max(sigma, 1.0):.0f}) {way}"
    if not offset.significant(evidence.config.warn_offset):
        return Finding(code=code, title=title, verdict="ok", evidence=text, numbers=numbers)
    return Finding(
        code=code,
        title=title,
        verdict="fail" if abs(offset.seconds) > evidence.config.max_offset else "warn",
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
        Number(name=name, value=share, limit=_MIN_SHARES[name]) for name, (share, count) in shares.items() if count
    )
    listed = ", ".join(f"{name} of {100 * share:.0f} %" for name, (share, count) in shares.items() if count)
    text = f"the IMU predicts {listed} of the scans in motion better than a constant velocity does"
    if not numbers:
        return Finding(code=code, title=title, verdict="unknown", evidence="too few scans in motion to predict")
    poor = {name for name, (share, count) in shares.items() if count and share < _MIN_SHARES[name]}
    if not poor:
        return Finding(code=code, title=title, verdict="ok", evidence=text, numbers=numbers)
    return Finding(
        code=code,
        title=title,
        verdict="fail" if "rotation" in poor else "warn",
        evidence=text,
        remedy=_find_remedy(poor),
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
    turns, forces = turns_over(evidence.batch, motion, 1), _forces(evidence, motion)
    if turns is None or forces is None:
        return None
    seen = turns.lidar @ R.T
    bias = np.median((turns.imu - seen) / turns.spans[:, None], axis=0)
    felt = turns.imu - bias * turns.spans[:, None]
    follows = np.flatnonzero(np.diff(turns.first) == 1)  # windows with one directly before them
    rotation = _count_better(felt[follows + 1] - seen[follows], (seen[follows + 1] - seen[follows]), _MIN_TURN_CHANGE)
    a = forces.imu_acceleration(lever_arm(motion))
    f = np.einsum("nabc,cb->na", forces.specific, R)
    f = f - np.median(f - a, axis=0)
    way = forces.half_span[:, None] ** 2
    follows = np.flatnonzero(np.diff(forces.first) == 1)
    both = [(v[follows] + v[follows + 1]) / 2.0 * way[follows] for v in (f, a)]
    found = {
        "rotation": rotation,
        "translation": _count_better(f * way, a * way, _MIN_WAY_CHANGE),
        "velocity": _count_better(both[0], both[1], _MIN_WAY_CHANGE),
    }
    return {name: (share, count if count >= _MIN_SCANS else 0) for name, (share, count) in found.items()}


def _forces(evidence: Evidence, motion: CheckedMotion) -> Forces | None:
    """Return the accelerations of the samples as they came; those at hand where they are the same."""
    if evidence.as_recorded and evidence.forces is not None:
        return evidence.forces
    return forces_over(evidence.batch, motion, FORCE_SPAN)


def _count_better(predicted: Array, actual: Array, least: float) -> tuple[float, int]:
    """Return how often ``predicted`` is nearer to ``actual`` than zero is, and how many were counted."""
    size = np.linalg.norm(actual, axis=1)
    counted = (np.linalg.norm(predicted, axis=1) > least) | (size > _LIDAR_CHANGE_FACTOR * least)
    better = np.linalg.norm(predicted - actual, axis=1) < size
    return (float(better[counted].mean()) if np.any(counted) else 0.0), int(np.count_nonzero(counted))


def _find_remedy(poor: set[str]) -> str:
    """Name the remedy by what is predicted badly: rotation is the gyroscope's, the rest the accelerometer's."""
    if "rotation" in poor:
        return "the gyroscope misleads: see its unit, axes, mounting and clock offset above, in this order"
    if "translation" in poor:
        return "the accelerometer misleads: see its unit and axes, the mounting and vibration above, in this order"
    return "the accelerometer's mean misleads: calibrate its bias (six positions at rest), or see the clock offset"


def _stamp_distance(evidence: Evidence) -> float | None:
    """Return how far apart the two sensors' stamps lie where they do not overlap at all [s]."""
    if evidence.motion is None or min(len(evidence.batch), len(evidence.motion)) < _MIN_SCANS:
        return None
    imu, lidar = evidence.batch.stamps_ns, evidence.motion.trajectory.stamps_ns
    apart = max(int(lidar[0] - imu[-1]), int(imu[0] - lidar[-1]))
    return apart * 1e-9 if apart > _MAX_APART_NS else None
