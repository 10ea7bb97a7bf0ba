"""The state of what changes as plain values, and as one file: what a run that was cut off goes on from, to the bit.

A part says what its state consists of and of which kinds; what is read is held against that before any of it is used.
A file holds numbers, text and arrays: it names records, whose own constructors make them, and never a program.
"""

from __future__ import annotations

import json
import os
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, Final, Protocol, TypeAlias, runtime_checkable

import numpy as np
from numpy.typing import DTypeLike, NDArray

from heliograph.arrays import Shape
from heliograph.atomic import atomic_path
from heliograph.errors import DataError, FormatError
from heliograph.guard.npz import read_npz

__all__ = [
    "PART",
    "Part",
    "Snapshot",
    "Stateful",
    "array",
    "fixed",
    "packed",
    "read_snapshot",
    "require",
    "settle",
    "unpacked",
    "write_snapshot",
]

Snapshot: TypeAlias = dict[str, Any]
"""Name -> value: None, truth values, numbers, text, bytes, arrays, frozen records, and containers of these."""
Kind: TypeAlias = Any
"""A type; None; a tuple of alternatives; ``[kind]``, ``{kind: kind}`` for containers; `array`, `fixed`; `PART`."""

PART: Final = "part"
"""Kind of a value that has a state of its own, and is there already when that is restored; or is None both times."""

_MARK = "heliograph snapshot"
_NOT_WHOLE = "is no checkpoint of a run, or damaged"
_MANY = 4  # numbers of a list from which they are kept as an array


@runtime_checkable
class Part(Protocol):
    """What has a state. `heliograph.testing.assert_goes_on` is its law."""

    def snapshot(self) -> Snapshot:
        """Return the state between two verbs; it may share memory with the part, and is packed before the next."""
        ...

    def restore(self, snapshot: Snapshot) -> None:
        """Take up the state of another part that was made with the same arguments; both then go on alike.

        Raises
        ------
        DataError
            It is none of such a part.
        """
        ...


class Stateful:
    """A part whose state is a few of its attributes, named in ``_STATE`` with their kinds."""

    __slots__ = ()
    _STATE: ClassVar[Mapping[str, Kind]] = {}

    def snapshot(self) -> Snapshot:
        """Return the attributes of the state by name."""
        return {name: _taken(getattr(self, name), kind) for name, kind in self._STATE.items()}

    def restore(self, snapshot: Snapshot) -> None:
        """Take up the attributes of another part's state.

        Raises
        ------
        DataError
            One is missing, too many, or of another kind.
        """
        require(self, snapshot, self._STATE)
        for name, kind in self._STATE.items():
            if kind is PART:
                held = getattr(self, name)
                if (held is None) != (snapshot[name] is None):
                    raise DataError(f"the state of {type(self).__name__} is of other settings: '{name}'")
                if held is not None:
                    held.restore(snapshot[name])
            else:
                setattr(self, name, snapshot[name])


@dataclass(frozen=True, slots=True)
class _ArrayKind:
    dtype: np.dtype[Any]
    shape: Shape


@dataclass(frozen=True, slots=True)
class _FixedKind:
    kinds: tuple[Kind, ...]


def array(dtype: DTypeLike, *shape: int | None) -> Kind:
    """Return the kind of arrays of a dtype and shape; None leaves a length free."""
    return _ArrayKind(np.dtype(dtype), shape)


def fixed(*kinds: Kind) -> Kind:
    """Return the kind of tuples of such members."""
    return _FixedKind(kinds)


def require(part: object, snapshot: object, kinds: Mapping[str, Kind]) -> None:
    """Hold a snapshot against the kinds of its values by name; raise `DataError` where one does not fit."""
    name = type(part).__name__
    if not isinstance(snapshot, dict) or snapshot.keys() != kinds.keys():
        raise DataError(f"the state of {name} does not have its {len(kinds)} values")
    for key, kind in kinds.items():
        if not _fits(snapshot[key], kind):
            raise DataError(f"the state of {name} has a {type(snapshot[key]).__name__} as '{key}' that is none")


