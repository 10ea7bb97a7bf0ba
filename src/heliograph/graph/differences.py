"""Derivatives of batched residuals by central differences, all perturbations of all instances in one call."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from heliograph.graph.families import Family
from heliograph.lie import S2, s2

__all__ = ["central_differences"]

Array = NDArray[np.float64]

# The cube root of the rounding error balances rounding against truncation.
_STEP = float(np.cbrt(np.finfo(np.float64).eps))


def central_differences(
    residual: Callable[..., Array], families: Sequence[Family], arrays: Sequence[Array], data: Sequence[Array]
) -> tuple[Array, list[Array]]:
    """Return residuals (N, rows) and one Jacobian (N, rows, dof) a variable, by right perturbation.

    Parameters
    ----------
    residual : callable
        Takes the stacks of the variables, then those of the data, and returns (M, rows); called once with
        M = N (1 + 2 sum of dof).
    families : sequence of Family
        Of each variable.
    arrays : sequence of (N, *shape) float64
        Values of the variables.
    data : sequence of (N, ...) float64
        Repeated as they are.
    """
    count = len(arrays[0])
    copies = 1 + 2 * sum(family.dof for family in families)
    stacks = [_repeat(array, copies) for array in (*arrays, *data)]
    steps, first = [], 1
    for family, array, stack in zip(families, arrays, stacks, strict=False):
        steps.append(_perturb(family, array, stack[first : first + 2 * family.dof]))
        first += 2 * family.dof
    found = residual(*[stack.reshape(copies * count, *stack.shape[2:]) for stack in stacks])
    found = found.reshape(copies, count, -1)
    jacobians, first = [], 1
    for family, step in zip(families, steps, strict=True):
        ahead, behind = found[first : first + family.dof], found[first + family.dof : first + 2 * family.dof]
        slopes = (ahead - behind) / (2.0 * step[:, :, None])
        jacobians.append(np.ascontiguousarray(np.moveaxis(slopes, 0, 2)))
        first += 2 * family.dof
    return np.ascontiguousarray(found[0]), jacobians


def _repeat(array: Array, copies: int) -> Array:
    stack = np.empty((copies, *array.shape))
    stack[:] = array
    return stack


def _length_step(size: Array) -> Array:
    """Return the step (N,) for numbers of a size: rounding grows with the size, so its cube root balances again."""
    return np.asarray(_STEP * np.cbrt(np.maximum(1.0, size)))


def _perturb(family: Family, array: Array, stack: Array) -> Array:
    """Perturb the copies (2 dof, N, *shape) in place, first all steps ahead, then all behind; return steps (dof, N)."""
    dof, count = family.dof, len(array)
    if family.lie is S2:
        for k in range(2 * dof):
            delta = np.zeros((count, dof))
            delta[:, k % dof] = _STEP if k < dof else -_STEP
            stack[k] = s2.retract(array, delta)
        return np.full((dof, count), _STEP)
    if family.lie is None:
        step = _length_step(np.abs(array).max(axis=1))
        for k in range(dof):
            stack[k, :, k] += step
            stack[dof + k, :, k] -= step
        return np.broadcast_to(step, (dof, count))
    turns = family.lie.turns
    size = 2 if turns == 1 else 3  # of the rotation matrix
    steps = np.full((dof, count), _STEP)
    for k in range(turns):
        _turn(array, stack[k], stack[dof + k], k, size)
    for k in range(turns, dof):
        column, axis = size + (k - turns) // size, (k - turns) % size
        steps[k] = _length_step(np.abs(array[:, :size, column]).max(axis=1))
        shift = steps[k][:, None] * array[:, :size, axis]
        stack[k][:, :size, column] += shift
        stack[dof + k][:, :size, column] -= shift
    return steps


def _turn(array: Array, ahead: Array, behind: Array, axis: int, size: int) -> None:
    """Turn the leading rotations by plus and minus the step about a body axis: two of their columns mix."""
    i, j = (0, 1) if size == 2 else ((axis + 1) % 3, (axis + 2) % 3)
    cosine, sine = np.cos(_STEP), np.sin(_STEP)
    along, across = cosine * array[:, :size, i], sine * array[:, :size, j]
    ahead[:, :size, i], behind[:, :size, i] = along + across, along - across
    along, across = cosine * array[:, :size, j], sine * array[:, :size, i]
    ahead[:, :size, j], behind[:, :size, j] = along - across, along + across
