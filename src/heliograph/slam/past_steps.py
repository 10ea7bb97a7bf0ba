"""Steps that have left the window of inertial smoothing: what IMU and LiDAR said of each together, as a step of poses.

A keyframe with velocity, biases and a preintegrated factor takes several times the memory of a pose with a step, and an
hour later nobody asks for its velocity. Its step is then summarised: velocity and biases are carried along from the
beginning, forwards only, by each step's own factors (a filter on two keyframes), and what those say of the step between
the two poses stays. So a step that the LiDAR saw is the LiDAR's, and one through a tunnel is what the IMU made of it.

What is lost, to the safe side: that errors of neighbouring steps are correlated through a bias, and which way is up at
a pose of long ago. No measurement is used twice: the carried state knows the past alone.
"""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np

from heliograph.arrays import Array
from heliograph.config import RunConfig
from heliograph.data import Keyframe
from heliograph.graph import (
    Between,
    Covariance,
    FactorGraph,
    Marginals,
    PartialPrior,
    Prior,
    SolverSettings,
    Symbol,
    Values,
    solve,
)
from heliograph.lie import SE3, ExtendedPose, se3
from heliograph.slam.growing_rows import GrowingRows
from heliograph.slam.inertial_factors import VELOCITY_ROWS, InertialFactors
from heliograph.snapshots import PART, Stateful, array

__all__ = ["PastSteps"]

X, B = Symbol("X"), Symbol("B")
_HELD = 1e-6  # sigma of where two keyframes begin: heading [rad] and position [m]
_LEAST_SPEED = 0.05  # sigma of a carried velocity: the map may have turned since [m/s]
_SETTINGS = SolverSettings(max_iterations=4, relative_decrease=1e-6)


class PastSteps(Stateful):
    """Summaries of a run's first steps, and velocity and biases at the keyframe behind the last of them.

    Parameters
    ----------
    config : RunConfig
    factors : InertialFactors
        What is said of the steps.
    """

    _STATE: ClassVar = {
        "_steps": PART,
        "_covariances": PART,
        "_poses": PART,
        "_speeds": PART,
        "_speed_covariances": PART,
        "_v_odom": (array(np.float64, 3), None),
        "_v_covariance": array(np.float64, 3, 3),
        "_biases": array(np.float64, 6),
        "_bias_covariance": array(np.float64, 6, 6),
    }

    def __init__(self, config: RunConfig, factors: InertialFactors) -> None:
        self._factors = factors
        self._tilt = math.radians(config.slam.level_sigma_deg)
        self._steps, self._covariances = GrowingRows(4, 4), GrowingRows(6, 6)
        self._poses, self._speeds, self._speed_covariances = GrowingRows(4, 4), GrowingRows(3), GrowingRows(3, 3)
        self._v_odom: Array | None = None
        self._v_covariance, self._bias_covariance = factors.speed_covariance, factors.bias_covariance
        self._biases: Array = np.zeros(6)

    def __len__(self) -> int:
        return len(self._steps.all)

    def step(self, index: int) -> Between:
        """Return what is said of the step from a keyframe to the next: a factor of their poses."""
        T, covariance = self._steps.all[index], self._covariances.all[index]
        return Between(X(index), X(index + 1), SE3(np.ascontiguousarray(T)), Covariance(covariance))

    def take(self, before: Keyframe, keyframe: Keyframe) -> None:
        """Summarise the next step, and carry velocity and biases over it."""
        if self._v_odom is None:
            self._v_odom, self._biases = before.v_odom, np.concatenate([before.gyro_bias, before.accel_bias])
        graph, values = FactorGraph(), Values()
        first = _state(before.T_odom_imu, self._v_odom)
        R = before.T_odom_imu[:3, :3]
        held = np.diag([0.0] * 3 + [_HELD**2] * 3)
        held[:3, :3] = R.T @ np.diag([self._tilt**2, self._tilt**2, _HELD**2]) @ R
        graph.add(Prior(X(before.index), SE3(before.T_odom_imu), Covariance(held)))
        graph.add(PartialPrior(X(before.index), first, VELOCITY_ROWS, Covariance(self._v_covariance)))
        graph.add(Prior(B(before.index), self._biases, Covariance(self._bias_covariance)))
        values.insert(X(before.index), first)
        values.insert(B(before.index), self._biases)
        said, start = self._factors.step(before, keyframe, before.T_odom_imu)
        for added in said.groups():
            graph.adopt(added)
        for key in start.keys().tolist():
            values.insert(key, start.at(key))
        found = solve(graph, values, "lm", initial="given", settings=_SETTINGS).values
        self._keep(before.index, keyframe, found, Marginals(graph, found))

    def reach(self, T_odom_imu: Array, T_map_imu: Array) -> tuple[PartialPrior, Prior]:
        """Return what the past says of velocity and biases at the keyframe behind the last step, the first time.

        Parameters
        ----------
        T_odom_imu, T_map_imu : (4, 4) float64
            Its poses.
        """
        assert self._v_odom is not None
        v_map = T_map_imu[:3, :3] @ T_odom_imu[:3, :3].T @ self._v_odom
        self._poses.append(T_map_imu)
        self._speeds.append(v_map)
        self._speed_covariances.append(self._v_covariance + _LEAST_SPEED**2 * np.eye(3))
        return self.speed(len(self) - 1), self.biases()

    def speed(self, index: int) -> PartialPrior:
        """Return what was said of the velocity behind a step: along the body's axes of then."""
        state = _state(self._poses.all[index], self._speeds.all[index])
        return PartialPrior(X(index + 1), state, VELOCITY_ROWS, Covariance(self._speed_covariances.all[index]))

    def biases(self) -> Prior:
        """Return what is said of the biases at the keyframe behind the last step."""
        return Prior(B(len(self)), self._biases, Covariance(self._bias_covariance))

    def _keep(self, i: int, keyframe: Keyframe, found: Values, marginals: Marginals) -> None:
        T_0, T_1 = (np.asarray(found.at(X(k)).matrix)[:4, :4] for k in (i, keyframe.index))
        step = np.ascontiguousarray(se3.inverse(T_0) @ T_1)
        joint = marginals.joint(np.array([X(i), X(keyframe.index)]))
        to_step = np.hstack([-se3.adjoint(se3.inverse(step)), np.eye(6)])
        poses = np.r_[0:6, 9:15]
        covariance = to_step @ joint[np.ix_(poses, poses)] @ to_step.T
        self._steps.append(step)
        self._covariances.append(0.5 * (covariance + covariance.T))
        state = found.at(X(keyframe.index))
        self._v_odom = np.asarray(state.velocity, dtype=np.float64).reshape(3)
        self._v_covariance = np.asarray(joint[15:18, 15:18])
        self._biases = np.asarray(found.at(B(keyframe.index)), dtype=np.float64).reshape(6)
        self._bias_covariance = np.asarray(marginals.covariance(B(keyframe.index)))


def _state(T: Array, v: Array) -> ExtendedPose:
    return ExtendedPose.from_rotation_position_velocity(T[:3, :3], T[:3, 3], v)
