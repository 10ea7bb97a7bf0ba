"""New factors of an incremental smoother, sorted into the kinds that its tree knows."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple, TypeAlias

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
from heliograph.lie import S2

__all__ = ["FactorStage", "KindName", "Staged", "stiff"]

Int32s = NDArray[np.int32]

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
    let_go: bool  # they get a number and say nothing


class FactorStage:
    """The kinds of factors that the native tree knows; it is told of a kind when the first of its factors comes.

    Parameters
    ----------
    native : native Bayes tree
        Numbers the kinds, and takes the factors.
    families : list of Family
        By variable; the tree's state adds to it.

    Attributes
    ----------
    native : native Bayes tree
        As given; a tree of the same kinds may take its place.
    kinds : dict
        Numbers of the kinds, by what tells them apart.
    custom : CustomFactors
        The user's own.
    """

    __slots__ = ("_families", "_known", "custom", "kinds", "native")

    def __init__(self, native: _core.BayesTree, families: list[Family]) -> None:
        self.native, self._families = native, families
        self.kinds: dict[KindName, int] = {}
        self.custom = CustomFactors()
        # Kinds of built-in factors by what is looked up faster than their names: classes and families are made once.
        self._known: dict[tuple[Any, ...], int] = {}

    def parts(self, added: Added, numbers: list[int], let_go: Mask | None = None) -> list[Staged]:
        """Return the factors of a record by kind.

        Parameters
        ----------
        added : Added
            The record as it stands in its graph.
        numbers : list of int
            Its variables, one factor after the other.
        let_go : (M,) bool, optional
            By number of the factor in its graph: those that come without a say.

        Raises
        ------
        GraphError
            The variables are not of families that the factor takes.
        """
        if added.whitening.constrained:
            added = Added(first=added.first, record=added.record, whitening=stiff(added.whitening))
        families, arity = self._families, added.record.arity
        count = len(numbers) // arity
        silent = None if let_go is None else let_go[added.first : added.first + count].tolist()
        if count == 1:
            return [
                self._single(added, numbers, tuple([families[v] for v in numbers]), silent is not None and silent[0])
            ]
        combinations: dict[tuple[tuple[Family, ...], bool], list[int]] = {}
        for row in range(count):
            scope = numbers[row * arity : (row + 1) * arity]
            name = (tuple([families[v] for v in scope]), silent is not None and silent[row])
            combinations.setdefault(name, []).append(row)
        if len(combinations) == 1:  # the usual case: all of them as they are
            return [self._whole(added, numbers, *next(iter(combinations)))]
        scopes = np.array(numbers, dtype=np.int32).reshape(-1, arity)
        return [self._some(added, scopes, np.array(rows), *name) for name, rows in combinations.items()]

    def hand_over(self, part: Staged) -> tuple[Int32s, list[int]]:
        """Give a part to the tree; return the numbers of its factors, and those of the user's own among them."""
        if part.family >= 0:
            return self.native.add_single_factors([part]), []
        scopes = np.array(part.scopes, dtype=np.int32)
        numbers = self.native.add_factors(part.kind, scopes, part.measurement, part.sqrt_information, part.let_go)
        return numbers, self.custom.enter(part.kind, numbers, scopes.reshape(len(numbers), -1), part.data)

    def _single(self, added: Added, scope: list[int], families: tuple[Family, ...], let_go: bool) -> Staged:
        first, record, noise = added
        if isinstance(record, Factor):
            return self._whole(added, scope, families, let_go)
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
        root = noise.sqrt_information[0]
        return Staged(slice(first, first + 1), kind, scope, code, measurement, root, (), let_go)

    def _whole(self, added: Added, scopes: list[int], families: tuple[Family, ...], let_go: bool) -> Staged:
        first, record, noise = added
        data = record.data if isinstance(record, Factor) else ()
        kind, rows = self._kind(added, families, 0), slice(first, first + len(record))
        measurement, roots = record.measurement.reshape(-1), noise.sqrt_information.reshape(-1)
        return Staged(rows, kind, scopes, -1, measurement, roots, data, let_go)

    def _some(
        self, added: Added, scopes: Int32s, mine: NDArray[Any], families: tuple[Family, ...], let_go: bool
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


def stiff(whitening: Whitening) -> Whitening:
    """Return the noise that stands for a hard constraint in the tree, see `CONSTRAINT_SIGMA`."""
    return replace(whitening, sqrt_information=whitening.sqrt_information / CONSTRAINT_SIGMA, constrained=False)