def _taken(value: Any, kind: Kind) -> Any:  # noqa: ANN401 - whatever a part holds
    return value.snapshot() if kind is PART and value is not None else value


def _fits(value: object, kind: Kind) -> bool:
    if kind is PART:
        return value is None or isinstance(value, dict)
    if isinstance(kind, tuple):
        return any(_fits(value, one) for one in kind)
    if isinstance(kind, list):
        return type(value) in (list, tuple, deque) and all(_fits(item, kind[0]) for item in value)  # type: ignore[attr-defined]
    if isinstance(kind, dict):
        ((key_kind, item_kind),) = kind.items()
        return type(value) is dict and all(_fits(k, key_kind) and _fits(v, item_kind) for k, v in value.items())
    if isinstance(kind, _FixedKind):
        return type(value) is tuple and len(value) == len(kind.kinds) and all(map(_fits, value, kind.kinds))
    if isinstance(kind, _ArrayKind):
        return isinstance(value, np.ndarray) and value.dtype == kind.dtype and _shaped(value.shape, kind.shape)
    return value is None if kind is None else type(value) is kind


def _shaped(got: tuple[int, ...], shape: Shape) -> bool:
    return len(got) == len(shape) and all(want in (None, length) for want, length in zip(shape, got, strict=True))


def packed(value: object, records: Iterable[type]) -> tuple[Any, list[NDArray[Any]]]:
    """Return a value as JSON's own types and a list of arrays that these refer to.

    Parameters
    ----------
    value : object
        Such as a `Snapshot`.
    records : iterable of type
        Classes of the records in it.

    Raises
    ------
    TypeError
        Something in it is neither.
    """
    arrays: list[NDArray[Any]] = []
    return _tree(value, frozenset(records), arrays), arrays


def unpacked(tree: object, arrays: list[NDArray[Any]], records: Iterable[type]) -> Any:  # noqa: ANN401 - any value
    """Return what `packed` took apart.

    Raises
    ------
    ValueError, KeyError, IndexError, TypeError, DataError
        It was damaged since.
    """
    return _value(tree, arrays, {cls.__name__: cls for cls in records})


def _put(held: NDArray[Any], arrays: list[NDArray[Any]]) -> int:
    if held.dtype.kind not in "biufU":
        raise TypeError(f"an array of {held.dtype} has no place in a snapshot")
    arrays.append(held)
    return len(arrays) - 1


def _tree(value: object, records: frozenset[type], arrays: list[NDArray[Any]]) -> Any:  # noqa: ANN401
    kind = type(value)
    if value is None or kind in (bool, int, str):
        return value
    if isinstance(value, np.generic):
        return _tree(value.item(), records, arrays)
    if kind is float:
        return {"f": value.hex()}  # type: ignore[attr-defined]
    if isinstance(value, np.ndarray):
        return {"a": _put(value, arrays)}
    if kind is bytes:
        return {"b": _put(np.frombuffer(value, dtype=np.uint8), arrays)}  # type: ignore[call-overload]
    deeper = partial(_tree, records=records, arrays=arrays)
    if kind in (list, tuple, deque):
        items = _alike(value, arrays) or [deeper(item) for item in value]  # type: ignore[attr-defined]
        if kind is list:
            return items
        return {"t": items} if kind is tuple else {"q": items, "most": value.maxlen}  # type: ignore[attr-defined]
    if kind is dict:
        return {"m": [[deeper(k), deeper(v)] for k, v in value.items()]}  # type: ignore[attr-defined]
    if kind in records:
        return {"r": kind.__name__, "v": {f.name: deeper(getattr(value, f.name)) for f in fields(kind)}}  # type: ignore[arg-type]
    raise TypeError(f"a {kind.__name__} has no place in a snapshot")


def _alike(items: Any, arrays: list[NDArray[Any]]) -> dict[str, int] | None:  # noqa: ANN401 - a list, tuple or deque
    """Return one array in place of many numbers, or of many arrays of one shape; None where they are not alike."""
    kinds = set(map(type, items))
    if len(items) < _MANY or len(kinds) != 1:
        return None
    (kind,) = kinds
    if kind is np.ndarray:
        first = items[0]
        if any(item.shape != first.shape or item.dtype != first.dtype for item in items):
            return None
        return {"rows": _put(np.stack(list(items)), arrays)}
    if kind is int and all(-(1 << 63) <= item < 1 << 63 for item in items):
        return {"numbers": _put(np.array(items, dtype=np.int64), arrays)}
    if kind in (float, bool):
        return {"numbers": _put(np.array(items, dtype=kind), arrays)}
    return None


