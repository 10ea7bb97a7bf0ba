"""Whether the IMU's axes are what the recording says: gyroscope, accelerometer, mounting."""

from __future__ import annotations

import numpy as np

from heliograph.checks.arrangement import (
    ARRANGEMENTS,
    Arrangement,
    accel_arrangement,
    gyro_arrangement,
    misalignment,
    name_of,
    remap,
)
from heliograph.checks.evidence import Evidence
from heliograph.checks.fit import TurnFit, fit_turns
from heliograph.checks.records import Finding, Number
from heliograph.checks.windows import Turns

__all__ = ["check_accel_axes", "check_gyro_axes", "check_mounting"]

_MIN_EXCLUDED = 24  # of 47 other arrangements that must be excluded before the axes count as tested
_FOREIGN_SHARE = 0.5  # share of the turns that no arrangement explains
_MIN_TURN = 0.02  # mean turn over one window that is more than the LiDAR's noise [rad]


def check_gyro_axes(evidence: Evidence) -> Finding:
    """Compare the gyroscope's axes with the LiDAR's turns."""
    code, title = "gyro-axes", "gyroscope axes"
    turns, motion = evidence.turns, evidence.motion
    fit = fit_turns(turns) if turns is not None else None
    if turns is None or motion is None or fit is None:
        return _untested_finding(code, title, evidence.why or "the sensor does not turn")
    if foreign := _is_foreign(turns, fit):
        return Finding(
            code=code,
            title=title,
            verdict="fail",
            evidence=f"whichever way round, {100 * foreign:.0f} % of the gyroscope's turns are not the LiDAR's",
            remedy="see the findings above first; else the gyroscope belongs to another body, or its clock is far off",
            numbers=(Number(name="unexplained turns", value=foreign, limit=_FOREIGN_SHARE),),
        )
    found = gyro_arrangement(evidence)
    if found is None:
        return _handedness(code, title, fit)
    if found.excluded == 0:
        return _untested_finding(code, title, "the LiDAR sees hardly any turn")
    if found.as_expected:
        return _expected_finding(code, title, found, "turns")
    return _wrong_finding(code, title, found, accel_arrangement(evidence), "gyroscope")


def check_accel_axes(evidence: Evidence) -> Finding:
    """Compare the accelerometer's axes with gravity and the LiDAR's acceleration."""
    code, title = "accel-axes", "accelerometer axes"
    turns, motion = evidence.turns, evidence.motion
    fit = fit_turns(turns) if turns is not None else None
    if turns is None or motion is None or evidence.forces is None:
        return _untested_finding(code, title, evidence.why or "LiDAR and IMU overlap too little in time")
    if fit is not None and _is_foreign(turns, fit):
        return _untested_finding(code, title, "the IMU does not follow the LiDAR's turns; that comes first")
    found = accel_arrangement(evidence)
    if found is None:
        return _untested_finding(code, title, "nothing tells the mounting, and the turns do not show it")
    if found.as_expected:
        if found.excluded < _MIN_EXCLUDED:
            return _untested_finding(
                code, title, f"motion and tilt exclude {found.excluded} of 47 wrong arrangements only"
            )
        return _expected_finding(code, title, found, "gravity and acceleration")
    return _wrong_finding(code, title, found, gyro_arrangement(evidence), "accelerometer")


def check_mounting(evidence: Evidence) -> Finding:
    """Compare the mounting's rotation with the one that the turns show."""
    code, title = "mounting", "mounting rotation"
    turns, motion = evidence.turns, evidence.motion
    fit = fit_turns(turns) if turns is not None else None
    if turns is None or motion is None or fit is None:
        return _untested_finding(code, title, evidence.why or "the sensor does not turn")
    found = gyro_arrangement(evidence)
    if found is None:
        return _untested_finding(code, title, "nothing tells the mounting; a run aligns it from the motion")
    if not found.as_expected or _is_foreign(turns, fit):
        return _untested_finding(code, title, "the gyroscope's axes come first")
    angle, sigma, axes = misalignment(turns, np.asarray(motion.rig.T_imu_lidar[:3, :3]), fit)
    if axes == 0:
        return _untested_finding(code, title, "the LiDAR sees hardly any turn")
    limit = evidence.config.warn_mounting_deg
    numbers = (Number(name="off by", value=float(np.degrees(angle)), unit="deg", limit=limit),)
    about = {1: "the one axis", 2: "the two axes", 3: "the three axes"}[axes]
    text = f"{np.degrees(angle):.1f} deg (+- {np.degrees(sigma):.1f}) about {about} that the turns show"
    if angle < max(np.radians(limit), 5.0 * sigma):
        text = f"{motion.rig.source} agrees to {text}"
        return Finding(code=code, title=title, verdict="ok", evidence=text, numbers=numbers)
    return Finding(
        code=code,
        title=title,
        verdict="fail" if angle > np.radians(evidence.config.max_mounting_deg) else "warn",
        evidence=f"{motion.rig.source} is off by {text}",
        remedy="measure the mounting anew: `heliograph calibrate`, then --extrinsic FILE",
        numbers=numbers,
    )


