"""Arrays at the boundary: their types, the checks of what comes from outside, and the freezing of records.

What a caller hands in is checked once, where it comes in; what does not fit is a `DataError` that names the argument,
what it was and what was wanted. Loops inside, which hold checked arrays, call the kernels themselves.
"""

from __future__ import annotations

import math
from typing import Any, ClassVar, Protocol, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from heliograph.errors import DataError

__all__ = [
    "Array",
    "Indices",
    "Keys",
    "Mask",
    "Points",
    "Shape",
    "Stamps",
    "as_array",
    "as_batch",
    "as_numbers",
    "as_points",
    "as_pose",
    "as_real",
    "as_stamps",
    "broadcast",
    "freeze",
    "frozen",
    "match",
    "require_finite",
]

Array: TypeAlias = NDArray[np.float64]
Points: TypeAlias = NDArray[np.float32]
"""(N, 3), C-contiguous [m]."""
Stamps: TypeAlias = NDArray[np.int64]
"""(N,) [ns]."""
Indices: TypeAlias = NDArray[np.int64]
Keys: TypeAlias = NDArray[np.int64]
"""(N,), the variables of a graph."""
Mask: TypeAlias = NDArray[np.bool_]
Shape: TypeAlias = tuple[int | None, ...]
"""Required shape of an array; None leaves a length free."""

_ARRAY, _put = np.ndarray, object.__setattr__
_FLOAT32, _FLOAT64 = np.dtype(np.float32), np.dtype(np.float64)


def _wanted(shape: Shape) -> str:
    lengths = ["N" if n is None else str(n) for n in shape]
    return "(" + ", ".join(lengths) + ("," if len(lengths) == 1 else "") + ")"


def _fits(got: tuple[int, ...], shape: Shape) -> bool:
    if len(got) != len(shape):
        return False
    return all(want is None or want == length for want, length in zip(shape, got, strict=True))


def _array_of(name: str, value: ArrayLike | None, wanted: str) -> NDArray[Any]:
    """Return the argument as an array of real numbers or truth values, if it is one."""
    try:
        array: NDArray[Any] = np.asarray(value)
    except (TypeError, ValueError) as error:
        raise DataError(f"{name} is a {type(value).__name__} that makes no array ({error}); give {wanted}") from error
    if array.dtype.kind not in "fiub":
        raise DataError(f"{name} has dtype {array.dtype}, expected {wanted}; convert it explicitly")
    return array


def as_array(name: str, value: ArrayLike | None, dtype: DTypeLike, shape: Shape) -> NDArray[Any]:
    """Return a C-contiguous array of exactly this dtype and shape; the argument itself where it is one.

    Parameters
    ----------
    name : str
        The argument's name, for the message.
    value : array_like
        Already of the right dtype: a silent conversion would hide a wrong unit or lose digits, so it is an error.
    dtype : dtype
        Required dtype, in the machine's byte order.
    shape : tuple
        Required shape; None leaves a length free.

    Raises
    ------
    DataError
        Another dtype or shape, or no array at all.
    """
    dtype = np.dtype(dtype)
    array = value if type(value) is _ARRAY else _array_of(name, value, f"{_wanted(shape)} {dtype}")
    if array.dtype != dtype:
        raise DataError(f"{name} has dtype {array.dtype}, expected {_wanted(shape)} {dtype}; convert it explicitly")
    if array.shape != shape and not _fits(array.shape, shape):
        raise DataError(f"{name} has shape {array.shape}, expected {_wanted(shape)} {dtype}")
    flags = array.flags
    return array if flags.c_contiguous and flags.aligned else np.array(array, order="C")


def as_points(name: str, value: ArrayLike | None) -> Points:
    """Return a cloud, (N, 3) float32 and C-contiguous; the argument itself where it is one.

    Coordinates may be NaN or infinite, as drivers mark pulses without a return: each function says what it does then.

    Raises
    ------
    DataError
        Another dtype or shape, or no array at all.
    """
    if (
        type(value) is _ARRAY
        and value.dtype is _FLOAT32
        and value.ndim == 2
        and value.shape[1] == 3
        and value.flags.c_contiguous
    ):
        return value
    return as_array(name, value, _FLOAT32, (None, 3))


def as_pose(name: str, value: ArrayLike | None) -> Array:
    """Return a finite motion, (4, 4) float64 and C-contiguous; the argument itself where it is one.

    Raises
    ------
    DataError
        Another dtype or shape, numbers that are not finite, or no array at all.
    """
    if not (type(value) is _ARRAY and value.dtype is _FLOAT64 and value.shape == (4, 4) and value.flags.c_contiguous):
        value = as_array(name, value, _FLOAT64, (4, 4))
    return require_finite(name, value)


def as_batch(name: str, value: ArrayLike | None, tail: tuple[int, ...]) -> Array:
    """Return real numbers (..., *tail) as float64: one element or a batch of them.

    Integers and other floats are converted, so that ``so3.exp([0, 0, 1])`` works. Numbers that are not finite pass: the
    element that they stand in is then not finite either, and its neighbours are as if alone.

    Raises
    ------
    DataError
        Another shape, or no array of real numbers.
    """
    if type(value) is _ARRAY and value.dtype is _FLOAT64 and value.shape[-len(tail) :] == tail:
        return value
    wanted = f"real numbers (..., {', '.join(map(str, tail))})"
    array = _numbers(name, value, wanted)
    if array.shape[-len(tail) :] != tail:
        raise DataError(f"{name} has shape {array.shape}, expected {wanted}")
    return array


