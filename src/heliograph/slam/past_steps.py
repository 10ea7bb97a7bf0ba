"""Steps that have left the window of inertial smoothing: what IMU and LiDAR said of each together, as a step of poses.

A keyframe with velocity, biases and a preintegrated factor takes several times the memory of a pose with a step, and an
hour later nobody asks for its velocity. Its step is then summarised. A second smoother of two keyframes goes along the
run, forwards only and without loops: it marginalises the one that it has left, so it carries exactly what the past said
of level, velocity and biases. The step between its two is what stays, as uncertain as the two leave it, and at least by
what the covariance of the pose has grown, eq. (4) of docs/theory/slam.md: growths add up to what is known, also where
errors of neighbouring steps are correlated through a velocity or a bias, as in a tunnel. No measurement is used twice:
what is carried knows the past alone. Lost, to the safe side, is which way was up at a pose of long ago.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from heliograph.arrays import Array
from heliograph.data import Keyframe
from heliograph.factors import SENSOR_FACTORS
from heliograph.graph import ISAM2, Between, Covariance, PartialPrior, Prior, Symbol
from heliograph.lie import SE3, ExtendedPose, se3
from heliograph.slam.growing_rows import GrowingRows
from heliograph.slam.inertial_factors import VELOCITY_ROWS, InertialFactors
from heliograph.snapshots import PART, Snapshot, Stateful, array, require

__all__ = ["PastSteps"]

X, B = Symbol("X"), Symbol("B")
_LEAST = np.repeat([1e-6, 1e-5], 3)  # sigmas of a step that adds nothing: a factor needs some [rad], [m]
_POSES = np.r_[0:6, 9:15]  # of two states of nine errors
_LEAST_SPEED = 0.05  # sigma of a carried velocity: the map may have turned since [m/s]
_CONVERGED = 1e-6  # a step is taken in when no element of the solution moves by more [rad], [m]


class PastSteps(Stateful):
    """Summaries of a run's first steps, and velocity and biases at the keyframe behind the last of them.

    Parameters
    ----------
    factors : InertialFactors
        What is said of the steps.
    """

    _STATE: ClassVar = {
        "_steps": PART,
        "_covariances": PART,
        "_poses": PART,
        "_speeds": PART,
        "_speed_covariances": PART,
        "_biases": array(np.float64, 6),
        "_bias_covariance": array(np.float64, 6, 6),
    }

    def __init__(self, factors: InertialFactors) -> None:
        self._factors = factors
        self._chain = ISAM2()
        self._steps, self._covariances = GrowingRows(4, 4), GrowingRows(6, 6)
        self._poses, self._speeds, self._speed_covariances = GrowingRows(4, 4), GrowingRows(3), GrowingRows(3, 3)
        self._biases, self._bias_covariance = np.zeros(6), factors.bias_covariance

    def snapshot(self) -> Snapshot:
        """Return the summaries and what is carried."""
        return {**super().snapshot(), "chain": self._chain.snapshot()}

    def restore(self, snapshot: Snapshot) -> None:
        """Take up the state of another one; `DataError` where it is none."""
        kinds = {**self._STATE, "chain": {str: (str, {str: np.ndarray})}}
        require(self, snapshot, kinds)
        super().restore({name: value for name, value in snapshot.items() if name != "chain"})
        self._chain = ISAM2.restored(snapshot["chain"], factors=SENSOR_FACTORS)

    def __len__(self) -> int:
        return len(self._steps.all)

    def step(self, index: int) -> Between:
        """Return what is said of the step from a keyframe to the next: a factor of their poses."""
        T, covariance = self._steps.all[index], self._covariances.all[index]
        return Between(X(index), X(index + 1), SE3(np.ascontiguousarray(T)), Covariance(covariance))

    def take(self, before: Keyframe, keyframe: Keyframe) -> None:
        """Summarise the next step, and carry level, velocity and biases over it."""
        if before.index == 0:
            self._chain.update(*self._factors.first(before))
        i, j = X(before.index), X(keyframe.index)
        P_before = np.asarray(self._chain.covariance(i)[:6, :6])
        start = np.ascontiguousarray(self._chain.estimate(i).matrix[:4, :4])
        self._chain.update(*self._factors.step(before, keyframe, start), iterate=_CONVERGED)
        T_before, T_after = (np.ascontiguousarray(self._chain.estimate(key).matrix[:4, :4]) for key in (i, j))
        joint = self._chain.joint([int(i), int(j)])[np.ix_(_POSES, _POSES)]
        carry = se3.adjoint(se3.inverse(T_after) @ T_before)
        apart = np.hstack([-carry, np.eye(6)])
        self._steps.append(se3.inverse(T_before) @ T_after)
        grown = joint[6:, 6:] - carry @ P_before @ carry.T
        self._covariances.append(_at_least(apart @ joint @ apart.T + np.diag(_LEAST**2), grown))
        self._chain.marginalize([int(i), int(B(before.index))])

    def reach(self, T_map_imu: Array) -> tuple[PartialPrior, Prior]:
        """Return what the past says of velocity and biases at the keyframe behind the last step, the first time.

        Parameters
        ----------
        T_map_imu : (4, 4) float64
            Its pose in the map.
        """
        key, biases = X(len(self)), B(len(self))
        state = self._chain.estimate(key)
        # The chain's own frame is odom, but for what level and heading it has found.
        v_body = np.asarray(state.rotation).reshape(3, 3).T @ np.asarray(state.velocity).reshape(3)
        self._poses.append(T_map_imu)
        self._speeds.append(T_map_imu[:3, :3] @ v_body)
        self._speed_covariances.append(self._chain.covariance(key)[6:9, 6:9] + _LEAST_SPEED**2 * np.eye(3))
        self._biases = np.array(self._chain.estimate(biases))
        self._bias_covariance = np.array(self._chain.covariance(biases))
        return self.speed(len(self) - 1), self.biases()

    def speed(self, index: int) -> PartialPrior:
        """Return what was said of the velocity behind a step: along the body's axes of then."""
        state = _state(self._poses.all[index], self._speeds.all[index])
        return PartialPrior(X(index + 1), state, VELOCITY_ROWS, Covariance(self._speed_covariances.all[index]))

    def biases(self) -> Prior:
        """Return what is said of the biases at the keyframe behind the last step."""
        return Prior(B(len(self)), self._biases, Covariance(self._bias_covariance))


def _at_least(covariance: Array, other: Array) -> Array:
    """Return a covariance, raised in the directions in which another matrix is larger."""
    root = np.linalg.cholesky(0.5 * (covariance + covariance.T))
    whitened = np.linalg.solve(root, np.linalg.solve(root, 0.5 * (other + other.T)).T)
    values, vectors = np.linalg.eigh(0.5 * (whitened + whitened.T))
    mixed = root @ vectors
    return np.asarray((mixed * np.maximum(values, 1.0)) @ mixed.T)


def _state(T: Array, v: Array) -> ExtendedPose:
    return ExtendedPose.from_rotation_position_velocity(T[:3, :3], T[:3, 3], v)
