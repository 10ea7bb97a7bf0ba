"""Motions of variables that no factor resists: candidates judged factor by factor, on the whitened Jacobians."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import Array, Indices
from heliograph.graph.model.noise import DIAGONAL, SCALAR
from heliograph.graph.problem.problem import Problem
from heliograph.graph.problem.resolve import ResolvedGroup

__all__ = ["Sensitivities"]


# A motion is free if every factor's |J v| is below this share of sum |J_c| |v_c|. Weak information, which scales both
# sides alike, is never taken for none.
_NOTHING = 1e-9
_NOTHING_DIFFERENCED = 1e-6  # Jacobians by central differences
_CANDIDATE = 1e-5  # singular values, relative, below which a motion is looked at
_CHUNK = 1 << 16  # factors at a time


class Sensitivities:
    """The whitened Jacobians of a linearised problem, each factor divided by its largest row.

    Parameters
    ----------
    problem : Problem
        Linearised.
    weighted : bool
        Apply the robust weights, so that a rejected factor resists nothing.
    """

    def __init__(self, problem: Problem, *, weighted: bool) -> None:
        self._problem = problem
        self._weighted = weighted
        self._jacobians: dict[int, list[Array]] = {}
        self._starts, self._dofs = problem.tangents(np.arange(len(problem.start), dtype=np.int64))

    def tangent_rows(self, variables: Indices) -> Indices:
        """Return the rows in the flat tangent vector of some variables, one after another."""
        return np.concatenate(
            [np.arange(s, s + d) for s, d in zip(self._starts[variables], self._dofs[variables], strict=True)]
        )

    def _whitened(self, index: int) -> list[Array]:
        if index not in self._jacobians:
            group = self._problem.groups[index]
            jacobians = _white(group, [np.asarray(J) for J in self._problem.native.jacobians(index)])
            size = np.sqrt(sum(np.einsum("nrc,nrc->nr", J, J) for J in jacobians).max(axis=1))
            scale = 1.0 / np.where(size > 0.0, size, 1.0)
            if self._weighted and group.kernel is not None:
                scale *= self._weights(index, group) > 1e-12
            self._jacobians[index] = [J * scale[:, None, None] for J in jacobians]
        return self._jacobians[index]

    def _weights(self, index: int, group: ResolvedGroup) -> Array:
        squared = self._problem.native.residuals(index)[1]
        assert group.kernel is not None
        return np.asarray(group.kernel.weight(np.sqrt(squared)))

    def _pieces(self, member: NDArray[np.bool_], place: Indices, motion: Array) -> Iterator[tuple[Array, Array, float]]:
        """Yield J v (n, rows, m), sum |J_c| |v_c| (n, m) and the tolerance of the factors that touch members."""
        for index, group in enumerate(self._problem.groups):
            touched = member[group.variables]
            rows = np.flatnonzero(touched.any(axis=1))
            custom = group.custom
            tolerance = _NOTHING if custom is None or custom.has_jacobians else _NOTHING_DIFFERENCED
            for begin in range(0, len(rows), _CHUNK):
                chosen = rows[begin : begin + _CHUNK]
                strain = np.zeros((len(chosen), group.rows, motion.shape[1]))
                reach = np.zeros((len(chosen), motion.shape[1]))
                for a, J in enumerate(self._whitened(index)):
                    variables = group.variables[chosen, a]
                    d = J.shape[2]
                    moves = touched[chosen, a][:, None]
                    # All that rest look at row 0: there may be fewer rows than such a variable has degrees of freedom.
                    v = np.where(
                        moves[:, :, None], motion[np.where(moves, place[variables][:, None] + np.arange(d), 0)], 0.0
                    )
                    strain += J[chosen] @ v
                    reach += np.einsum("nc,ncm->nm", np.sqrt(np.einsum("nrc,nrc->nc", J[chosen], J[chosen])), np.abs(v))
                yield strain, reach, tolerance

    def free(self, variables: Indices, motion: Array) -> Array:
        """Return the combinations of motions that nothing resists, as orthonormal motions.

        Parameters
        ----------
        variables : (N,) int64
            That move, ascending; all others rest.
        motion : (T, m) float64
            Their tangents one after another, one motion a column.

        Returns
        -------
        (T, n) float64
            n independent motions.
        """
        member = np.zeros(len(self._starts), dtype=bool)
        member[variables] = True
        place = np.full(len(self._starts), -1, dtype=np.int64)
        place[variables] = np.concatenate([[0], np.cumsum(self._dofs[variables])])[:-1]
        motion = motion[:, np.abs(motion).max(axis=0, initial=0.0) > 0.0]
        if motion.shape[1] == 0:
            return np.asarray(motion)
        motion = motion / np.abs(motion).max(axis=0)
        motion = np.linalg.qr(motion)[0]  # so that small singular values mean little resistance and nothing else
        triangle = np.zeros((0, motion.shape[1]))
        for strain, _, _ in self._pieces(member, place, motion):
            rows = np.concatenate([triangle, strain.reshape(-1, motion.shape[1])])
            triangle = np.asarray(np.linalg.qr(rows, mode="r"), dtype=np.float64)
        _, strengths, mixes = np.linalg.svd(triangle)
        strengths = np.pad(strengths, (0, motion.shape[1] - len(strengths)))
        candidates: Array = motion @ mixes[strengths <= _CANDIDATE * max(1.0, float(strengths[0]))].T
        if candidates.shape[1] == 0:
            return candidates
        return np.asarray(candidates[:, self._accepted(member, place, candidates)])

    def _accepted(self, member: NDArray[np.bool_], place: Indices, candidates: Array) -> NDArray[np.bool_]:
        largest = np.abs(candidates).max(axis=0)
        fine: NDArray[np.bool_] = largest > 0.0
        for strain, reach, tolerance in self._pieces(member, place, candidates):
            size = np.sqrt(np.einsum("nrm,nrm->nm", strain, strain))
            fine &= (size <= tolerance * (reach + 1e-3 * largest)).all(axis=0)
        return fine

    def free_alone(self, variables: Indices, dof: int) -> dict[int, Array]:
        """Return the motions (dof, n) that nothing resists, where there are any, of variables whose neighbours rest.

        All of them have `dof` degrees of freedom. They are judged together, so thousands cost little.
        """
        number = np.full(len(self._starts), -1, dtype=np.int64)
        number[variables] = np.arange(len(variables))
        square = np.zeros((len(variables), dof, dof))
        parts = []
        for index, group in enumerate(self._problem.groups):
            for a in range(group.variables.shape[1]):
                rows = np.flatnonzero(number[group.variables[:, a]] >= 0)
                if len(rows):
                    J, at = self._whitened(index)[a][rows], number[group.variables[rows, a]]
                    np.add.at(square, at, np.einsum("nri,nrj->nij", J, J))
                    differenced = group.custom is not None and not group.custom.has_jacobians
                    parts.append((J, at, _NOTHING_DIFFERENCED if differenced else _NOTHING))
        strengths, directions = np.linalg.eigh(square)
        free = strengths <= 1e-12 * np.maximum(strengths[:, -1:], np.finfo(float).tiny)
        for J, at, tolerance in parts:
            strain = np.linalg.norm(J @ directions[at], axis=1)
            reach = np.einsum("nc,ncm->nm", np.linalg.norm(J, axis=1), np.abs(directions[at]))
            np.logical_and.at(
                free, at, strain <= np.maximum(tolerance * reach, 1e-8 * np.linalg.norm(J, axis=(1, 2))[:, None])
            )
        return {int(variables[k]): directions[k][:, free[k]] for k in np.flatnonzero(free.any(axis=1))}


def _white(group: ResolvedGroup, jacobians: list[Array]) -> list[Array]:
    noise, rows = group.noise, group.rows
    S = noise.sqrt_information
    if noise.form == SCALAR:
        return [J * S.reshape(-1, 1, 1) for J in jacobians]
    if noise.form == DIAGONAL:
        return [J * S.reshape(-1, rows, 1) for J in jacobians]
    return [S.reshape(-1, rows, rows) @ J for J in jacobians]
