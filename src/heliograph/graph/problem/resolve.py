"""Joins a graph to values: every record's keys become dense indices, and factors of one kind become one group."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import Array, freeze
from heliograph.errors import GraphError
from heliograph.graph.model.factor import Factor
from heliograph.graph.model.factor_graph import Added, FactorGraph
from heliograph.graph.model.families import Family
from heliograph.graph.model.kernels import Kernel
from heliograph.graph.model.noise import Whitening
from heliograph.graph.model.records import joined_keys, joined_measurements, key_list
from heliograph.graph.model.values import Values

__all__ = ["ResolvedGroup", "gather", "resolve", "resolve_fixed"]

Number = TypeVar("Number", np.float64, np.int64)


@dataclass(frozen=True, slots=True, kw_only=True)
class ResolvedGroup:
    """Factors of one type, on variables of the same families, with one form of noise and one kernel.

    Parameters
    ----------
    code : int
        Number of the residual on the native side; 0 for a user's own.
    families : tuple of Family
        The family of each variable.
    variables : (N, arity) int32
        Dense indices: variables count family by family as first inserted, each family in the order of insertion.
    numbers : (N,) int64
        Which factors of the graph they are, ascending.
    measurement : (N, m) float64
        Packed, C-contiguous.
    rows : int
        Rows of one residual.
    noise : Whitening
        Noise of these factors.
    kernel : Kernel or None
        Kernel of each factor's whitened length.
    custom : type or None
        The class of a user's own factors.
    data : tuple of (N, ...) float64
        What a user's own residual is handed after the variables.
    """

    code: int
    families: tuple[Family, ...]
    variables: NDArray[np.int32]
    numbers: NDArray[np.int64]
    measurement: Array
    rows: int
    noise: Whitening
    kernel: Kernel | None
    custom: type[Factor] | None
    data: tuple[Array, ...]

    def __post_init__(self) -> None:
        freeze(self)

    @property
    def kernel_code(self) -> int:
        """Number of the kernel on the native side; 0: none."""
        return 0 if self.kernel is None else self.kernel.code

    @property
    def kernel_width(self) -> float:
        """Width of the kernel; 1 without one."""
        return 1.0 if self.kernel is None else float(self.kernel.width)

    @property
    def constrained(self) -> bool:
        """The residuals must vanish."""
        return self.noise.constrained


def resolve(graph: FactorGraph, values: Values) -> list[ResolvedGroup]:
    """Return the factors of a graph in groups, each of which is evaluated in one call.

    Records that differ in nothing but their numbers are one group, however they were added; a record whose variables
    have several combinations of families is several.

    Raises
    ------
    GraphError
        A key has no value, or a variable is of a family that its factor cannot use.
    """
    kinds: dict[Hashable, list[Added]] = {}
    for added in graph.groups():
        if len(added.record):
            kinds.setdefault(_kind(added), []).append(added)
    groups: list[ResolvedGroup] = []
    for members in kinds.values():
        groups.extend(_resolve_kind(graph, values, members))
    return groups


def resolve_fixed(graph: FactorGraph, values: Values) -> NDArray[np.int64]:
    """Return the dense indices (M,) of the variables that are held, ascending.

    Raises
    ------
    GraphError
        A key that is held has no value.
    """
    dense = values.dense(graph.fixed)
    if (dense < 0).any():
        raise GraphError(f"{key_list(graph.fixed[dense < 0])}: held by `fix`, but without a value")
    return np.sort(dense)


def gather(group: ResolvedGroup, families: Sequence[Family], packed: Sequence[Array]) -> list[Array]:
    """Return the variables of a group's factors as a user's own residual takes them, one array (N, *shape) a variable.

    Parameters
    ----------
    group : ResolvedGroup
        Whose variables.
    families : sequence of Family
        Families of the values, in their order.
    packed : sequence of (M, storage) float64
        Values of each family.
    """
    firsts = np.cumsum([0, *[len(block) for block in packed]])
    arrays = []
    for family, dense in zip(group.families, group.variables.T, strict=True):
        number = families.index(family)
        arrays.append(family.elements(packed[number][dense - firsts[number]]))
    return arrays


def _kind(added: Added) -> Hashable:
    """Return what records must share to be one group."""
    record, noise = added.record, added.whitening
    own: Hashable = None
    if isinstance(record, Factor):
        own = tuple(item.shape[1:] for item in record.data)
    layout = (record.measured, record.width, record.arity, record.rows, record.allowed)
    return type(record), own, layout, noise.form, noise.constrained, record.kernel


def _resolve_kind(graph: FactorGraph, values: Values, members: Sequence[Added]) -> list[ResolvedGroup]:
    keys = joined_keys([added.record for added in members])
    numbers = _concatenate([np.arange(added.first, added.first + len(added.record)) for added in members])
    dense = values.dense(keys)
    missing = (dense < 0).any(axis=1)
    if missing.any():
        row = int(np.argmax(missing))
        raise GraphError(
            f"{graph.name(int(numbers[row]))}: no value for {key_list(keys[row][dense[row] < 0])}"
            f" ({int(missing.sum())} of {len(graph)} factors lack one); insert a value for every variable"
        )
    ends = np.cumsum(values.counts())
    number_of_family = np.searchsorted(ends, dense, side="right")
    combinations, member = _distinct_rows(number_of_family, len(ends))
    families = values.families()
    parts = []
    for index, combination in enumerate(combinations):
        rows = np.flatnonzero(member == index) if len(combinations) > 1 else None
        parts.append((tuple(families[k] for k in combination), rows))
    for chosen, rows in parts:
        fault = members[0].record.mismatch(chosen)
        if fault is not None:
            row = 0 if rows is None else int(rows[0])
            raise GraphError(f"{graph.name(int(numbers[row]))}: {fault}")
    return [_group(members, chosen, rows, dense, numbers) for chosen, rows in parts]


def _distinct_rows(table: NDArray[np.int64], base: int) -> tuple[list[tuple[int, ...]], NDArray[np.int64]]:
    """Return the distinct rows of small numbers below `base`, and which of them each row is."""
    if (table == table[0]).all():
        return [tuple(table[0].tolist())], np.zeros(len(table), dtype=np.int64)
    code = np.zeros(len(table), dtype=np.int64)
    for column in table.T:
        code = code * base + column
    _, first, member = np.unique(code, return_index=True, return_inverse=True)
    return [tuple(table[row].tolist()) for row in first], member.reshape(-1)


def _group(
    members: Sequence[Added],
    families: tuple[Family, ...],
    rows: NDArray[np.int64] | None,
    dense: NDArray[np.int64],
    numbers: NDArray[np.int64],
) -> ResolvedGroup:
    record = members[0].record
    select = (lambda array: array) if rows is None else (lambda array: np.ascontiguousarray(array[rows]))
    data: tuple[Array, ...] = ()
    if isinstance(record, Factor):
        stacks = [added.record.data for added in members if isinstance(added.record, Factor)]
        data = tuple(select(_concatenate(list(items))) for items in zip(*stacks, strict=True))
    return ResolvedGroup(
        code=record.type,
        families=families,
        variables=np.ascontiguousarray(select(dense), dtype=np.int32),
        numbers=select(numbers),
        measurement=select(joined_measurements([added.record for added in members])),
        rows=record.rows,
        noise=_noise(members, rows),
        kernel=record.kernel,
        custom=type(record) if isinstance(record, Factor) else None,
        data=data,
    )


def _noise(members: Sequence[Added], rows: NDArray[np.int64] | None) -> Whitening:
    """Return the noise of the members as one: shared if all of it is equal, else one S a factor."""
    first = members[0].whitening
    if all(added.whitening is first for added in members[1:]) and first.shared:
        return first
    if all(added.whitening.shared for added in members) and all(
        np.array_equal(added.whitening.sqrt_information, first.sqrt_information) for added in members[1:]
    ):
        return first
    width = first.sqrt_information.shape[1]
    spread = [np.broadcast_to(a.whitening.sqrt_information, (len(a.record), width)) for a in members]
    roots = _concatenate(spread)
    roots = np.ascontiguousarray(roots if rows is None else roots[rows])
    return Whitening(form=first.form, shared=False, sqrt_information=roots, constrained=first.constrained)


def _concatenate(arrays: list[NDArray[Number]]) -> NDArray[Number]:
    return arrays[0] if len(arrays) == 1 else np.concatenate(arrays)