def as_numbers(name: str, value: ArrayLike | None) -> Array:
    """Return real numbers of any shape as float64; see `as_batch`."""
    return _numbers(name, value, "real numbers")


def as_real(name: str, value: ArrayLike | None) -> NDArray[Any]:
    """Return real numbers of any shape in their own dtype; see `as_batch`."""
    return _array_of(name, value, "real numbers")


def _numbers(name: str, value: ArrayLike | None, wanted: str) -> Array:
    array = _array_of(name, value, wanted)
    if array.dtype.kind == "b":
        raise DataError(f"{name} has dtype {array.dtype}, expected {wanted}; convert it explicitly")
    return np.asarray(array, dtype=np.float64)


def broadcast(names: str, *batches: tuple[int, ...]) -> tuple[int, ...]:
    """Return the common shape of batches that belong together.

    Parameters
    ----------
    names : str
        The arguments' names, for the message.
    *batches : tuple
        Leading shapes.

    Raises
    ------
    DataError
        They do not broadcast.
    """
    if batches[0] == batches[-1] and len(set(batches)) == 1:
        return batches[0]
    try:
        return np.broadcast_shapes(*batches)
    except ValueError:
        raise DataError(
            f"the batches of {names} have shapes {', '.join(map(str, batches))}; they must broadcast"
        ) from None


def match(names: str, first: tuple[int, ...], second: tuple[int, ...]) -> None:
    """Raise `DataError` if two shapes do not broadcast; of matrices of one size the whole shapes may be given."""
    if first != second:
        broadcast(names, first, second)


def as_stamps(name: str, value: ArrayLike | None) -> Stamps:
    """Return times in whole nanoseconds as int64, of any shape; integers of other widths are converted.

    Raises
    ------
    DataError
        Floats, which hold no date to the nanosecond, or no array of integers.
    """
    wanted = "whole nanoseconds, int64"
    array = _array_of(name, value, wanted)
    if array.dtype.kind not in "iu" and array.size > 0:
        raise DataError(f"{name} has dtype {array.dtype}, expected {wanted}; convert it explicitly")
    return np.asarray(array, dtype=np.int64)


def require_finite(name: str, array: Array) -> Array:
    """Return the array, or raise `DataError` that counts its NaN and infinities."""
    # One dot product is a fifth of the price of isfinite; squares that overflow are looked at again.
    if not math.isfinite(np.vdot(array, array)) and not np.isfinite(array).all():
        count = int(np.count_nonzero(~np.isfinite(array)))
        raise DataError(f"{name} holds {count} values that are not finite, expected none of its {array.size}")
    return array


def frozen(name: str, value: ArrayLike, dtype: DTypeLike, shape: Shape, *, finite: bool = False) -> NDArray[Any]:
    """Return a read-only C-contiguous view of ``value``, or raise `DataError` if it is not what the record promises.

    Parameters
    ----------
    name : str
        The field's name, for the message.
    value : array_like
        Already of the right dtype: a silent conversion would hide a wrong unit, so it is an error.
    dtype : dtype
        Required dtype.
    shape : tuple
        Required shape; None leaves a length free.
    finite : bool
        Refuse NaN and infinity.
    """
    array = as_array(name, value, dtype, shape)
    if finite:
        require_finite(name, array)
    return _read_only(array)


def _read_only(array: NDArray[Any]) -> NDArray[Any]:
    view: NDArray[Any] = array.view()
    view.setflags(False)  # type: ignore[call-arg]  # by position: three times as quick as by name
    return view


_HOLDERS: dict[type, tuple[str, ...]] = {}  # by class: fields that may hold arrays
_PLAIN = frozenset({"int", "float", "bool", "str", "int | None", "float | None", "bool | None", "str | None"})


class _Record(Protocol):
    __dataclass_fields__: ClassVar[dict[str, Any]]


def freeze(record: _Record) -> None:
    """Make every array of a frozen record read-only; those in its tuples and mappings too.

    A record's ``__post_init__`` calls it. The field becomes a view: nothing is copied, and whoever made the array may
    still write to the one that he holds, which is why makers whose array lives on hand in a copy.
    """
    cls = record.__class__
    names = _HOLDERS.get(cls)
    if names is None:
        names = _HOLDERS[cls] = tuple(n for n, f in cls.__dataclass_fields__.items() if f.type not in _PLAIN)
    for name in names:
        value = getattr(record, name)
        kind = type(value)
        if kind is _ARRAY:
            if value.flags.writeable:
                _put(record, name, _read_only(value))
        elif kind is tuple:
            if any(type(item) is _ARRAY for item in value):
                _put(record, name, tuple(map(_read_only_item, value)))
        elif kind is dict and any(type(item) is _ARRAY for item in value.values()):
            _put(record, name, {key: _read_only_item(item) for key, item in value.items()})


def _read_only_item(item: object) -> object:
    return _read_only(item) if type(item) is np.ndarray else item
