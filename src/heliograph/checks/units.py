"""Whether lengths are right: the accelerometer's unit by gravity, the gyroscope's by the LiDAR's turns."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from heliograph.checks.evidence import GRAVITY, Evidence
from heliograph.checks.fit import fit_turns
from heliograph.checks.records import Finding, Number
from heliograph.checks.windows import period_s

__all__ = ["check_accel_unit", "check_gyro_unit"]

_ACCEL_UNITS = {"m/s^2": 1.0, "g": GRAVITY, "mg": 1e-3 * GRAVITY, "cm/s^2": 1e-2, "mm/s^2": 1e-3}
_GYRO_UNITS = {
    "rad/s": 1.0,
    "deg/s": float(np.pi / 180.0),
    "mrad/s": 1e-3,
    "mdeg/s": float(np.pi / 180e3),
    "turns a second": float(2.0 * np.pi),
}
_UNIT_TOLERANCE = 0.15  # relative, for a unit to be recognised
_MAX_SCALE_SIGMA = 0.02  # relative sigma of the gyroscope's scale at which it may be judged
_MIN_FORCE = 2.0  # mean force below which gravity must have been taken out [m/s^2]
_MIN_DURATION_S = 5.0  # recordings in which motion may hide the scale [s]
_WINDOW_S, _QUIET_SHARE = 3.0, 0.1  # stretches that gravity is read from [s], and the share of them, the quietest


def check_accel_unit(evidence: Evidence) -> Finding:
    """Compare the mean force of the quietest stretches with gravity."""
    code, title, imu, batch = "accel-unit", "accelerometer unit", evidence.imu, evidence.batch
    if len(batch) < 10:
        return Finding(code=code, title=title, verdict="unknown", evidence=f"{len(batch)} samples are too few to tell")
    size = _mean_force(evidence)
    raw = size / imu.accel_factor
    numbers = (
        Number(name="off gravity", value=size - GRAVITY, unit="m/s^2", limit=evidence.config.max_accel_scale * GRAVITY),
        Number(name="mean force as recorded", value=raw),
    )
    measured = f"the mean force as recorded is {raw:#.4g}"
    unit = _recognise_unit(GRAVITY / raw if raw > 0.0 else np.inf, _ACCEL_UNITS)
    if unit == imu.accel_unit:
        off = size / GRAVITY - 1.0
        if (
            abs(off) > evidence.config.max_accel_scale
            and (batch.stamps_ns[-1] - batch.stamps_ns[0]) * 1e-9 < _MIN_DURATION_S
        ):
            text = f"{measured}: in {unit}, but too short to tell the scale"
            return Finding(code=code, title=title, verdict="unknown", evidence=text, numbers=numbers)
        if abs(off) > evidence.config.max_accel_scale:
            text = f"{measured}, {100 * off:+.1f} % off gravity in {unit}"
            remedy = "calibrate the accelerometer's scale and bias (six positions at rest), or check its range setting"
            return Finding(code=code, title=title, verdict="warn", evidence=text, remedy=remedy, numbers=numbers)
        if unit == "m/s^2":
            text = f"{measured}, {100 * off:+.1f} % off gravity"
            return Finding(code=code, title=title, verdict="ok", evidence=text, numbers=numbers)
        return Finding(
            code=code,
            title=title,
            verdict="warn",
            evidence=f"{measured}: in {unit}, not m/s^2; the reader converts it",
            remedy=f"multiply by {_ACCEL_UNITS[unit]:.6g} in the driver: other programs will take it for m/s^2",
            numbers=numbers,
        )
    if unit:
        known = f"set input.accel_unit to '{unit}', or " if unit in ("g", "m/s^2") else ""
        text = f"{measured}: in {unit}, but it is taken for {imu.accel_unit}"
        remedy = f"{known}multiply by {_ACCEL_UNITS[unit]:.6g} in the driver"
    elif size < _MIN_FORCE:
        text = f"{measured}: gravity is missing"
        remedy = "record the raw specific force: the driver publishes the acceleration with gravity taken out"
    else:
        text = f"{measured}, near gravity in no unit"
        remedy = "look up the sensor's counts per g and convert in the driver to m/s^2"
    return Finding(code=code, title=title, verdict="fail", evidence=text, remedy=remedy, numbers=numbers)


def check_gyro_unit(evidence: Evidence) -> Finding:
    """Compare the gyroscope's turns with the LiDAR's; without a LiDAR tell what the reader concluded."""
    code, title, imu = "gyro-unit", "gyroscope unit", evidence.imu
    found = fit_turns(evidence.turns) if evidence.turns is not None else None
    if found is None or found.scale <= 0.0 or found.scale_sigma > _MAX_SCALE_SIGMA * found.scale:
        why = evidence.why or "the LiDAR sees too little turning to measure it"
        if imu.gyro_unit == "rad/s":
            return Finding(code=code, title=title, verdict="unknown", evidence=f"taken for rad/s; {why}")
        return _conversion_finding(
            code, title, f"taken for {imu.gyro_unit} by its numbers alone ({why})", imu.gyro_unit, ()
        )
    scale, sigma = evidence.gyro_scale * found.scale, evidence.gyro_scale * found.scale_sigma
    raw = scale / imu.gyro_factor
    numbers = (
        Number(name="scale error", value=scale - 1.0, limit=evidence.config.max_gyro_scale),
        Number(name="scale as recorded", value=raw),
    )
    measured = f"as recorded it turns {raw:#.4g} times as fast as the LiDAR"
    unit = _recognise_unit(1.0 / raw, _GYRO_UNITS)
    if unit == imu.gyro_unit:
        off = scale - 1.0
        if abs(off) > max(evidence.config.max_gyro_scale, 5.0 * sigma):
            text = f"{measured}, {100 * off:+.1f} % off {unit}"
            remedy = "check the gyroscope's range setting against the driver's scale factor"
            return Finding(code=code, title=title, verdict="warn", evidence=text, remedy=remedy, numbers=numbers)
        if unit == "rad/s":
            text = f"{measured} (+- {sigma:.2g})"
            return Finding(code=code, title=title, verdict="ok", evidence=text, numbers=numbers)
        return _conversion_finding(code, title, f"{measured}: in {unit}", unit, numbers)
    if unit:
        known = f"set input.gyro_unit to '{unit}', or " if unit in ("rad/s", "deg/s") else ""
        text = f"{measured}: in {unit}, but it is taken for {imu.gyro_unit}"
        remedy = f"{known}multiply by {_GYRO_UNITS[unit]:.6g} in the driver"
    else:
        text = f"{measured}, which is no known unit"
        remedy = "check the gyroscope's range setting against the driver's scale factor"
    return Finding(code=code, title=title, verdict="fail", evidence=text, remedy=remedy, numbers=numbers)


def _conversion_finding(code: str, title: str, measured: str, unit: str, numbers: tuple[Number, ...]) -> Finding:
    return Finding(
        code=code,
        title=title,
        verdict="warn",
        evidence=f"{measured}, not rad/s; the reader converts it",
        remedy=f"multiply by {_GYRO_UNITS.get(unit, 1.0):.6g} in the driver: other programs will take it for rad/s",
        numbers=numbers,
    )


def _recognise_unit(factor: float, units: dict[str, float]) -> str:
    """Return the unit whose factor to SI is nearest, empty where none is near."""
    if not np.isfinite(factor) or factor <= 0.0:
        return ""
    unit = min(units, key=lambda name: abs(np.log(units[name] / factor)))
    return unit if abs(np.log(units[unit] / factor)) < _UNIT_TOLERANCE else ""


def _mean_force(evidence: Evidence) -> float:
    """Return the median length of the mean force over the quietest stretches [m/s^2]."""
    batch = evidence.batch
    size = max(1, min(len(batch), round(_WINDOW_S / max(period_s(batch), 1e-6))))
    begins = np.arange(0, len(batch) - size + 1, max(1, size // 3))
    # Hann's window lets a gait's unfinished step count for nothing.
    window = np.hanning(size + 2)[1:-1]
    pieces = batch.accel[begins[:, None] + np.arange(size)]
    means = np.einsum("k,nkc->nc", window / window.sum(), pieces)
    shaking: NDArray[np.float64] = pieces.std(axis=1).sum(axis=1)
    quiet = np.argsort(shaking, kind="stable")[: max(1, round(_QUIET_SHARE * len(begins)))]
    return float(np.median(np.linalg.norm(means[quiet], axis=1)))
