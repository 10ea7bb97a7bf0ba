"""What is said of a keyframe when it comes, for runs with an IMU: poses, velocities and biases in one graph.

The IMU speaks between keyframes, preintegrated; the LiDAR speaks through the odometry's step, but along a direction
that it did not see its word is empty: there the IMU carries the graph by itself (eq. (2) of docs/theory/slam.md).
"""

from __future__ import annotations

import math

import numpy as np

from heliograph.arrays import Array
from heliograph.config import ImuConfig, SlamConfig
from heliograph.data import ImuNoise, Keyframe
from heliograph.factors import CombinedImu
from heliograph.graph import Between, Covariance, Diagonal, FactorGraph, PartialPrior, Prior, Symbol, Values
from heliograph.imu import preintegrate
from heliograph.lie import SE3, ExtendedPose, se3

__all__ = ["VELOCITY_ROWS", "InertialFactors", "scan_covariance", "seen_covariance"]

X, B = Symbol("X"), Symbol("B")

_HELD = 1e-6  # sigma of what defines the frame: heading [rad] and position [m]
_UNSEEN, _UNSEEN_TURN = 100.0, 3.0  # sigmas of a pose in a direction that a scan does not see [m], [rad]
_SEEN, _SEEN_TURN = 0.005, math.radians(0.05)  # half of what the IMU knows of a second's motion by itself [m], [rad]
_KEPT = 0.01  # of a step's slack, as a variance: the factor of the step has it, the gates have all of it
_SPEED = 3.0  # sigma of a velocity that nothing measures [m/s]
VELOCITY_ROWS = (6, 7, 8)


class InertialFactors:
    """A chain of extended poses and biases in a frame that gravity defines: its z axis points up.

    Parameters
    ----------
    config : SlamConfig
    imu : ImuConfig
        Noise and biases of the IMU, and the length of gravity.
    """

    def __init__(self, config: SlamConfig, imu: ImuConfig) -> None:
        self._config, self._imu = config, imu
        self._noise = ImuNoise(
            gyro=imu.gyro_noise, accel=imu.accel_noise, gyro_walk=imu.gyro_walk, accel_walk=imu.accel_walk
        )
        self._gravity = np.array([0.0, 0.0, -imu.gravity])

    @property
    def bias_covariance(self) -> Array:
        """Covariance (6, 6) of the biases that a run begins with."""
        return np.asarray(np.diag(np.repeat([self._imu.gyro_bias_sigma, self._imu.accel_bias_sigma], 3) ** 2))

    def first(self, keyframe: Keyframe) -> tuple[FactorGraph, Values]:
        """Return what the first keyframe brings: where and which way it is by definition, its level as far as known."""
        graph, values = FactorGraph(), Values()
        key, bias = X(keyframe.index), B(keyframe.index)
        tilt = math.radians(self._config.level_sigma_deg)
        R = keyframe.T_odom_imu[:3, :3]
        covariance = np.diag([0.0] * 3 + [_HELD**2] * 3)
        covariance[:3, :3] = R.T @ np.diag([tilt**2, tilt**2, _HELD**2]) @ R
        graph.add(Prior(key, SE3(keyframe.T_odom_imu), Covariance(covariance)))
        state, biases = _state(keyframe.T_odom_imu, keyframe.v_odom), _biases(keyframe)
        graph.add(PartialPrior(key, state, VELOCITY_ROWS, Diagonal(np.full(3, _SPEED))))
        graph.add(Prior(bias, biases, self._bias_noise()))
        values.insert(key, state)
        values.insert(bias, biases)
        return graph, values

    def step(self, before: Keyframe, keyframe: Keyframe, T_map_before: Array) -> tuple[FactorGraph, Values]:
        """Return the factors of the step from the keyframe before, and where its variables start.

        Parameters
        ----------
        before, keyframe : Keyframe
        T_map_before : (4, 4) float64
            Pose of the keyframe before as the graph has it.
        """
        graph, values = FactorGraph(), Values()
        i, j, bias_i, bias_j = X(before.index), X(keyframe.index), B(before.index), B(keyframe.index)
        step = np.ascontiguousarray(se3.inverse(before.T_odom_imu) @ keyframe.T_odom_imu)
        T_map_odom = T_map_before @ se3.inverse(before.T_odom_imu)
        state = _state(T_map_before @ step, T_map_odom[:3, :3] @ keyframe.v_odom)
        graph.add(Between(i, j, SE3(step), Covariance(self._step_covariance(before, keyframe))))
        if len(keyframe.imu):
            motion = preintegrate(
                keyframe.imu, before.stamp_ns, keyframe.stamp_ns, noise=self._noise, config=self._imu,
                gyro_bias=before.gyro_bias, accel_bias=before.accel_bias,
            )  # fmt: skip
            graph.add(CombinedImu(i, bias_i, j, bias_j, motion, gravity=self._gravity, keep_samples=False))
        else:
            graph.add(PartialPrior(j, state, VELOCITY_ROWS, Diagonal(np.full(3, _SPEED))))
            if _begins(keyframe):  # another session: perhaps the sensor was off, perhaps it is another one
                graph.add(Prior(bias_j, _biases(keyframe), self._bias_noise()))
            else:
                walk = self._walk((keyframe.stamp_ns - before.stamp_ns) * 1e-9)
                graph.add(Between(bias_i, bias_j, np.zeros(6), walk))
        values.insert(j, state)
        values.insert(bias_j, _biases(keyframe))
        return graph, values

    def _step_covariance(self, before: Keyframe, keyframe: Keyframe) -> Array:
        """Return the covariance of the factor of a step, (6, 6): eq. (2) without what does not add up over steps."""
        c = self._config
        slack = np.repeat([math.radians(c.step_rotation_sigma_deg), c.step_position_sigma], 3)
        values, vectors = np.linalg.eigh(keyframe.step_covariance / slack[:, None] / slack)
        own = (vectors * np.maximum(values - 1.0 + _KEPT, _KEPT)) @ vectors.T
        covariance = slack[:, None] * own * slack + _unseen(keyframe.lidar_information)
        if before.index == 0 and not before.lidar_information.any():
            return np.asarray(covariance)
        carry = se3.adjoint(se3.inverse(keyframe.T_odom_imu) @ before.T_odom_imu)
        return np.asarray(covariance + carry @ _unseen(before.lidar_information) @ carry.T)

    def _bias_noise(self) -> Diagonal:
        return Diagonal(np.repeat([self._imu.gyro_bias_sigma, self._imu.accel_bias_sigma], 3))

    def _walk(self, seconds: float) -> Diagonal:
        walks = np.repeat([max(self._imu.gyro_walk, 1e-9), max(self._imu.accel_walk, 1e-9)], 3)
        return Diagonal(walks * math.sqrt(seconds))