def _value(tree: Any, arrays: list[NDArray[Any]], records: Mapping[str, type]) -> Any:  # noqa: ANN401
    if tree is None or type(tree) in (bool, int, str):
        return tree
    deeper: Callable[[Any], Any] = partial(_value, arrays=arrays, records=records)
    if type(tree) is list:
        return [deeper(item) for item in tree]
    if type(tree) is not dict:
        raise ValueError("a value of no kind")
    match tree:
        case {"t": items}:
            return tuple(deeper(items))
        case {"q": items, "most": most}:
            return deque(deeper(items), maxlen=most)
        case {"m": list() as pairs}:
            return {deeper(key): deeper(item) for key, item in pairs}
        case {"r": name, "v": dict() as values}:
            cls = records[name]
            if values.keys() != {f.name for f in fields(cls)}:
                raise ValueError(f"a {name} of other fields")
            return cls(**{key: deeper(item) for key, item in values.items()})
    return _leaf(tree, arrays)


def _leaf(tree: dict[str, Any], arrays: list[NDArray[Any]]) -> Any:  # noqa: ANN401 - any value
    match tree:
        case {"f": str() as text}:
            return float.fromhex(text)
        case {"a": int() as number}:
            return arrays[number]
        case {"b": int() as number}:
            return arrays[number].tobytes()
        case {"rows": int() as number}:
            return list(arrays[number])
        case {"numbers": int() as number}:
            return arrays[number].tolist()
    raise ValueError("a value of no kind")


def write_snapshot(path: Path, about: Mapping[str, Any], snapshot: Snapshot, records: Iterable[type]) -> None:
    """Write a snapshot; the file is there whole or not at all, also after a power loss.

    Parameters
    ----------
    path : Path
    about : mapping
        What it is of, in JSON's own types.
    snapshot : Snapshot
    records : iterable of type
        Classes of the records in it.

    Raises
    ------
    OutputError
        The file cannot be written.
    """
    tree, arrays = packed(snapshot, records)
    texts = {name: np.frombuffer(json.dumps(text).encode(), np.uint8) for name, text in
             (("about", {"mark": _MARK, **about}), ("tree", tree))}  # fmt: skip
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        columns = {f"a{number}": held for number, held in enumerate(arrays)}
        np.savez(file, allow_pickle=False, **texts, **columns)  # type: ignore[arg-type, unused-ignore]
        file.flush()
        os.fsync(file.fileno())
    settle(path.parent)


def settle(path: Path) -> None:
    """Have the operating system put a file or folder on the disk itself, where it can."""
    with suppress(OSError):
        handle = os.open(path, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def read_snapshot(
    path: Path, records: Iterable[type], check: Callable[[Mapping[str, Any]], None] = lambda _: None
) -> tuple[dict[str, Any], Snapshot]:
    """Return what a snapshot is of, and the snapshot.

    Parameters
    ----------
    path : Path
    records : iterable of type
        Classes of the records that may be in it.
    check : callable
        Raises where what it is of is not what is wanted; called before anything else is looked at.

    Raises
    ------
    FormatError
        There is none, or it is damaged.
    """
    try:
        found = read_npz(path)
        about = json.loads(found["about"].tobytes())
        if about.pop("mark") != _MARK:
            raise FormatError(path, _NOT_WHOLE)
        check(about)
        arrays = [found[f"a{number}"] for number in range(len(found) - 2)]
        return about, unpacked(json.loads(found["tree"].tobytes()), arrays, records)
    except OSError as error:
        raise FormatError(path, f"cannot be read ({error.strerror or error}); check the path") from error
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError, DataError) as error:
        raise FormatError(path, f"{_NOT_WHOLE} ({' '.join(str(error).split())[:200]})") from error
