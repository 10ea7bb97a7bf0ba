"""Whether the parts of a saved smoother belong together: what Python keeps beside the native tree, against the tree."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from heliograph.graph.incremental.tree_state import TreeState

__all__ = ["check_columns", "check_state"]


def check_state(state: TreeState, families: int) -> None:
    """Compare names, kinds and the user's own factors with the native tree.

    Parameters
    ----------
    state : TreeState
        With its native tree loaded.
    families : int
        Variables whose families the file names.

    Raises
    ------
    ValueError
        They do not belong together.
    """
    native, keys = state.native, state._keys
    _require(native.slots == len(keys) == families, "as many keys and families as variables")
    _require(native.variables == len(state._number), "a key for each variable")
    pairs = np.array([(family.code, family.dof) for family in state._families], dtype=np.int32).reshape(-1, 2)
    _require(np.array_equal(pairs, native.variable_families()), "variables of the same families")
    runs = [edge for run in state._left.runs() for edge in run]
    _require(runs == sorted(runs), "ascending keys of what has left")
    _check_kinds(state)
    _check_own(state)
    switched = np.array(list(state._switched), dtype=np.int64)
    _require(np.abs(switched).max(initial=0) < 1 << 31, "numbers of factors that are switched")
    _require(native.has_factors(switched.astype(np.int32)), "only factors that there are being switched")
    _require(all(weight in (0.0, 1.0) for weight in state._switched.values()), "factors switched on or off")
    early = set(state.early.values.keys().tolist())
    _require(early.isdisjoint(state._number), "no variable both in the tree and waiting")


def check_columns(columns: dict[str, NDArray[Any]], state: TreeState) -> None:
    """Compare the table of doubtful factors with the tree.

    Raises
    ------
    ValueError
        A column is of another length or type, or names a factor or variable that there is not.
    """
    kinds = {
        "active": "b",
        "bent": "b",
        "widest": "f",
        "tested": "f",
        "numbers": "i",
        "rows": "i",
        "ends": "i",
        "tried": "i",
    }
    count = len(columns["numbers"])
    for name, column in columns.items():
        shape = (count, 2) if name == "ends" else (count,)
        _require(column.shape == shape, f"a column '{name}' of the shape {shape}")
        _require(column.dtype.kind == kinds.get(name, column.dtype.kind), f"a column '{name}' of its type")
    numbers, ends = columns["numbers"], columns["ends"]
    _require(np.abs(numbers).max(initial=0) < 1 << 31, "numbers of doubtful factors")
    _require(len(np.unique(numbers)) == count, "each doubtful factor once")
    _require(state.native.has_factors(numbers.astype(np.int32)), "only doubtful factors that there are")
    kind, let_go = state.native.factor_kinds()[numbers].reshape(-1, 2).T
    _require(np.array_equal(let_go == 0, columns["active"]), "the same factors let go in the tree")
    _require(np.array_equal(state.native.kind_table()[kind, 1], columns["rows"]), "doubtful factors of as many rows")
    _require(
        bool(((ends >= 0) & (ends < state.native.slots)).all()), "doubtful factors between variables that there are"
    )


def _check_kinds(state: TreeState) -> None:
    table = state.native.kind_table()
    _require(sorted(state.staging.kinds.values()) == list(range(len(table))), "each kind of factors once")
    for (code, own, families, form, kernel, rows, shapes), number in state.staging.kinds.items():
        found = table[number].tolist()
        pairs = [n for family in families for n in (family.code, family.dof)]
        width = 0 if own is not None else shapes[0][0] if len(shapes) == 1 and len(shapes[0]) == 1 else -1
        told = [code, rows, form, 0 if kernel is None else kernel.code, width, len(families), *pairs]
        _require(found[: len(told)] == told, "kinds of factors as the tree has them")


def _check_own(state: TreeState) -> None:
    kinds = state.native.factor_kinds()[:, 0]
    table = state._families
    for number, own in state.staging.custom:
        members = np.flatnonzero(kinds == number).tolist()
        _require(sorted(own.scopes) == members, "the user's own factors as the tree has them")
        for scope in own.scopes.values():
            _require(scope.shape == (len(own.families),), "the variables of the user's own factors")
            mine = [table[v] if 0 <= v < len(table) else None for v in scope.tolist()]
            _require(mine == list(own.families), "the user's own factors between variables of their families")


def _require(holds: bool, what: str) -> None:
    if not holds:
        raise ValueError(f"its parts do not belong together: it needs {what}")
