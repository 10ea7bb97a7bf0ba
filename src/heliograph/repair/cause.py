"""What most likely makes an IMU contradict the LiDAR where nothing could be mended: named, so that a user can act."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import Array
from heliograph.checks.agreement import check_clock_offset
from heliograph.checks.arrangement import accel_arrangement, gyro_arrangement, is_mirrored
from heliograph.checks.axes import check_accel_axes, check_gyro_axes, check_mounting
from heliograph.checks.evidence import Evidence, gather
from heliograph.checks.lever import check_lever_arm
from heliograph.checks.records import CheckedMotion, ImuRecord
from heliograph.checks.units import check_accel_unit, check_gyro_unit
from heliograph.data import Trajectory

__all__ = ["clock_step", "likely_cause"]

_MIRRORED = (
    "the cloud is a mirror image: gyroscope and accelerometer agree with its reflection and with nothing else - look "
    "at the LiDAR driver's axes, which must be right-handed; one of them has the wrong sign, or two are swapped"
)
_SMALL_DEG = 1.5  # of a mounting that is off, where it is off by five of its sigmas at least
_WINDOW_S = 3.0  # over which an offset of the clocks is taken for constant [s]
_MIN_WINDOWS = 3
_MARGIN_NS = 600_000_000  # of samples around a window [ns]
_OFFSET_NOISE = 5e-4  # of one window's offset, at least [s]
_SIGMAS = 5.0  # of a change that is no chance
_CORRELATION, _REACH = 0.97, 0.45  # of one window's offset that counts: least, and farthest from the whole's [s]
_LEAST_CHANGE, _LEAST_STEP = 0.004, 0.04  # of the offset over all windows, and of one that is a step [s]


def likely_cause(evidence: Evidence) -> str:
    """Return cause and remedy in one sentence; empty where no check tells.

    Parameters
    ----------
    evidence : Evidence
        From the samples as recorded, against a motion that the LiDAR alone saw.
    """
    # What only warns elsewhere is a cause where a contradiction is there to be explained.
    evidence = replace(evidence, config=replace(evidence.config, warn_mounting_deg=_SMALL_DEG))
    checks = (check_accel_unit, check_gyro_unit, check_gyro_axes, check_accel_axes, check_mounting, check_lever_arm)
    findings = [check(evidence) for check in checks]
    told = [_MIRRORED] if is_mirrored(gyro_arrangement(evidence), accel_arrangement(evidence)) else []
    told += [f"{f.evidence} - {f.remedy}" for f in findings if f.verdict == "fail"]
    told += [sentence] if (sentence := clock_step(evidence) or _clock_drift(evidence)) else []
    told += [
        f"{f.evidence} - {f.remedy}"
        for f in findings
        if f.verdict == "warn" and f.code in ("gyro-unit", "mounting", "lever-arm")
    ]
    late = check_clock_offset(evidence)
    told += [f"{late.evidence} - {late.remedy}"] if late.verdict in ("warn", "fail") else []
    return f"the IMU contradicts the LiDAR: {told[0]}" if told else ""


def clock_step(evidence: Evidence) -> str:
    """Return when and by how much one clock was set against the other, with what helps; empty where none was.

    Parameters
    ----------
    evidence : Evidence
        As for `likely_cause`.
    """
    at, offsets, sigmas = _offsets(evidence)
    if len(at) < _MIN_WINDOWS:
        return ""
    _, line_misfit, _ = _fitted(_line(at), offsets, sigmas)
    steps = [
        (*_fitted(np.stack([np.ones(len(at)), (np.arange(len(at)) >= k).astype(float)], axis=1), offsets, sigmas), k)
        for k in range(1, len(at))
    ]
    step, misfit, sigma, k = min(steps, key=lambda found: found[1])
    if abs(step[1]) <= max(_LEAST_STEP, _SIGMAS * sigma) or misfit >= line_misfit:
        return ""
    return (
        f"the clock between LiDAR and IMU steps by {step[1]:+.3f} s about {at[k]:.0f} s after the start - keep NTP "
        "and PTP from stepping a sensor's clock while recording"
    )


def _clock_drift(evidence: Evidence) -> str:
    """Return how the offset between the clocks grows; empty where it does not."""
    at, offsets, sigmas = _offsets(evidence)
    if len(at) < _MIN_WINDOWS:
        return ""
    line, _, sigma = _fitted(_line(at), offsets, sigmas)
    if abs(line[1] * (at[-1] - at[0])) <= _LEAST_CHANGE or abs(line[1]) <= _SIGMAS * sigma:
        return ""
    return (
        f"the IMU's clock runs away from the LiDAR's by {1e3 * line[1]:+.2f} ms a second (+- {1e3 * sigma:.2f}) - "
        "stamp both by one clock; `heliograph calibrate` measures offset and drift"
    )


def _line(at: Array) -> Array:
    return np.stack([np.ones(len(at)), at - at.mean()], axis=1)


def _offsets(evidence: Evidence) -> tuple[Array, Array, Array]:
    """Return middle [s], offset [s] and its sigma [s] of each window whose motion tells it."""
    motion = evidence.motion
    if motion is None:
        return np.zeros(0), np.zeros(0), np.zeros(0)
    stamps = motion.trajectory.stamps_ns
    constant = evidence.offset
    lag_ns = round(1e9 * constant.seconds) if constant is not None and constant.determined else 0
    seconds = (stamps - stamps[0]) * 1e-9
    found = []
    for begin in np.arange(0.0, min(float(seconds[-1]), 100.0), _WINDOW_S):
        inside = np.flatnonzero((seconds >= begin) & (seconds < begin + _WINDOW_S))
        if len(inside) < 2:
            continue
        # The samples around it alone: of all of them only the longest stretch without a step would be compared.
        imu = _around(evidence.imu, int(stamps[inside[0]]) + lag_ns, int(stamps[inside[-1]]) + lag_ns)
        offset = gather(imu, _part(motion, inside), config=evidence.config).offset
        if offset is None or not offset.determined or not np.isfinite(offset.sigma):
            continue
        # A gait fits itself a step later as well, but not so well; and farther off lies nothing to be believed.
        if offset.correlation >= _CORRELATION and abs(1e9 * offset.seconds - lag_ns) < 1e9 * _REACH:
            found.append((begin + 0.5 * _WINDOW_S, offset.seconds, max(offset.sigma, _OFFSET_NOISE)))
    at, offsets, sigmas = np.array(found).reshape(-1, 3).T
    return at, offsets, sigmas


def _around(imu: ImuRecord, begin_ns: int, end_ns: int) -> ImuRecord:
    inside = (imu.stamps_ns >= begin_ns - _MARGIN_NS) & (imu.stamps_ns <= end_ns + _MARGIN_NS)
    return replace(
        imu,
        stamps_ns=imu.stamps_ns[inside],
        received_ns=imu.received_ns[inside],
        gyro=imu.gyro[inside],
        accel=imu.accel[inside],
    )


def _part(motion: CheckedMotion, inside: NDArray[np.intp]) -> CheckedMotion:
    whole = motion.trajectory
    part = Trajectory(
        stamps_ns=whole.stamps_ns[inside], T_frame_body=whole.T_frame_body[inside], body=whole.body, frame=whole.frame
    )
    return replace(motion, trajectory=part, tracked=motion.tracked[inside])


def _fitted(A: Array, values: Array, sigmas: Array) -> tuple[Array, float, float]:
    """Return the coefficients, the sum of squared residuals in sigmas, and one sigma of the second coefficient."""
    B, b = A / sigmas[:, None], values / sigmas
    information = B.T @ B
    x = np.linalg.solve(information, B.T @ b)
    misfit = float(np.sum((b - B @ x) ** 2))
    # What the model leaves counts as noise as well.
    spread = max(1.0, misfit / max(len(b) - 2, 1))
    return x, misfit, float(np.sqrt(spread * np.linalg.inv(information)[1, 1]))
