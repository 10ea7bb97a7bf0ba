"""Whether the accelerometer sits where the mounting says: its lever arm shows in every turn."""

from __future__ import annotations

import numpy as np

from heliograph.arrays import Array
from heliograph.checks.arrangement import accel_arrangement, mounting_of
from heliograph.checks.evidence import FORCE_SPAN, Evidence
from heliograph.checks.records import Finding, Number
from heliograph.checks.windows import Forces, lever_arm

__all__ = ["check_lever_arm", "lever_arm_shift"]

_SIGMAS = 6.0  # of a shift that is no chance; the LiDAR's errors are not white
_TOLD = 0.1  # one-sigma up to which an axis counts as told [m]
_BIAS = 0.5  # one-sigma of an accelerometer's bias [m/s^2]
_FORCE_SIGMA = 0.05  # the least that two sensors differ over one window [m/s^2]


def check_lever_arm(evidence: Evidence) -> Finding:
    """Compare the mounting's lever arm with the one that the accelerations show."""
    code, title = "lever-arm", "lever arm"
    motion, found = evidence.motion, accel_arrangement(evidence)
    if motion is None or not motion.rig.known:
        why = evidence.why or "nothing tells the mounting"
        return Finding(code=code, title=title, verdict="unknown", evidence=why)
    if found is None or not found.as_expected:
        return Finding(code=code, title=title, verdict="unknown", evidence="the accelerometer's axes come first")
    shown = lever_arm_shift(evidence)
    if shown is None:
        return Finding(code=code, title=title, verdict="unknown", evidence="the sensor turns too little to tell it")
    shift, sigma = shown
    size, config = float(np.linalg.norm(shift)), evidence.config
    numbers = (Number(name="off by", value=size, unit="m", limit=config.warn_lever_arm),)
    if size < max(config.warn_lever_arm, _SIGMAS * sigma):
        text = f"{motion.rig.source} agrees to {size:.2f} m (+- {sigma:.2f}) along the axes that the turns show"
        return Finding(code=code, title=title, verdict="ok", evidence=text, numbers=numbers)
    p = ", ".join(f"{value:+.2f}" for value in shift)
    return Finding(
        code=code,
        title=title,
        verdict="fail" if size > config.max_lever_arm else "warn",
        evidence=(
            f"{motion.rig.source} is off by {size:.2f} m (+- {sigma:.2f}): by its accelerations the IMU sits ({p}) m "
            "beside where that puts it, along the lidar's axes"
        ),
        remedy="measure the lever arm anew: `heliograph calibrate`, then --extrinsic FILE",
        numbers=numbers,
    )


def lever_arm_shift(evidence: Evidence) -> tuple[Array, float] | None:
    """Return by how much the IMU sits beside its place, in the lidar frame, and the largest sigma of what is told [m].

    Least squares over ``f - a(p) = g + R_odom_imu b + R'' d``, with gravity free, the accelerometer's bias b as good as
    any IMU's, and the shift d of the lever arm p, which the second difference R'' of the LiDAR's attitude carries into
    acceleration. A direction of d that the turns do not tell is left at zero; None where they tell none.
    """
    forces, turns, motion = evidence.forces, evidence.turns, evidence.motion
    if forces is None or turns is None or motion is None:
        return None
    R_imu_lidar = mounting_of(motion.rig, turns)
    if R_imu_lidar is None:
        return None
    measured = np.einsum("nabc,cb->na", forces.specific, R_imu_lidar)
    rest = (measured - forces.imu_acceleration(lever_arm(motion))).reshape(-1)
    A = _regressors(forces, motion.trajectory.T_frame_body[forces.first + FORCE_SPAN, :3, :3] @ R_imu_lidar.T)
    prior = np.diag([0.0, 0.0, 0.0, *[1.0 / _BIAS**2] * 3, 0.0, 0.0, 0.0])
    weight = 1.0 / (forces.overlap * _FORCE_SIGMA**2)
    for _ in range(2):  # the second time with the noise that the first one left
        N = weight * A.T @ A + prior
        x = np.linalg.lstsq(N, weight * A.T @ rest, rcond=None)[0]
        left = float(np.sqrt(np.mean((rest - A @ x) ** 2)))
        weight = 1.0 / (forces.overlap * max(left, _FORCE_SIGMA) ** 2)
    # What is known of the shift once the rest is left open: the Schur complement.
    N = weight * A.T @ A + prior
    S = N[6:, 6:] - N[6:, :6] @ np.linalg.lstsq(N[:6, :6], N[:6, 6:], rcond=None)[0]
    values, vectors = np.linalg.eigh(0.5 * (S + S.T))
    told = values > 1.0 / _TOLD**2
    if not np.any(told):
        return None
    gradient = weight * A.T @ rest
    reduced = gradient[6:] - N[6:, :6] @ np.linalg.lstsq(N[:6, :6], gradient[:6], rcond=None)[0]
    shift = vectors[:, told] @ ((vectors[:, told].T @ reduced) / values[told])
    return shift, float(1.0 / np.sqrt(values[told].min()))


def _regressors(forces: Forces, R_odom_imu: Array) -> Array:
    """Return the derivative of the windows' specific forces by gravity, bias and shift, (3 N, 9)."""
    gravity = np.tile(np.eye(3), (len(forces.lidar), 1))
    return np.concatenate([gravity, R_odom_imu.reshape(-1, 3), forces.R_odom_lidar.reshape(-1, 3)], axis=1)
