"""Derivatives of batched residuals by central differences, all perturbations of all instances in one call."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from heliograph.arrays import Array
from heliograph.graph.model.families import Family
from heliograph.lie import S2, s2

__all__ = ["MAX_ROWS", "central_differences", "keep_memory"]


# The cube root of the rounding error balances rounding against truncation.
_STEP = float(np.cbrt(np.finfo(np.float64).eps))

# Instances times perturbations in one call; more are split, so that a million factors fit into memory.
MAX_ROWS = 1 << 18


def keep_memory() -> None:
    """Let the C library keep what temporary arrays return.

    It gives memory back to the system above a limit that grows with the largest block freed so far, and fetching the
    pages again costs several times the arithmetic on them. One large block, freed untouched, raises the limit.
    """
    np.empty(4_000_000)


def central_differences(
    residual: Callable[..., Array], families: Sequence[Family], arrays: Sequence[Array], data: Sequence[Array]
) -> tuple[Array, list[Array]]:
    """Return residuals (N, rows) and one Jacobian (N, rows, dof) a variable, by right perturbation.

    Parameters
    ----------
    residual : callable
        Takes the stacks of the variables, then those of the data, and returns (M, rows); called once with
        M = N (1 + 2 sum of dof), or, where that is over `MAX_ROWS`, for as many instances at a time as it allows.
    families : sequence of Family
        The family of each variable.
    arrays : sequence of (N, *shape) float64
        Values of the variables.
    data : sequence of (N, ...) float64
        Repeated as they are.
    """
    count = len(arrays[0])
    copies = 1 + 2 * sum(family.dof for family in families)
    max_count = max(1, MAX_ROWS // copies)
    parts = [
        _differences(
            residual,
            families,
            [a[first : first + max_count] for a in arrays],
            [d[first : first + max_count] for d in data],
        )
        for first in range(0, max(count, 1), max_count)
    ]
    if len(parts) == 1:
        return parts[0]
    jacobians = [np.concatenate(of_variable) for of_variable in zip(*[part[1] for part in parts], strict=True)]
    return np.concatenate([part[0] for part in parts]), jacobians


def _differences(
    residual: Callable[..., Array], families: Sequence[Family], arrays: Sequence[Array], data: Sequence[Array]
) -> tuple[Array, list[Array]]:
    count = len(arrays[0])
    copies = 1 + 2 * sum(family.dof for family in families)
    stacks = [_repeat(array, copies) for array in (*arrays, *data)]
    steps: list[list[Array | float]] = []
    first = 1
    for family, array, stack in zip(families, arrays, stacks, strict=False):
        steps.append(_perturb(family, array, stack[first : first + 2 * family.dof]))
        first += 2 * family.dof
    found = residual(*[stack.reshape(copies * count, *stack.shape[2:]) for stack in stacks])
    found = np.ascontiguousarray(found).reshape(copies, -1)  # one perturbation of all instances a row
    rows = found.shape[1] // count if count else 0
    jacobians, first = [], 1
    for family, of_variable in zip(families, steps, strict=True):
        J = np.empty((found.shape[1], family.dof))
        for k, step in enumerate(of_variable):
            np.subtract(found[first + k], found[first + family.dof + k], out=J[:, k])
            J[:, k] *= np.repeat(0.5 / step, rows) if isinstance(step, np.ndarray) else 0.5 / step
        jacobians.append(J.reshape(count, rows, family.dof))
        first += 2 * family.dof
    return found[0].reshape(count, rows).copy(), jacobians


def _repeat(array: Array, copies: int) -> Array:
    stack = np.empty((copies, *array.shape))
    stack[:] = array
    return stack


def _length_step(columns: Sequence[Array]) -> Array:
    """Return the step (N,) for numbers given in columns: rounding grows with them, so its cube root balances again."""
    size = np.ones(len(columns[0]))
    for column in columns:
        np.maximum(size, np.abs(column), out=size)
    return np.asarray(_STEP * np.cbrt(size))


def _perturb(family: Family, array: Array, stack: Array) -> list[Array | float]:
    """Perturb the copies (2 dof, N, *shape) in place, first all steps ahead, then all behind; return the dof steps.

    Work goes column by column: loops over short axes would cost more than the arithmetic.
    """
    dof = family.dof
    if family.lie is S2:
        for k in range(2 * dof):
            delta = np.zeros((len(array), dof))
            delta[:, k % dof] = _STEP if k < dof else -_STEP
            stack[k] = s2.retract(array, delta)
        return [_STEP] * dof
    if family.lie is None:
        step = _length_step([array[:, k] for k in range(dof)])
        for k in range(dof):
            stack[k, :, k] += step
            stack[dof + k, :, k] -= step
        return [step] * dof
    turns = family.lie.turns
    size = 2 if turns == 1 else 3  # of the rotation matrix
    steps: list[Array | float] = [_STEP] * turns
    for k in range(turns):
        _turn(array, stack[k], stack[dof + k], k, size)
    for column in range(size, family.shape[1]):
        step = _length_step([array[:, row, column] for row in range(size)])
        for axis in range(size):
            k = len(steps)
            for row in range(size):
                shift = step * array[:, row, axis]
                stack[k, :, row, column] += shift
                stack[dof + k, :, row, column] -= shift
            steps.append(step)
    return steps


def _turn(array: Array, ahead: Array, behind: Array, axis: int, size: int) -> None:
    """Turn the leading rotations by plus and minus the step about a body axis: two of their columns mix."""
    i, j = (0, 1) if size == 2 else ((axis + 1) % 3, (axis + 2) % 3)
    cosine, sine = np.cos(_STEP), np.sin(_STEP)
    for row in range(size):
        first, second = array[:, row, i], array[:, row, j]
        along, across = cosine * first, sine * second
        np.add(along, across, out=ahead[:, row, i])
        np.subtract(along, across, out=behind[:, row, i])
        along, across = cosine * second, sine * first
        np.subtract(along, across, out=ahead[:, row, j])
        np.add(along, across, out=behind[:, row, j])
