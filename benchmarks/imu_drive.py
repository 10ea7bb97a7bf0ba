"""The drive of `imu_gnss`: KITTI sequence 00 with its IMU, fixes with drawn noise, and truth; and its smoothing.

The recording has eight gaps of 1.6 s that whoever converted it filled with straight lines, in the IMU's samples, the
fixes and the truth alike. They are found in the samples (`drop_filled`); fixes inside them are not used.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from heliograph.arrays import Array
from heliograph.config import ImuConfig
from heliograph.data import ImuBatch, ImuNoise
from heliograph.factors import CombinedImu, LeverArmPosition
from heliograph.graph import ISAM2, Diagonal, FactorGraph, Prior, Solution, Values, solve
from heliograph.imu import Preintegration, drop_filled, preintegrate, start_from_positions
from heliograph.lie import ExtendedPose

__all__ = [
    "BIAS",
    "BIAS_SIGMA",
    "CONFIG",
    "FIX_SIGMA",
    "GRAVITY",
    "NOISE",
    "START_SIGMA",
    "Drive",
    "Task",
    "rmse",
    "smooth",
    "smooth_online",
]


# From imu_metadata.txt beside the recording; no other explains the noisy fixes better (`imu_likelihood`).
NOISE = ImuNoise(gyro=1.75e-4, accel=1e-2, gyro_walk=2.91e-6, accel_walk=1.67e-4)
# A car does not coast in a gap: the samples at its ends are held. The noise of held samples is that of the greatest
# likelihood of the noisy fixes (`imu_likelihood` tries 20 pairs), one pair for the whole drive.
CONFIG = ImuConfig(hold=2.5, curvature=0.0, held_gyro_noise=0.05, held_accel_noise=0.5)
FIX_SIGMA = np.array([1.0, 1.0, 2.0])
BIAS = 10**6  # keys of biases follow those of poses by so much
BIAS_SIGMA = np.array([0.05] * 3 + [0.5] * 3)
START_SIGMA = np.array([0.3, 0.3, 1.0] + [10.0] * 6)
GRAVITY = np.array([0.0, 0.0, -9.81])

# How truth and fixes relate, from the README of the recordings: time of truth, antenna in the camera frame, scale.
_TRUTH_TIME, _ANTENNA, _SCALE = 46534.94, np.array([-0.334, 0.025, -1.099]), 1.0019
_START_FIXES = 12


@dataclass(frozen=True, slots=True, kw_only=True)
class Drive:
    """Times from the start of the truth; the world is that of the fixes.

    Parameters
    ----------
    imu : ImuBatch
        Without filled samples.
    stamps_ns : (N,) int64
        Of the fixes [ns].
    fixes : (N, 3) float64
        As recorded, without noise [m].
    measured : (N,) bool
        Not inside a filled gap.
    truth : (N, 3) float64
        Antenna positions in the truth's own frame and scale, NaN where there is none [m].
    """

    imu: ImuBatch
    stamps_ns: NDArray[np.int64]
    fixes: Array
    measured: NDArray[np.bool_]
    truth: Array

    @classmethod
    def read(cls, folder: Path) -> Drive:
        """Read the recording; its first row is a stub before a gap."""
        rows = np.loadtxt(folder / "imu.txt", skiprows=1)[1:]
        gps = np.loadtxt(folder / "gps.txt", skiprows=1, delimiter=",")[1:]
        poses = np.loadtxt(folder / "groundtruth_kitti.txt").reshape(-1, 3, 4)
        times = np.loadtxt(folder / "groundtruth_times.txt")
        imu, gaps = drop_filled(
            ImuBatch(
                stamps_ns=_stamps(rows[:, 0]),
                gyro=np.ascontiguousarray(rows[:, 5:8]),
                accel=np.ascontiguousarray(rows[:, 2:5]),
                received_ns=0,
            )
        )
        stamps = _stamps(gps[:, 0])
        inside = ((stamps[:, None] > gaps[:, 0]) & (stamps[:, None] < gaps[:, 1])).any(axis=1)
        antenna = CubicSpline(times, poses[:, :, 3] + poses[:, :, :3] @ _ANTENNA)(1e-9 * stamps)
        covered = (1e-9 * stamps >= times[0]) & (1e-9 * stamps <= times[-1])
        antenna[~covered] = np.nan
        return cls(imu=imu, stamps_ns=stamps, fixes=gps[:, 1:], measured=~inside, truth=antenna)

    def noisy(self, seed: int) -> Array:
        """Return the fixes with white noise."""
        return self.fixes + FIX_SIGMA * np.random.default_rng(seed).normal(size=self.fixes.shape)

    def shifted(self, offset_s: float) -> Drive:
        """Return the drive with the IMU's stamps earlier by so much."""
        imu = replace(self.imu, stamps_ns=self.imu.stamps_ns - round(1e9 * offset_s))
        return replace(self, imu=imu)

    def aligned(self, positions: Array) -> tuple[Array, Array]:
        """Return truth (N, 3) rigidly aligned with positions in the world of the fixes, and where there is one."""
        there = np.isfinite(self.truth[:, 0])
        ours, truth = positions[there], self.truth[there] / _SCALE
        middle, middle_truth = ours.mean(axis=0), truth.mean(axis=0)
        U, _, Vt = np.linalg.svd((ours - middle).T @ (truth - middle_truth))
        R = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
        return (self.truth / _SCALE - middle_truth) @ R.T + middle, there


