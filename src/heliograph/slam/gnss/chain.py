"""The small graph that fixes are judged in: keyframes along the odometry, loops, fixes, and where the map lies."""

from __future__ import annotations

import copy
from dataclasses import dataclass

import numpy as np

from heliograph.arrays import Array, freeze
from heliograph.factors import AnchoredPosition
from heliograph.graph import (
    Between,
    Covariance,
    Diagonal,
    FactorGraph,
    Isotropic,
    Marginals,
    Prior,
    SolverSettings,
    Symbol,
    Values,
    solve,
)
from heliograph.lie import SE3, se3
from heliograph.slam.gnss.evidence import FixEvidence, Placement

__all__ = ["ChainSolution", "FixChain"]

X, E, L = Symbol("X"), Symbol("E"), Symbol("L")
_LEAST = 1e-9  # weight of a fix that does not count: the graph keeps its shape
_LOOSE = np.array([3.0, 1e4])  # sigmas of a heading and of an origin that nothing is known of [rad], [m]
_SETTINGS = SolverSettings(max_iterations=4, relative_decrease=1e-4)


@dataclass(frozen=True, slots=True, kw_only=True)
class ChainSolution:
    """The chain, solved.

    Parameters
    ----------
    T_map_imu : (K, 4, 4) float64
    T_map_enu : (4, 4) float64
    arm : (3,) float64
        [m].
    residual : (M, 3) float64
        Estimated antenna less fix, east-north-up [m].
    squared : (M,) float64
        The same, whitened and squared.
    cost : float
        Sum of squares, as weighted.
    """

    T_map_imu: Array
    T_map_enu: Array
    arm: Array
    residual: Array
    squared: Array
    cost: float

    def __post_init__(self) -> None:
        freeze(self)


class FixChain:
    """Solves the chain for given weights of the fixes.

    Parameters
    ----------
    evidence : FixEvidence
    placement : Placement
    odometry_scale : float
        What the odometry's sigmas are multiplied with.
    """

    def __init__(self, evidence: FixEvidence, placement: Placement, *, odometry_scale: float) -> None:
        self._evidence, self._placement, self._scale = evidence, placement, odometry_scale
        self._covariance = evidence.covariance
        self._arm = evidence.arm  # what the body has turned since a keyframe is linear in the arm only near it
        self._T_start = np.eye(4)

    @property
    def covered(self) -> Array:
        """1 for each fix that the odometry knows the place of, (M,)."""
        return self._placement.covered.astype(np.float64)

    def moved(self, placement: Placement) -> FixChain:
        """Return the same chain with the fixes at other places along it."""
        other = copy.copy(self)
        other._placement = placement
        return other

    def weighed(self, covariance: Array) -> FixChain:
        """Return the same chain with other covariances (M, 3, 3) of the fixes."""
        other = copy.copy(self)
        other._covariance = covariance
        return other

    def about(self, arm: Array) -> FixChain:
        """Return the same chain, with the antenna's way since the keyframes as an arm (3,) has it."""
        other = copy.copy(self)
        other._arm = arm
        return other

    def start(self, T_map_enu: Array) -> ChainSolution:
        """Return the odometry as it is, with a first guess of where the map lies."""
        self._T_start = T_map_enu
        return self._solution(self._evidence.T_odom_imu, T_map_enu, self._evidence.arm, 0.0)

    def solve(self, start: ChainSolution, weights: Array) -> ChainSolution:
        """Solve from a start, with weights (M,) of the fixes."""
        values = self._values(start)
        found = solve(self._graph(weights), values, "lm", initial="given", settings=_SETTINGS)
        keys = X(np.arange(len(self._evidence.T_odom_imu)))
        arm = np.asarray(found.values.at(L(0))) if self._evidence.arm_sigma else self._evidence.arm
        T_map_imu, T_map_enu = found.values.at(keys).matrix, found.values.at(E(0)).matrix
        return self._solution(T_map_imu, T_map_enu, arm, found.cost)

    def marginals(self, solution: ChainSolution, weights: Array) -> tuple[Array, Array]:
        """Return the covariance of ``T_map_enu`` (6, 6) and the sigmas of the lever arm (3,)."""
        marginals = Marginals(self._graph(weights), self._values(solution))
        arm = np.zeros(3)
        if self._evidence.arm_sigma:
            arm = np.sqrt(np.diag(marginals.covariance(L(0))))
        return marginals.covariance(E(0)), arm

    def _values(self, start: ChainSolution) -> Values:
        values = Values()
        values.insert(X(np.arange(len(start.T_map_imu))), SE3(start.T_map_imu))
        values.insert(E(0), SE3(start.T_map_enu))
        if self._evidence.arm_sigma:
            values.insert(L(0), start.arm)
        return values

    def _graph(self, weights: Array) -> FactorGraph:
        evidence, placement, graph = self._evidence, self._placement, FactorGraph()
        k = np.arange(len(evidence.T_odom_imu))
        graph.fix(X(0))
        if len(k) > 1:
            steps = se3.inverse(evidence.T_odom_imu[:-1]) @ evidence.T_odom_imu[1:]
            noise = Covariance(self._scale**2 * evidence.step_covariances[1:])
            graph.add(Between(X(k[:-1]), X(k[1:]), SE3(np.ascontiguousarray(steps)), noise))
        for i, j, T, P in evidence.loops:
            graph.add(Between(X(i), X(j), SE3(T), Covariance(P)))
        tilt = min(evidence.level_sigma, float(_LOOSE[0]))
        graph.add(Prior(E(0), SE3(self._T_start), Diagonal(np.array([tilt, tilt, *_LOOSE[[0, 1, 1, 1]]]))))
        P = self._covariance / np.maximum(weights, _LEAST)[:, None, None]
        offset = placement.points(self._arm)
        if evidence.arm_sigma:
            offset = offset - self._arm  # what the body has turned since the keyframe; the arm itself is a variable
            graph.add(Prior(L(0), evidence.arm, Isotropic(evidence.arm_sigma)))
        keys, arm = X(placement.keyframe), L(0) if evidence.arm_sigma else None
        graph.add(AnchoredPosition(keys, E(0), evidence.p_enu, Covariance(P), offset=offset, arm_key=arm))
        return graph

    def _solution(self, T_map_imu: Array, T_map_enu: Array, arm: Array, cost: float) -> ChainSolution:
        placement, evidence = self._placement, self._evidence
        T = T_map_imu[placement.keyframe]
        local = placement.points(self._arm) + (arm - self._arm)
        point = np.einsum("nij,nj->ni", T[:, :3, :3], local) + T[:, :3, 3]
        residual = (point - T_map_enu[:3, 3]) @ T_map_enu[:3, :3] - evidence.p_enu
        squared = np.einsum("ni,ni->n", residual, np.linalg.solve(self._covariance, residual[..., None])[..., 0])
        return ChainSolution(
            T_map_imu=T_map_imu, T_map_enu=T_map_enu, arm=arm, residual=residual, squared=squared, cost=cost
        )
