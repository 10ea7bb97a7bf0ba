"""A short chain of poses tied by inertial intervals: residuals, their derivatives, and the elimination that solves it.

The unknowns are a pose and a velocity at each instant and nine numbers that all share: both biases, the direction of
gravity and the logarithm of the accelerometer's scale. Equation numbers are those of docs/theory/initialisation.md.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from heliograph.arrays import Array, freeze
from heliograph.data.error_layout import POSE, POSITION, ROTATION, VELOCITY
from heliograph.imu.preintegration import Preintegration
from heliograph.lie import s2, so3

__all__ = ["LOG_SCALE", "NODE", "SHARED", "Chain", "ChainStep", "relax"]


NODE, SHARED = 9, 9
"""Rotation, position, velocity of an instant; gyro bias, accelerometer bias, gravity direction, log scale of all.

The first instant's and the shared unknowns together stand as in the error state's layout, with the log scale last.
"""

LOG_SCALE = NODE + SHARED - 1


@dataclass(frozen=True, slots=True, kw_only=True)
class Chain:
    """The unknowns of N + 1 instants.

    Parameters
    ----------
    R : (N + 1, 3, 3) float64
        R_odom_imu.
    p, v : (N + 1, 3) float64
        Position [m] and velocity [m/s], odom.
    gyro_bias, accel_bias : (3,) float64
        [rad/s], [m/s^2].
    g : (3,) float64
        Gravity, odom [m/s^2].
    log_scale : float
        Natural logarithm of what the accelerometer shows for each m/s^2.
    """

    R: Array
    p: Array
    v: Array
    gyro_bias: Array
    accel_bias: Array
    g: Array
    log_scale: float = 0.0

    def __post_init__(self) -> None:
        freeze(self)

    def moved(self, nodes: Array, shared: Array) -> Chain:
        """Return the chain after a step of ``nodes`` (N + 1, 9) and ``shared`` (9,)."""
        magnitude = float(np.linalg.norm(self.g))
        return Chain(
            R=self.R @ so3.exp(nodes[:, ROTATION]),
            p=self.p + nodes[:, POSITION],
            v=self.v + nodes[:, VELOCITY],
            gyro_bias=self.gyro_bias + shared[0:3],
            accel_bias=self.accel_bias + shared[3:6],
            g=magnitude * s2.retract(self.g / magnitude, shared[6:8]),
            log_scale=self.log_scale + float(shared[8]),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class ChainStep:
    """The step that solves the linearised chain, and what is then known.

    Parameters
    ----------
    nodes : (N + 1, 9) float64
    shared : (9,) float64
        The step.
    covariance : (18, 18) float64
        Covariance of the first instant and the shared unknowns together.
    information : (18, 18) float64
        The same without the prior on the shared unknowns: what the data alone say.
    velocity_covariance : (N + 1, 3, 3) float64
        Covariance of each instant's velocity.
    cost : float
        Sum of the squared, whitened residuals where the chain was linearised.
    """

    nodes: Array
    shared: Array
    covariance: Array
    information: Array
    velocity_covariance: Array
    cost: float

    def __post_init__(self) -> None:
        freeze(self)

    @property
    def largest(self) -> float:
        """Largest entry of the step."""
        return float(max(np.abs(self.nodes).max(), np.abs(self.shared).max()))


def relax(
    chain: Chain, deltas: Preintegration, measured: tuple[Array, Array, Array], prior: tuple[Array, Array]
) -> ChainStep:
    """Return the Gauss-Newton step of the chain, eq. (8) to (11), with covariances.

    Parameters
    ----------
    chain : Chain
        Where to linearise.
    deltas : Deltas
        Preintegrated with the chain's biases.
    measured : (N + 1, 3, 3), (N + 1, 3), (N + 1, 6, 6) float64
        Rotations, positions and the information of each; zero where an instant has no measured pose.
    prior : (9,), (9,) float64
        Deviation of the shared unknowns from their prior mean, and its information (a diagonal).
    """
    H_pair, b_pair, cost = _interval_equations(chain, deltas)
    H_pose, b_pose, pose_cost = _pose_equations(chain, measured)
    off, weight = prior
    cost += pose_cost + float(np.sum(weight * off**2))
    # Elimination runs from the last instant to the first, so what remains is what a filter begins with.
    H = np.zeros((NODE + SHARED, NODE + SHARED))
    b = np.zeros(NODE + SHARED)
    H[POSE, POSE], b[POSE] = H_pose[-1], b_pose[-1]
    eliminated = []
    for k in range(len(H_pair) - 1, -1, -1):
        joint_H, joint_b = H_pair[k].copy(), b_pair[k].copy()
        joint_H[NODE:, NODE:] += H
        joint_b[NODE:] += b
        H, b, back = _without_later(joint_H, joint_b)
        H[POSE, POSE] += H_pose[k]
        b[POSE] += b_pose[k]
        eliminated.append(back)
    information = H.copy()
    H[NODE:, NODE:] += np.diag(weight)
    b[NODE:] += weight * off
    covariance: Array = np.asarray(np.linalg.inv(H), dtype=np.float64)
    first = -covariance @ b
    nodes, velocity_covariance = _back_substituted(first, covariance, eliminated[::-1])
    return ChainStep(
        nodes=nodes,
        shared=first[NODE:],
        covariance=0.5 * (covariance + covariance.T),
        information=0.5 * (information + information.T),
        velocity_covariance=velocity_covariance,
        cost=cost,
    )


def _without_later(H: Array, b: Array) -> tuple[Array, Array, tuple[Array, Array, Array]]:
    """Eliminate the later instant of (earlier, later, shared); also return how to get it back from the rest."""
    later = np.arange(NODE, 2 * NODE)
    rest = np.concatenate([np.arange(NODE), np.arange(2 * NODE, 2 * NODE + SHARED)])
    inverse = np.linalg.inv(H[np.ix_(later, later)])
    inverse = 0.5 * (inverse + inverse.T)
    across = H[np.ix_(later, rest)]
    gain = -inverse @ across
    reduced = H[np.ix_(rest, rest)] + across.T @ gain
    return 0.5 * (reduced + reduced.T), b[rest] + gain.T @ b[later], (gain, -inverse @ b[later], inverse)


def _back_substituted(
    first: Array, covariance: Array, eliminated: list[tuple[Array, Array, Array]]
) -> tuple[Array, Array]:
    """Return the steps of all instants and their velocities' covariances, eq. (11)."""
    known, P = first, covariance
    nodes, velocities = [first[:NODE]], [covariance[VELOCITY, VELOCITY]]
    for gain, offset, own in eliminated:
        node = gain @ known + offset
        across = gain @ P[:, NODE:]
        P_node = own + gain @ P @ gain.T
        known = np.concatenate([node, first[NODE:]])
        P = np.block([[P_node, across], [across.T, covariance[NODE:, NODE:]]])
        nodes.append(node)
        velocities.append(P_node[VELOCITY, VELOCITY])
    return np.stack(nodes), np.stack(velocities)


