"""What the inertial checks read, made from a simulation's truth, and the ways in which recordings spoil it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from heliograph.checks import CheckedMotion, ImuRecord
from heliograph.data import Rig, Trajectory
from heliograph.lie import se3, so3
from heliograph.sim import Scenario, simulate

TURN_NOISE, WAY_NOISE = 1.5e-3, 5e-3  # of the LiDAR's poses, as its odometry alone has them in the room [rad], [m]
Sabotage = Callable[[ImuRecord], ImuRecord]


def made_records(scenario: Scenario, seed: int, *, known: bool = True) -> tuple[ImuRecord, CheckedMotion]:
    """Return the IMU as a recorder gets it and the motion as a LiDAR sees it, without casting a ray."""
    simulation = simulate(scenario, seed)
    stamps, (gyro, accel) = simulation.imu_stamps_ns, simulation.imu()
    imu = ImuRecord(stamps_ns=stamps, received_ns=stamps, gyro=gyro, accel=accel)
    rng = np.random.default_rng(seed)
    period = scenario.lidar.period_ns
    middles = stamps[0] + 13_700_000 + period // 2 + period * np.arange(simulation.sweep_count())
    T = np.stack([simulation.truth.lidar_pose(middles + shift) for shift in (-period // 2, 0, period // 2)])
    # A sweep's pose is the mean over the sweep.
    mean = T[1].copy()
    mean[:, :3, 3] = (T[0, :, :3, 3] + 4.0 * T[1, :, :3, 3] + T[2, :, :3, 3]) / 6.0
    back = np.swapaxes(T[1, :, :3, :3], -1, -2)
    bend = (so3.log(back @ T[0, :, :3, :3]) + so3.log(back @ T[2, :, :3, :3])) / 6.0
    mean[:, :3, :3] = T[1, :, :3, :3] @ so3.exp(bend + TURN_NOISE * rng.standard_normal(bend.shape))
    mean[:, :3, 3] += WAY_NOISE * rng.standard_normal(bend.shape)
    T_odom_lidar = se3.compose(se3.inverse(mean[0]), mean)
    motion = CheckedMotion(
        trajectory=Trajectory(stamps_ns=middles, T_frame_body=T_odom_lidar, body="lidar"),
        tracked=np.ones(len(middles), dtype=bool),
        rig=Rig(T_imu_lidar=simulation.mounting.T_imu_lidar, source="tf_static", known=known),
        sweep=period * 1e-9,
    )
    return imu, motion


def on_gyro(P: np.ndarray) -> Sabotage:
    """Relabel the gyroscope's axes: ``recorded = P @ true``."""
    return lambda imu: replace(imu, gyro=np.ascontiguousarray(imu.gyro @ P.T))


def on_accel(P: np.ndarray) -> Sabotage:
    """Relabel the accelerometer's axes."""
    return lambda imu: replace(imu, accel=np.ascontiguousarray(imu.accel @ P.T))


def matrix(text: str) -> np.ndarray:
    """Return P for the recorded axes in terms of the true ones: ``"-x z y"``."""
    rows = [(name.strip("-"), -1.0 if name.startswith("-") else 1.0) for name in text.split()]
    P = np.zeros((3, 3))
    for i, (axis, sign) in enumerate(rows):
        P[i, "xyz".index(axis)] = sign
    return P


def without(begin_s: float, end_s: float) -> Sabotage:
    """Leave out the samples between two times."""

    def change(imu: ImuRecord) -> ImuRecord:
        at = (imu.received_ns - imu.received_ns[0]) * 1e-9
        return picked(imu, np.flatnonzero((at < begin_s) | (at > end_s)))

    return change


def picked(imu: ImuRecord, index: np.ndarray) -> ImuRecord:
    """Return the samples with these indices, in their order."""
    fields = ("stamps_ns", "received_ns", "gyro", "accel")
    return replace(imu, **{name: np.ascontiguousarray(getattr(imu, name)[index]) for name in fields})


def jumped(at_s: float, by_s: float) -> Sabotage:
    """Step the header stamps; the times of reception go on."""

    def change(imu: ImuRecord) -> ImuRecord:
        late = (imu.received_ns - imu.received_ns[0]) * 1e-9 > at_s
        return replace(imu, stamps_ns=imu.stamps_ns + late * np.int64(by_s * 1e9))

    return change


def shifted(by_s: float) -> Sabotage:
    """Delay all header stamps."""
    return lambda imu: replace(imu, stamps_ns=imu.stamps_ns + np.int64(by_s * 1e9))


def clipped(gyro: float = np.inf, accel: float = np.inf) -> Sabotage:
    """Cut the signals off at a range."""
    return lambda imu: replace(imu, gyro=np.clip(imu.gyro, -gyro, gyro), accel=np.clip(imu.accel, -accel, accel))


def shaken(hertz: float, amplitude: float, axis: int = 2) -> Sabotage:
    """Let the accelerometer vibrate."""

    def change(imu: ImuRecord) -> ImuRecord:
        at = (imu.stamps_ns - imu.stamps_ns[0]) * 1e-9
        accel = imu.accel.copy()
        accel[:, axis] += amplitude * np.sin(2.0 * np.pi * hertz * at)
        return replace(imu, accel=accel)

    return change


def stuck(sensor: str, axis: int) -> Sabotage:
    """Freeze one channel at its first value."""

    def change(imu: ImuRecord) -> ImuRecord:
        values = getattr(imu, sensor).copy()
        values[:, axis] = values[0, axis]
        return replace(imu, **{sensor: values})

    return change