def _begins(keyframe: Keyframe) -> bool:
    """Whether nothing is known of the step to a keyframe: another session begins with it."""
    return float(np.sqrt(np.trace(keyframe.step_covariance[3:, 3:]))) >= _UNSEEN


def seen_covariance(before: Keyframe, keyframe: Keyframe) -> Array:
    """Return the covariance of the odometry's step as the LiDAR alone vouches for it, (6, 6).

    To what the step may have drifted comes what each of the two scans left open against the map. In a direction that
    one of them did not see the step is as good as free: what the odometry knew there it had from the IMU, whose own
    factor must not be counted again. The first scan was matched with nothing: it is the map, and leaves nothing open.
    """
    covariance = keyframe.step_covariance + _left_open(keyframe.lidar_information)
    if before.index == 0 and not before.lidar_information.any():
        return np.asarray(covariance)
    carry = se3.adjoint(se3.inverse(keyframe.T_odom_imu) @ before.T_odom_imu)
    return np.asarray(covariance + carry @ _left_open(before.lidar_information) @ carry.T)


def _unseen(information: Array) -> Array:
    """Return by how much a scan leaves its pose more open than `_SEEN`; what it sees better is not the IMU's to tell.

    The error of a scan that sees is in the steps to it and from it with opposite signs, and does not add up; along a
    direction that it does not see the IMU must carry the graph.
    """
    scale = np.array([_SEEN_TURN] * 3 + [_SEEN] * 3)
    values, vectors = np.linalg.eigh(_left_open(information) / scale[:, None] / scale)
    return np.asarray(scale[:, None] * ((vectors * np.maximum(values - 1.0, 0.0)) @ vectors.T) * scale)


def scan_covariance(information: Array) -> Array:
    """Return how far a pose may be off for its own scan's noise, (6, 6): what `_unseen` leaves out; 0 where unknown."""
    return _left_open(information) - _unseen(information) if information.any() else np.zeros((6, 6))


def _left_open(information: Array) -> Array:
    """Invert an information matrix; what it does not hold is unknown by `_UNSEEN`."""
    scale = np.array([_UNSEEN_TURN] * 3 + [_UNSEEN] * 3)
    values, vectors = np.linalg.eigh(scale[:, None] * information * scale)
    covariance = (vectors / (1.0 + np.maximum(values, 0.0))) @ vectors.T
    return np.asarray(scale[:, None] * covariance * scale)


def _state(T: Array, v: Array) -> ExtendedPose:
    return ExtendedPose.from_rotation_position_velocity(T[:3, :3], T[:3, 3], v)


def _biases(keyframe: Keyframe) -> Array:
    return np.concatenate([keyframe.gyro_bias, keyframe.accel_bias])
