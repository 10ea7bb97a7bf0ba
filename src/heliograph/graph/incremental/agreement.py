"""Whether two loops that were let go tell the same story: around the short stretches that join their ends."""

from __future__ import annotations

from types import ModuleType
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import Array
from heliograph.graph.model.families import FAMILIES, Family
from heliograph.graph.model.noise import DIAGONAL, SCALAR
from heliograph.lie import SE2, SE3, ExtendedPose, se2, se3

if TYPE_CHECKING:
    from heliograph.graph.incremental.tree_state import TreeState

__all__ = ["Loop", "loop_of", "squared_disagreement"]


class Loop(NamedTuple):
    """A relative pose between two variables of the tree, the older first.

    Parameters
    ----------
    first, second : int
        Numbers of the variables.
    T_first_second : (k, k) float64
        Measured.
    covariance : (d, d) float64
        That of the residual ``Log(T_first_second^-1 T)``.
    ops : module
        `heliograph.lie.se2` or `se3`.
    """

    first: int
    second: int
    T_first_second: Array
    covariance: Array
    ops: ModuleType


def loop_of(state: TreeState, number: int) -> Loop | None:
    """Return a factor as a relative pose, or None: it is another measurement."""
    scope, measurement, form, roots = state.native.factor_data(number)
    if len(scope) != 2:
        return None
    family = _measured(state.family_of(int(scope[0])))
    if family is None or _measured(state.family_of(int(scope[1]))) != family or len(measurement) != family.storage:
        return None
    ops, d = se2 if family == FAMILIES[SE2] else se3, family.dof
    root = np.eye(d) * roots if form in (SCALAR, DIAGONAL) else np.asarray(roots).reshape(d, d)
    covariance = np.linalg.pinv(root.T @ root, hermitian=True)
    Z = family.elements(np.asarray(measurement)[None])[0]
    i, j = int(scope[0]), int(scope[1])
    if i < j:
        return Loop(i, j, Z, covariance, ops)
    # Log(Z X^-1) = -Ad(Z) Log(Z^-1 X): the residual of a measurement turned round.
    Ad = ops.adjoint(Z)
    return Loop(j, i, ops.inverse(Z), Ad @ covariance @ Ad.T, ops)


def _measured(family: Family) -> Family | None:
    """Return the family of relative poses between variables of a family."""
    if family in (FAMILIES[SE2], FAMILIES[SE3]):
        return family
    return FAMILIES[SE3] if family == FAMILIES[ExtendedPose] else None


def squared_disagreement(state: TreeState, one: Loop, other: Loop) -> float:
    """Return by how much two loops differ, squared, in units of what their noise and the ways between them allow.

    Chi-square distributed, with as many degrees of freedom as a relative pose, where both are true.

    Parameters
    ----------
    state : TreeState
        Poses and covariances of the ends; only those of one end relative to the other count.
    one, other : Loop
        Both of the same space.
    """
    ops = one.ops
    T_there, P_there = _relative(state, one.first, other.first, ops)
    T_back, P_back = _relative(state, other.second, one.second, ops)
    rest = other.T_first_second @ T_back
    r = ops.log(ops.inverse(one.T_first_second) @ T_there @ rest)
    # To first order each part's perturbation arrives at the end through what follows it.
    A, B = ops.adjoint(ops.inverse(rest)), ops.adjoint(ops.inverse(T_back))
    P = one.covariance + A @ P_there @ A.T + B @ other.covariance @ B.T + P_back
    return float(r @ np.linalg.solve(P, r))


def _relative(state: TreeState, i: int, j: int, ops: ModuleType) -> tuple[Array, Array]:
    """Return the relative pose T_i_j of two variables, and the covariance of its right perturbation."""
    d = 3 if ops is se2 else 6
    if i == j:
        return np.eye(d if d == 3 else 4), np.zeros((d, d))
    numbers: NDArray[np.int32] = np.array([i, j], dtype=np.int32)
    T_i, T_j = (_pose(state, number, ops) for number in (i, j))
    T = ops.inverse(T_i) @ T_j
    joint = state.native.joint_covariance(numbers)
    size = int(np.sqrt(joint.size))
    joint = joint.reshape(size, size)
    half = size // 2  # of an extended pose the first six are rotation and position
    kept = np.r_[0:d, half : half + d]
    M = np.concatenate([-ops.adjoint(ops.inverse(T)), np.eye(d)], axis=1)
    return T, M @ joint[np.ix_(kept, kept)] @ M.T


def _pose(state: TreeState, number: int, ops: ModuleType) -> Array:
    """Return the estimate of a variable as a pose of `se2` or `se3`."""
    packed = state.native.estimate(np.array([number], dtype=np.int32))
    value = state.family_of(number).elements(packed.reshape(1, -1))[0]
    return value if ops is se2 else np.asarray(se3.from_rotation_translation(value[:3, :3], value[:3, 3]))