def _interval_equations(chain: Chain, deltas: Preintegration) -> tuple[Array, Array, float]:
    """Return the normal equations of each interval over (earlier, later, shared), (N, 27, 27) and (N, 27)."""
    to_first = _to_first_frame(deltas.delta_R)
    by_bias = to_first @ deltas.bias_jacobian
    weight = to_first @ np.linalg.inv(deltas.covariance) @ np.swapaxes(to_first, -1, -2)
    residual, J = _interval_residuals(chain, deltas, by_bias)
    weighted = np.swapaxes(J, -1, -2) @ weight
    b = (weighted @ residual[..., None])[..., 0]
    cost = float(np.einsum("ki,kij,kj->", residual, weight, residual))
    return weighted @ J, b, cost


def _to_first_frame(delta_R: Array) -> Array:
    """Return what turns errors of position and velocity from the body frame at the end to that at the start."""
    Q = np.zeros((len(delta_R), 9, 9))
    Q[:, 0:3, 0:3], Q[:, 3:6, 3:6], Q[:, 6:9, 6:9] = np.eye(3), delta_R, delta_R
    return Q


def _interval_residuals(chain: Chain, deltas: Preintegration, by_bias: Array) -> tuple[Array, Array]:
    """Eq. (6) and its derivative by the 27 unknowns of each interval."""
    n, dt = len(deltas), deltas.duration_s[:, None]
    fallen, falling = deltas.gravity_s2[:, None], deltas.gravity_s[:, None]
    R0, R1 = chain.R[:-1], chain.R[1:]
    back = np.swapaxes(R0, -1, -2)
    shrink = float(np.exp(-chain.log_scale))
    E = np.swapaxes(deltas.delta_R, -1, -2) @ back @ R1
    turn = so3.log(E)
    moved = _turned(back, chain.p[1:] - chain.p[:-1] - chain.v[:-1] * dt - chain.g * fallen)
    gained = _turned(back, chain.v[1:] - chain.v[:-1] - chain.g * falling)
    residual = np.concatenate([turn, moved - shrink * deltas.delta_p, gained - shrink * deltas.delta_v], axis=1)
    inverse = so3.right_jacobian_inverse(turn)
    magnitude = float(np.linalg.norm(chain.g))
    tilt = back @ (magnitude * s2.basis(chain.g / magnitude))
    J = np.zeros((n, 9, 2 * NODE + SHARED))
    J[:, 0:3, 0:3] = -inverse @ np.swapaxes(R1, -1, -2) @ R0
    J[:, 3:6, 0:3], J[:, 6:9, 0:3] = so3.hat(moved), so3.hat(gained)
    J[:, 3:6, 3:6], J[:, 3:6, 6:9], J[:, 6:9, 6:9] = -back, -back * dt[..., None], -back
    J[:, 0:3, 9:12], J[:, 3:6, 12:15], J[:, 6:9, 15:18] = inverse, back, back
    J[:, 0:3, 18:21] = -inverse @ np.swapaxes(E, -1, -2) @ by_bias[:, 0:3, 0:3]
    J[:, 3:9, 18:24] = -shrink * by_bias[:, 3:9]
    J[:, 3:6, 24:26] = -fallen[..., None] * tilt
    J[:, 6:9, 24:26] = -falling[..., None] * tilt
    J[:, 3:6, 26], J[:, 6:9, 26] = shrink * deltas.delta_p, shrink * deltas.delta_v
    return residual, J


def _pose_equations(chain: Chain, measured: tuple[Array, Array, Array]) -> tuple[Array, Array, float]:
    """Return the normal equations of the measured poses, eq. (7), (N + 1, 6, 6) and (N + 1, 6)."""
    R, p, weight = measured
    turn = so3.log(np.swapaxes(R, -1, -2) @ chain.R)
    residual = np.concatenate([turn, chain.p - p], axis=1)
    J = np.zeros((len(R), 6, 6))
    J[:, :3, :3] = so3.right_jacobian_inverse(turn)
    J[:, 3:, 3:] = np.eye(3)
    weighted = np.swapaxes(J, -1, -2) @ weight
    b = (weighted @ residual[..., None])[..., 0]
    return weighted @ J, b, float(np.einsum("ki,kij,kj->", residual, weight, residual))


def _turned(R: Array, x: Array) -> Array:
    return np.asarray(np.einsum("kij,kj->ki", R, x))
