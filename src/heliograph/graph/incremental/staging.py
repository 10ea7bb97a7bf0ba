"""Factors made ready for the native tree: sorted by kind, checked against the families of their variables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from heliograph import _core
from heliograph.arrays import Array, Mask
from heliograph.errors import GraphError
from heliograph.graph.incremental.custom_factors import CustomFactors, CustomKind
from heliograph.graph.incremental.settings import CONSTRAINT_SIGMA
from heliograph.graph.model.factor import Factor
from heliograph.graph.model.factor_graph import Added
from heliograph.graph.model.families import Family
from heliograph.graph.model.kernels import Kernel
from heliograph.graph.model.noise import Whitening
from heliograph.graph.model.records import FactorRecord

__all__ = ["KindName", "Staged", "Staging", "stiff"]

Int32s = NDArray[np.int32]
# What tells kinds of factors apart: type, own class, families, form of noise, kernel, rows, shapes of what is measured.
KindName: TypeAlias = tuple[
    int, type[Factor] | None, tuple[Family, ...], int, Kernel | None, int, tuple[tuple[int, ...], ...]
]


class Staged(NamedTuple):
    """Factors of one kind, checked and ready to be handed over."""

    rows: slice | NDArray[np.int64]  # of all new factors, which these are
    kind: int
    scopes: Int32s
    measurement: Array
    sqrt_information: Array
    data: tuple[Array, ...]
    let_go: bool  # they get a number and say nothing


class Staging:
    """The kinds of factors that the native tree knows, by what tells them apart, and the user's own among them.

    Attributes
    ----------
    native : native Bayes tree
        That factors are handed to.
    kinds : dict
        Numbers of the kinds.
    custom : CustomFactors
        The user's own.
    """

    def __init__(self, native: _core.BayesTree) -> None:
        self.native = native
        self.kinds: dict[KindName, int] = {}
        self.custom = CustomFactors()

    def parts(
        self, added: Added, scopes: Int32s, families_of: Sequence[Family], let_go: Mask | None = None
    ) -> list[Staged]:
        """Return a record's factors, each part of one kind.

        Parameters
        ----------
        added : Added
            The record.
        scopes : (N, arity) int32
            Numbers of its variables.
        families_of : sequence of Family
            By number of the variable.
        let_go : (M,) bool, optional
            By number of the factor in its graph: those that come without a say.
        """
        if added.whitening.constrained:
            added = Added(first=added.first, record=added.record, whitening=stiff(added.whitening))
        silent = None if let_go is None else let_go[added.first : added.first + len(scopes)]
        if silent is not None and not silent.any():
            silent = None
        if len(scopes) == 1:
            families = tuple([families_of[v] for v in scopes[0].tolist()])
            return [self._part(added, scopes, families, None, silent is not None)]
        combinations: dict[tuple[tuple[Family, ...], bool], list[int]] = {}
        for row, scope in enumerate(scopes.tolist()):
            name = (tuple([families_of[v] for v in scope]), silent is not None and bool(silent[row]))
            combinations.setdefault(name, []).append(row)
        if len(combinations) == 1:  # the usual case: all of them as they are
            return [self._part(added, scopes, *_with_all(next(iter(combinations))))]
        return [
            self._part(added, scopes, families, np.array(rows), quiet)
            for (families, quiet), rows in combinations.items()
        ]

    def _part(
        self,
        added: Added,
        scopes: Int32s,
        families: tuple[Family, ...],
        members: NDArray[np.int64] | None,
        let_go: bool,
    ) -> Staged:
        """Return those factors of a record that join variables of such families: some rows, or all."""
        record, noise = added.record, added.whitening
        data = record.data if isinstance(record, Factor) else ()
        kind = self._kind(added, families, 0 if members is None else int(members[0]))
        if members is None:
            rows = slice(added.first, added.first + len(record))
            return Staged(rows, kind, scopes, record.measurement, noise.sqrt_information, data, let_go)
        return Staged(
            added.first + members,
            kind,
            np.ascontiguousarray(scopes[members]),
            np.ascontiguousarray(record.measurement[members]),
            noise.sqrt_information if noise.shared else np.ascontiguousarray(noise.sqrt_information[members]),
            tuple([item[members] for item in data]),
            let_go,
        )

    def _kind(self, added: Added, families: tuple[Family, ...], row: int) -> int:
        record, noise = added.record, added.whitening
        own = type(record) if isinstance(record, Factor) else None
        shapes: tuple[tuple[int, ...], ...] = ((record.width,),)
        if isinstance(record, Factor):
            shapes = tuple([item.shape[1:] for item in record.data])
        name = (record.type, own, families, noise.form, record.kernel, record.rows, shapes)
        kind = self.kinds.get(name)
        if kind is None:
            fault = record.mismatch(families)
            if fault is not None:
                raise GraphError(f"{added.name(row)}: {fault}")
            kind = self.kinds[name] = self._new_kind(record, families, noise)
            if own is not None:
                self.custom.kinds[kind] = CustomKind(own, families)
        return kind

    def _new_kind(self, record: FactorRecord, families: tuple[Family, ...], noise: Whitening) -> int:
        kernel = record.kernel
        return self.native.add_kind(
            record.type,
            np.array([family.code for family in families], dtype=np.int32),
            np.array([family.dof for family in families], dtype=np.int32),
            record.rows,
            noise.form,
            0 if kernel is None else kernel.code,
            1.0 if kernel is None else float(kernel.width),
            record.width,
        )

    def hand_over(self, part: Staged) -> tuple[Int32s, list[int]]:
        """Give a part to the tree; return the numbers of its factors, and those of the user's own among them."""
        numbers = self.native.add_factors(
            part.kind,
            part.scopes.reshape(-1),
            part.measurement.reshape(-1),
            part.sqrt_information.reshape(-1),
            part.let_go,
        )
        return numbers, self.custom.enter(part.kind, numbers, part.scopes, part.data)


def _with_all(name: tuple[tuple[Family, ...], bool]) -> tuple[tuple[Family, ...], None, bool]:
    families, let_go = name
    return families, None, let_go


def stiff(whitening: Whitening) -> Whitening:
    """Return the noise that stands for a hard constraint in the tree, see `CONSTRAINT_SIGMA`."""
    return replace(whitening, sqrt_information=whitening.sqrt_information / CONSTRAINT_SIGMA, constrained=False)
