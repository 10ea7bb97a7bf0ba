"""The whole state of an incremental smoother as arrays, and as a file: a NumPy archive with a table of contents."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from itertools import groupby
from operator import contains
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from heliograph.atomic import atomic_path
from heliograph.errors import FormatError, GraphError
from heliograph.graph.files.archive import DAMAGE, KERNELS, family_called, name_of
from heliograph.graph.incremental.custom_factors import CustomKind
from heliograph.graph.incremental.state_check import check_state
from heliograph.graph.incremental.tree_state import TreeState
from heliograph.graph.model.factor import Factor
from heliograph.graph.model.key_runs import KeyRuns
from heliograph.graph.model.records import FactorRecord
from heliograph.guard.npz import read_npz

__all__ = ["read_state", "state_arrays", "state_from", "write_state"]

VERSION = 4  # 4: factors may be let go
OLDEST_READ = 2
# Settings that version 2 wrote under another name.
_RENAMED_SETTINGS = {"most_steps": "max_steps", "most_relinearized": "max_relinearized"}

_Arrays = dict[str, NDArray[Any]]


def state_arrays(state: TreeState) -> _Arrays:
    """Return all that a state consists of; between two updates."""
    arrays: _Arrays = {
        "tree": np.frombuffer(state.native.save(), dtype=np.uint8),
        "keys": np.array(state._keys, dtype=np.int64),
        "numbers": np.array(list(state._number.values()), dtype=np.int64),
        "left": np.array(state._left.runs(), dtype=np.int64).reshape(-1, 2),
        "switched": np.array(list(state._switched.items()), dtype=np.float64).reshape(-1, 2),
    }
    kinds = []
    for (code, own, families, form, kernel, rows, shapes), number in state.staging.kinds.items():
        kinds.append(
            {
                "number": number,
                "code": code,
                "own": None if own is None else own.__name__,
                "families": [name_of(family) for family in families],
                "form": form,
                "kernel": None if kernel is None else [type(kernel).__name__, float(kernel.width).hex()],
                "rows": rows,
                "shapes": shapes,
            }
        )
        if own is not None:
            entry, prefix = state.staging.custom.kinds[number], f"own{number}"
            members = list(entry.scopes)
            arrays[f"{prefix}.numbers"] = np.array(members, dtype=np.int32)
            arrays[f"{prefix}.scopes"] = np.array([entry.scopes[n] for n in members], dtype=np.int32)
            for d, shape in enumerate(shapes):
                items = [entry.data[n][d] for n in members]
                arrays[f"{prefix}.data{d}"] = np.array(items, dtype=np.float64).reshape(len(members), *shape)
    runs = [[name_of(family), len(list(run))] for family, run in groupby(state._families)]
    early = state.early.values
    for k, (family, packed) in enumerate(zip(early.families(), early.packed(), strict=True)):
        arrays[f"early{k}.keys"], arrays[f"early{k}.packed"] = early.block(family)[0], packed
    contents = {"families": runs, "kinds": kinds, "early": [name_of(family) for family in early.families()]}
    arrays["contents"] = np.frombuffer(json.dumps(contents).encode(), dtype=np.uint8)
    return arrays


def state_from(arrays: Mapping[str, NDArray[Any]], factors: Iterable[type[FactorRecord]]) -> TreeState:
    """Return the state that `state_arrays` took apart; `factors` are the classes of the user's own.

    Raises
    ------
    GraphError
        A class was not given, or does not fit.
    ValueError, KeyError, TypeError
        The arrays are damaged.
    """
    classes = {cls.__name__: cls for cls in factors if issubclass(cls, Factor)}
    contents = json.loads(arrays["contents"].tobytes().decode())
    state = TreeState()
    state.native.load(arrays["tree"].tobytes())
    state._keys = _integers(arrays, "keys", 1).tolist()
    state._number = {state._keys[number]: number for number in _within(arrays, "numbers", len(state._keys))}
    state._left = KeyRuns.of([(first, last) for first, last in _integers(arrays, "left", 2).tolist()])
    counts = [count for _, count in contents["families"]]
    if not all(type(count) is int and count > 0 for count in counts) or sum(counts) != state.native.slots:
        raise ValueError("its parts do not belong together: it needs a family for each variable")
    for name, count in contents["families"]:
        state._families += [family_called(name)] * count
    for entry in contents["kinds"]:
        families = tuple(family_called(name) for name in entry["families"])
        kernel = None if entry["kernel"] is None else KERNELS[entry["kernel"][0]](float.fromhex(entry["kernel"][1]))
        own = None if entry["own"] is None else _own_class(entry["own"], entry["rows"], families, classes)
        shapes = tuple(tuple(shape) for shape in entry["shapes"])
        number = entry["number"]
        state.staging.kinds[(entry["code"], own, families, entry["form"], kernel, entry["rows"], shapes)] = number
        if own is not None:
            members = _own_members(CustomKind(own, families), arrays, f"own{number}", shapes)
            state.staging.custom.kinds[number] = members
    for k, name in enumerate(contents.get("early", ())):  # an earlier version had none
        family = family_called(name)
        state.early.values.insert(arrays[f"early{k}.keys"], family.unpack(arrays[f"early{k}.packed"]))
    state._switched = {int(number): weight for number, weight in arrays["switched"].tolist()}
    check_state(state, len(state._families))
    return state


def _integers(arrays: Mapping[str, NDArray[Any]], name: str, ndim: int) -> NDArray[np.int64]:
    array = arrays[name]
    if array.dtype != np.int64 or array.ndim != ndim:
        raise ValueError(f"'{name}' holds no list of whole numbers")
    return array


def _within(arrays: Mapping[str, NDArray[Any]], name: str, size: int) -> list[int]:
    numbers = _integers(arrays, name, 1)
    if len(numbers) and not (numbers.min() >= 0 and numbers.max() < size):
        raise ValueError(f"'{name}' names variables that there are not")
    return list(numbers.tolist())


def _own_members(
    own: CustomKind, arrays: Mapping[str, NDArray[Any]], prefix: str, shapes: tuple[tuple[int, ...], ...]
) -> CustomKind:
    items = [arrays[f"{prefix}.data{d}"] for d in range(len(shapes))]
    count = len(arrays[f"{prefix}.numbers"])
    for item, shape in zip(items, shapes, strict=True):
        if item.shape != (count, *shape) or item.dtype != np.float64 or not np.isfinite(item).all():
            raise ValueError(f"the data of {own.factor.__name__} are of another shape, or not finite")
    if arrays[f"{prefix}.scopes"].dtype != np.int32:
        raise ValueError(f"the variables of {own.factor.__name__} are no whole numbers")
    for row, number in enumerate(arrays[f"{prefix}.numbers"].tolist()):
        own.scopes[number] = arrays[f"{prefix}.scopes"][row]
        own.data[number] = tuple(item[row] for item in items)
    return own


def _own_class(name: str, rows: int, families: tuple[Any, ...], classes: Mapping[str, type[Factor]]) -> type[Factor]:
    cls = classes.get(name)
    if cls is None:
        raise GraphError(f"the state holds factors of {name}, which is not built in; give its class: factors=[{name}]")
    fits = len(cls.families) == len(families) and all(map(contains, cls.families, families))
    if cls.rows != rows or not fits:
        wanted = [" or ".join(family.name for family in allowed) for allowed in cls.families]
        raise GraphError(
            f"{name} was saved with {rows} rows for {[family.name for family in families]}, the class given has "
            f"{cls.rows} rows for {wanted}; give the class that was used"
        )
    return cls


def write_state(path: Path | str, arrays: _Arrays, contents: Mapping[str, Any]) -> None:
    """Write the arrays of a state, and what the smoother says of itself; the file is there whole or not at all.

    Raises
    ------
    OutputError
        The file cannot be written.
    """
    about = json.dumps({"version": VERSION, **contents}).encode()
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        np.savez(file, allow_pickle=False, about=np.frombuffer(about, dtype=np.uint8), **arrays)  # type: ignore[arg-type, unused-ignore]


def read_state(path: Path | str, factors: Iterable[type[FactorRecord]]) -> tuple[TreeState, _Arrays, dict[str, Any]]:
    """Read what `write_state` wrote: the state, all arrays, and what the smoother said of itself.

    Raises
    ------
    FormatError
        The file is no such state, is damaged, or another version wrote it.
    GraphError
        It holds factors whose class was not given, or does not fit.
    """
    path = Path(path)
    try:
        arrays = read_npz(path)
        about = json.loads(arrays["about"].tobytes().decode())
        if about["version"] > VERSION:
            raise FormatError(
                path, f"was written by a later version ({about['version']} > {VERSION}); update Heliograph"
            )
        if about["version"] < OLDEST_READ:
            raise FormatError(
                path, f"was written by an earlier version ({about['version']} < {OLDEST_READ}); replay the graph"
            )
        about["settings"] = {_RENAMED_SETTINGS.get(name, name): value for name, value in about["settings"].items()}
        return state_from(arrays, factors), arrays, about
    except OSError as error:
        raise FormatError(path, f"cannot be read ({error.strerror or error}); give a file of ISAM2.save") from error
    except DAMAGE as error:
        raise FormatError(path, f"is no saved smoother, or damaged ({error}); save it again with ISAM2.save") from error
