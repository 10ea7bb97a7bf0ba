"""Any factor graph and its values in one file, to the bit: a NumPy archive of arrays with a table of contents."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from heliograph.atomic import atomic_path
from heliograph.errors import FormatError, GraphError
from heliograph.graph.files.file_factors import PlaneSighting
from heliograph.graph.model import factors as built_in
from heliograph.graph.model import kernels, noise, surfaces
from heliograph.graph.model.factor import Factor
from heliograph.graph.model.factor_graph import FactorGraph
from heliograph.graph.model.families import FAMILIES, Family, vectors
from heliograph.graph.model.records import FactorRecord
from heliograph.graph.model.values import Values
from heliograph.guard.npz import read_npz

__all__ = ["DAMAGE", "KERNELS", "family_called", "load_graph", "name_of", "save_graph"]

VERSION = 1

_BUILT_IN: dict[str, type[FactorRecord]] = {
    name: getattr(room, name) for room in (built_in, surfaces) for name in room.__all__
}
_NOISES: dict[str, type[noise.Noise]] = {
    cls.__name__: cls
    for cls in (
        noise.Isotropic,
        noise.Diagonal,
        noise.Covariance,
        noise.Information,
        noise.SquareRoot,
        noise.Constrained,
    )
}
KERNELS: dict[str, type[kernels.Kernel]] = {
    cls.__name__: cls for cls in map(kernels.__dict__.__getitem__, kernels.__all__) if cls is not kernels.Kernel
}
_LIE = {family.name: family for family in FAMILIES.values()}
_Arrays = dict[str, NDArray[Any]]
# What a table of contents that does not fit its arrays ends in.
DAMAGE = (AttributeError, ArithmeticError, EOFError, LookupError, MemoryError, RecursionError, TypeError, ValueError)


def save_graph(path: Path | str, graph: FactorGraph, values: Values) -> None:
    """Write a factor graph and its values, to be read by `load_graph`.

    Parameters
    ----------
    path : Path or str
        The file; customarily ``*.npz``.
    graph : FactorGraph
        Factors of every kind, with noise, kernels and what is fixed; a user's own factors by their data.
    values : Values
        All of them are written, in their order.

    Raises
    ------
    OutputError
        The file cannot be written.
    """
    arrays: _Arrays = {"fixed": graph.fixed}
    families, records = [], []
    for k, (family, packed) in enumerate(zip(values.families(), values.packed(), strict=True)):
        families.append(name_of(family))
        arrays[f"values{k}.packed"] = packed
    arrays["keys"] = values.keys()
    counts = list(values.counts())
    for k, record in enumerate(graph):
        records.append(_describe(record))
        arrays[f"factors{k}.keys"] = record.keys
        arrays[f"factors{k}.measurement"] = record.measurement
        arrays[f"factors{k}.noise"] = record.noise.numbers
        for d, item in enumerate(getattr(record, "data", ())):
            arrays[f"factors{k}.data{d}"] = item
    contents = {"version": VERSION, "families": families, "counts": counts, "records": records}
    arrays["contents"] = np.frombuffer(json.dumps(contents).encode(), dtype=np.uint8)
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        np.savez(file, allow_pickle=False, **arrays)  # type: ignore[arg-type, unused-ignore]


def load_graph(path: Path | str, *, factors: Iterable[type[FactorRecord]] = ()) -> tuple[FactorGraph, Values]:
    """Read what `save_graph` wrote.

    Parameters
    ----------
    path : Path or str
        The file.
    factors : classes
        The user's own factors in it and those of other rooms, such as `heliograph.factors.SENSOR_FACTORS`, found by
        their names: a file holds data, not programs.

    Returns
    -------
    graph : FactorGraph
    values : Values

    Raises
    ------
    FormatError
        The file is no such archive, is damaged, or a later version wrote it.
    GraphError
        It holds factors whose class was not given, or does not fit.
    """
    path = Path(path)
    known: list[type[FactorRecord]] = [PlaneSighting, *factors]
    own = {cls.__name__: cls for cls in known}
    try:
        arrays = read_npz(path)
        contents = json.loads(arrays["contents"].tobytes().decode())
        if contents["version"] > VERSION:
            raise FormatError(
                path, f"was written by a later version ({contents['version']} > {VERSION}); update Heliograph"
            )
        return _graph(contents, arrays, own, path), _values(contents, arrays)
    except OSError as error:
        raise FormatError(path, f"cannot be read ({error.strerror or error}); give a file of save_graph") from error
    except DAMAGE as error:
        raise FormatError(path, f"is no graph archive, or damaged ({error}); write it anew with save_graph") from error


def name_of(family: Family) -> str | int:
    """Return what files call a family: its name, or the dimension of vectors."""
    return family.dof if family.lie is None else family.name


def family_called(name: str | int) -> Family:
    """Return the family that files call so."""
    return _LIE[name] if isinstance(name, str) else vectors(name)


def _describe(record: FactorRecord) -> dict[str, Any]:
    kernel = record.kernel
    return {
        "kind": record.kind,
        "own": isinstance(record, Factor),
        "rows": record.rows,
        "noise": type(record.noise).__name__,
        "kernel": None if kernel is None else [type(kernel).__name__, kernel.width.hex()],
        "measured": None if record.measured is None else name_of(record.measured),
        "allowed": [[name_of(family) for family in families] for families in record.allowed],
        "data": len(getattr(record, "data", ())),
    }


def _values(contents: Mapping[str, Any], arrays: _Arrays) -> Values:
    values = Values()
    packed = [arrays[f"values{k}.packed"] for k in range(len(contents["families"]))]
    start = 0
    for name, count, numbers in zip(contents["families"], contents["counts"], packed, strict=True):
        values.insert(arrays["keys"][start : start + count], family_called(name).unpack(numbers))
        start += count
    # Once more as they were: a direction made from its numbers is divided by its length, which may change a last bit.
    return values.with_packed(packed)


def _graph(
    contents: Mapping[str, Any], arrays: _Arrays, own: Mapping[str, type[FactorRecord]], path: Path
) -> FactorGraph:
    graph = FactorGraph()
    for k, entry in enumerate(contents["records"]):
        kernel = None if entry["kernel"] is None else KERNELS[entry["kernel"][0]](float.fromhex(entry["kernel"][1]))
        count, numbers = len(arrays[f"factors{k}.keys"]), arrays[f"factors{k}.noise"]
        cls = _class_of(entry, own, path, count)
        width = arrays[f"factors{k}.measurement"].shape[-1]
        if cls in (built_in.Prior, built_in.Between) and width != family_called(entry["measured"]).storage:
            raise ValueError(f"{count} factors with a measurement of {width} numbers")
        graph.add(
            cls.restored(
                keys=arrays[f"factors{k}.keys"],
                measurement=arrays[f"factors{k}.measurement"],
                measured=None if entry["measured"] is None else family_called(entry["measured"]),
                rows=None if entry["own"] else entry["rows"],
                noise=noise.Constrained() if entry["noise"] == "Constrained" else _NOISES[entry["noise"]](numbers),
                kernel=kernel,
                allowed=tuple(tuple(family_called(name) for name in names) for names in entry["allowed"]),
                data=tuple(arrays[f"factors{k}.data{d}"] for d in range(entry["data"])) if entry["own"] else None,
            )
        )
    graph.fix(arrays["fixed"])
    return graph


def _class_of(
    entry: Mapping[str, Any], given: Mapping[str, type[FactorRecord]], path: Path, count: int
) -> type[FactorRecord]:
    name = entry["kind"]
    if not entry["own"] and name in _BUILT_IN:
        return _BUILT_IN[name]
    if name not in given:
        raise GraphError(
            f"{path} holds {count} factors of {name}, which is not built in; give its class: "
            f"load_graph(path, factors=[{name}])"
        )
    cls = given[name]
    if entry["own"] != issubclass(cls, Factor):
        raise GraphError(
            f"{path}: its {count} factors of {name} are of another version, evaluated in another way; "
            "build the graph again from the measurements and write it with save_graph"
        )
    if issubclass(cls, Factor):
        families = [[name_of(family) for family in allowed] for allowed in cls.families]
        if cls.rows != entry["rows"] or families != entry["allowed"]:
            raise GraphError(
                f"{path}: {name} was saved with {entry['rows']} rows for {entry['allowed']}, the class given has "
                f"{cls.rows} rows for {families}; give the class that the graph was built with"
            )
    return cls