def _expected_finding(code: str, title: str, found: Arrangement, by: str) -> Finding:
    others = 47 - found.excluded
    rest = f"; {others} {'is' if others == 1 else 'are'} not told from it" if others else ""
    return Finding(
        code=code,
        title=title,
        verdict="ok",
        evidence=f"as the mounting says: {by} exclude {found.excluded} of 47 wrong arrangements{rest}",
        numbers=(Number(name="excluded", value=float(found.excluded), limit=float(_MIN_EXCLUDED)),),
    )


def _wrong_finding(code: str, title: str, found: Arrangement, other: Arrangement | None, sensor: str) -> Finding:
    """Name the arrangement, and whose mistake it is: the mounting's where both sensors agree on a rotation."""
    shared = found.possible & other.possible if other is not None and not other.as_expected else np.zeros(48, bool)
    alike = bool(np.any(shared))
    possible = shared if alike else found.possible
    P, others = ARRANGEMENTS[int(np.flatnonzero(possible)[0])], int(np.count_nonzero(possible)) - 1
    text = name_of(P) + (f" (or one of {others} that this motion cannot tell from it)" if others else "")
    left = float(np.linalg.det(P)) < 0.0
    if np.array_equal(P, -np.eye(3)) and sensor == "accelerometer" and not alike:
        text = f"{name_of(P)}: at rest it reads g downwards"
        remedy = "negate the accelerometer in the driver: it must give specific force, +g upwards at rest"
    elif not alike:
        text += ", which makes it left-handed" if left else ""
        remedy = f"set the {sensor}'s axes right in the driver: true {remap(P)} recorded"
    elif left:
        text += ", like the other sensor's: a left-handed frame"
        remedy = f"no mounting can mend it: set the axes right in the driver, true {remap(P)} recorded"
    else:
        text += ", like the other sensor's"
        remedy = f"the mounting is wrong, not the IMU: correct /tf_static or give --extrinsic; true {remap(P)} recorded"
    return Finding(
        code=code,
        title=title,
        verdict="fail",
        evidence=text,
        remedy=remedy,
        numbers=(Number(name="arrangements possible", value=float(others + 1)),),
    )


def _handedness(code: str, title: str, fit: TurnFit) -> Finding:
    """Judge without a mounting: any right-handed arrangement is possible, a left-handed one is not."""
    if fit.handed == 0.0:
        return _untested_finding(code, title, "nothing tells the mounting, and the LiDAR turns about too few axes")
    if fit.handed > 0.0:
        text = "right-handed; nothing tells the mounting, so any rotation of the axes is possible"
        return Finding(code=code, title=title, verdict="ok", evidence=text)
    return Finding(
        code=code,
        title=title,
        verdict="fail",
        evidence="left-handed: no rotation brings the gyroscope's turns onto the LiDAR's, a reflection does",
        remedy="one axis is reversed or two are swapped: compare the driver with the data sheet, axis by axis",
    )


def _is_foreign(turns: Turns, fit: TurnFit) -> float:
    """Return the share of the gyroscope's turning that the best fit leaves; 0 where that is little, or noise."""
    size = float(np.sqrt(np.mean(np.var(turns.imu, axis=0))))
    share = min(1.0, fit.sigma / size) if size > _MIN_TURN else 0.0
    return share if share > _FOREIGN_SHARE else 0.0


def _untested_finding(code: str, title: str, why: str) -> Finding:
    return Finding(code=code, title=title, verdict="unknown", evidence=why)
