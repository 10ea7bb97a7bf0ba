"""New factors of an incremental smoother, sorted into the kinds that its tree knows."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from heliograph import _core
from heliograph.arrays import Array
from heliograph.errors import GraphError
from heliograph.graph.incremental.custom_factors import CustomFactors, CustomKind
from heliograph.graph.incremental.settings import CONSTRAINT_SIGMA
from heliograph.graph.model.factor import Factor
from heliograph.graph.model.factor_graph import Added
from heliograph.graph.model.families import Family
from heliograph.graph.model.kernels import Kernel
from heliograph.graph.model.noise import Whitening
from heliograph.graph.model.records import FactorRecord
from heliograph.lie import S2

__all__ = ["FactorStage", "KindName", "Staged", "stiff"]

# What tells kinds of factors apart: type, own class, families, form of noise, kernel, rows, shapes of what is measured.
KindName: TypeAlias = tuple[
    int, type[Factor] | None, tuple[Family, ...], int, Kernel | None, int, tuple[tuple[int, ...], ...]
]


class Staged(NamedTuple):
    """Factors of one kind, checked and ready to be handed over."""

    rows: slice | NDArray[np.int64]  # of all new factors, which these are
    kind: int
    scopes: list[int]  # variables of one factor after the other
    family: int  # of the measurement of a single factor that is not packed yet; -1: it is packed
    measurement: Array
    sqrt_information: Array
    data: tuple[Array, ...]


class FactorStage:
    """Finds the kind of every factor; a tree is told of a kind when the first of its factors comes.

    Parameters
    ----------
    native : native Bayes tree
        Numbers the kinds.
    families : list of Family
        By variable; the tree's state adds to it.
    kinds : dict
        Numbers by name; what is found is added.
    custom : CustomFactors
        Learns of kinds that are the user's own.
    """

    __slots__ = ("_custom", "_families", "_kinds", "_known", "_native")

    def __init__(
        self, native: _core.BayesTree, families: list[Family], kinds: dict[KindName, int], custom: CustomFactors
    ) -> None:
        self._native, self._families, self._kinds, self._custom = native, families, kinds, custom
        # Kinds of built-in factors by what is looked up faster than their names: classes and families are made once.
        self._known: dict[tuple[Any, ...], int] = {}

    def parts(self, added: Added, numbers: list[int]) -> list[Staged]:
        """Return the factors of a record by kind.

        Parameters
        ----------
        added : Added
            The record as it stands in its graph.
        numbers : list of int
            Its variables, one factor after the other.

        Raises
        ------
        GraphError
            The variables are not of families that the factor takes.
        """
        if added.whitening.constrained:
            added = Added(first=added.first, record=added.record, whitening=stiff(added.whitening))
        families, arity = self._families, added.record.arity
        if len(numbers) == arity:
            return [self._single(added, numbers, tuple([families[v] for v in numbers]))]
        combinations: dict[tuple[Family, ...], list[int]] = {}
        for row in range(len(numbers) // arity):
            scope = numbers[row * arity : (row + 1) * arity]
            combinations.setdefault(tuple([families[v] for v in scope]), []).append(row)
        if len(combinations) == 1:  # the usual case: all of them as they are
            return [self._whole(added, numbers, next(iter(combinations)))]
        scopes = np.array(numbers, dtype=np.int32).reshape(-1, arity)
        return [self._some(added, scopes, mine, np.array(rows)) for mine, rows in combinations.items()]

    def _single(self, added: Added, scope: list[int], families: tuple[Family, ...]) -> Staged:
        first, record, noise = added
        if isinstance(record, Factor):
            return self._whole(added, scope, families)
        measured = record.measured
        if record.single is None or measured is None:
            measurement, code = record.measurement[0], -1
            size = len(measurement)
        else:
            value = record.single[1]
            measurement = value.vector if measured.lie is S2 else value.matrix
            code, size = measured.code, measured.storage
        name = (record.__class__, noise.form, record.kernel, record.rows, size, *map(id, families))
        kind = self._known.get(name)
        if kind is None:
            kind = self._known[name] = self._kind(added, families, 0)
        return Staged(slice(first, first + 1), kind, scope, code, measurement, noise.sqrt_information[0], ())

    def _whole(self, added: Added, scopes: list[int], families: tuple[Family, ...]) -> Staged:
        first, record, noise = added
        data = record.data if isinstance(record, Factor) else ()
        kind, rows = self._kind(added, families, 0), slice(first, first + len(record))
        return Staged(rows, kind, scopes, -1, record.measurement.reshape(-1), noise.sqrt_information.reshape(-1), data)

    def _some(
        self, added: Added, scopes: NDArray[np.int32], families: tuple[Family, ...], mine: NDArray[Any]
    ) -> Staged:
        first, record, noise = added
        data = record.data if isinstance(record, Factor) else ()
        roots = noise.sqrt_information if noise.shared else noise.sqrt_information[mine]
        return Staged(
            first + mine,
            self._kind(added, families, int(mine[0])),
            scopes[mine].reshape(-1).tolist(),
            -1,
            record.measurement[mine].reshape(-1),
            roots.reshape(-1),
            tuple([item[mine] for item in data]),
        )

    def _kind(self, added: Added, families: tuple[Family, ...], row: int) -> int:
        record, noise = added.record, added.whitening
        own = type(record) if isinstance(record, Factor) else None
        shapes: tuple[tuple[int, ...], ...] = ((record.width,),)
        if isinstance(record, Factor):
            shapes = tuple([item.shape[1:] for item in record.data])
        name = (record.type, own, families, noise.form, record.kernel, record.rows, shapes)
        kind = self._kinds.get(name)
        if kind is None:
            fault = record.mismatch(families)
            if fault is not None:
                raise GraphError(f"{added.name(row)}: {fault}")
            kind = self._kinds[name] = self._new_kind(record, families, noise)
            if own is not None:
                self._custom.kinds[kind] = CustomKind(own, families)
        return kind

    def _new_kind(self, record: FactorRecord, families: tuple[Family, ...], noise: Whitening) -> int:
        kernel = record.kernel
        return self._native.add_kind(
            record.type,
            np.array([family.code for family in families], dtype=np.int32),
            np.array([family.dof for family in families], dtype=np.int32),
            record.rows,
            noise.form,
            0 if kernel is None else kernel.code,
            1.0 if kernel is None else float(kernel.width),
            record.width,
        )


def stiff(whitening: Whitening) -> Whitening:
    """Return the noise that stands for a hard constraint in the tree, see `CONSTRAINT_SIGMA`."""
    return replace(whitening, sqrt_information=whitening.sqrt_information / CONSTRAINT_SIGMA, constrained=False)
