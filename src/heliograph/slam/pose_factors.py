"""What is said of a keyframe when it comes, for runs without an IMU: poses, and the odometry's steps between them."""

from __future__ import annotations

import numpy as np

from heliograph.arrays import Array
from heliograph.data import Keyframe
from heliograph.graph import Between, Covariance, FactorGraph, Symbol, Values
from heliograph.lie import SE3, se3

__all__ = ["PoseFactors"]

X = Symbol("X")


class PoseFactors:
    """A chain of SE(3) variables; the first is held."""

    def first(self, keyframe: Keyframe) -> tuple[FactorGraph, Values]:
        """Return what the first keyframe brings: a held pose."""
        graph, values = FactorGraph(), Values()
        graph.fix(X(keyframe.index))
        values.insert(X(keyframe.index), SE3(keyframe.T_odom_imu))
        return graph, values

    def step(self, before: Keyframe, keyframe: Keyframe, T_map_before: Array) -> tuple[FactorGraph, Values]:
        """Return the odometry's step from the keyframe before, and where it leads to from that one's pose now."""
        step = se3.inverse(before.T_odom_imu) @ keyframe.T_odom_imu
        graph, values = FactorGraph(), Values()
        noise = Covariance(keyframe.step_covariance)
        graph.add(Between(X(before.index), X(keyframe.index), SE3(np.ascontiguousarray(step)), noise))
        values.insert(X(keyframe.index), SE3(np.ascontiguousarray(T_map_before @ step)))
        return graph, values