def _stamps(seconds: Array) -> NDArray[np.int64]:
    return np.round(1e9 * (seconds - _TRUTH_TIME)).astype(np.int64)


def rmse(drive: Drive, positions: Array) -> float:
    """Return the root mean square error of positions (N, 3) after rigid alignment, in the truth's scale [m]."""
    truth, there = drive.aligned(positions)
    return float(_SCALE * np.sqrt(((positions - truth)[there] ** 2).sum(axis=1).mean()))


@dataclass(frozen=True, slots=True, kw_only=True)
class Task:
    """What is to be smoothed: motions between fixes, the fixes used, and where all starts.

    Parameters
    ----------
    motion : Preintegration
        From each fix to the next.
    fixes : (N, 3) float64
        With noise [m].
    used : (N,) bool
        Which of them.
    start : ExtendedPose
        Of N states: from the first seconds the first, and from it attitudes by the gyroscope; positions of the fixes.
    """

    motion: Preintegration
    fixes: Array
    used: NDArray[np.bool_]
    start: ExtendedPose

    @classmethod
    def of(cls, drive: Drive, fixes: Array, last: int | None = None, used: NDArray[np.bool_] | None = None) -> Task:
        """Make the task of the first fixes, with those used that were measured, or fewer."""
        stamps, fixes = drive.stamps_ns[:last], fixes[:last]
        few = slice(0, _START_FIXES)
        found = start_from_positions(
            drive.imu, stamps[few], fixes[few], sigma=1.0, noise=NOISE, config=CONFIG, g_world=GRAVITY
        )
        motion = preintegrate(drive.imu, stamps[:-1], stamps[1:], noise=NOISE, config=CONFIG)
        R = [found.X_world_imu.rotation]
        for turn in motion.delta_R:
            R.append(R[-1] @ turn)
        v = np.gradient(fixes, 1e-9 * stamps, axis=0)
        v[0] = found.X_world_imu.velocity
        start = ExtendedPose.from_rotation_position_velocity(np.stack(R), fixes, v)
        measured = drive.measured[:last]
        return cls(motion=motion, fixes=fixes, used=measured if used is None else measured & used[:last], start=start)

    def piece(self, first: int, last: int) -> FactorGraph:
        """Return the factors that come with the states from first to last, the motion to the first included."""
        graph = FactorGraph()
        to = np.arange(max(first, 1), last + 1)
        if len(to):
            motion = self.motion[to[0] - 1 : to[-1]]
            graph.add(CombinedImu(to - 1, BIAS + to - 1, to, BIAS + to, motion, gravity=GRAVITY))
        fixed = np.arange(first, last + 1)[self.used[first : last + 1]]
        if len(fixed):
            graph.add(LeverArmPosition(fixed, self.fixes[fixed], Diagonal(FIX_SIGMA), lever_arm=np.zeros(3)))
        if first == 0:
            graph.add(Prior(BIAS, np.zeros(6), Diagonal(BIAS_SIGMA)))
            graph.add(Prior(0, self.start[0], Diagonal(START_SIGMA)))
        return graph


def smooth(task: Task) -> tuple[FactorGraph, Solution]:
    """Smooth in one batch."""
    keys, graph, values = np.arange(len(task.fixes)), task.piece(0, len(task.fixes) - 1), Values()
    values.insert(keys, task.start)
    values.insert(BIAS + keys, np.zeros((len(keys), 6)))
    return graph, solve(graph, values)


def smooth_online(task: Task) -> ISAM2:
    """Smooth with one update a fix, each state predicted from the estimate of the one before it."""
    smoother = ISAM2()
    for k in range(len(task.fixes)):
        values, bias = Values(), np.zeros(6)
        X = task.start[0]
        if k:
            bias = smoother.estimate(BIAS + k - 1)
            X = task.motion[k - 1 : k].predict(smoother.estimate(k - 1), bias[:3], bias[3:], GRAVITY)[0]
        values.insert(k, X)
        values.insert(BIAS + k, bias)
        smoother.update(task.piece(k, k), values)
    return smoother
