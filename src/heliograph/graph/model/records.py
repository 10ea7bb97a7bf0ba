"""What every record of factors has: keys, a packed measurement, noise and a kernel, checked when it is made."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from heliograph import _core
from heliograph.arrays import Array, Keys
from heliograph.errors import GraphError
from heliograph.graph.model.families import FAMILIES, Family, Value, as_single, stacked
from heliograph.graph.model.kernels import Kernel
from heliograph.graph.model.noise import SCALAR, Noise
from heliograph.graph.model.symbols import key_name
from heliograph.lie import S2

__all__ = [
    "FactorRecord",
    "NativeRecord",
    "as_keys",
    "as_measurement",
    "joined_keys",
    "joined_measurements",
    "key_columns",
    "key_list",
    "plain_key",
]

_LIMIT = 1 << 63  # of keys


def as_keys(keys: ArrayLike) -> Keys:
    """Return keys as int64, of any shape.

    Raises
    ------
    GraphError
        They are not integers, or do not fit in 64 bits.
    """
    array = np.asarray(keys)
    if array.size == 0 and array.dtype == np.float64:  # an empty list has no type of its own
        return np.zeros(array.shape, dtype=np.int64)
    if array.dtype.kind not in "iu":
        raise GraphError(f"keys are integers, got {array.dtype} ({np.array2string(array.ravel()[:3])} ...)")
    if array.dtype == np.uint64 and array.size and int(array.max()) > np.iinfo(np.int64).max:
        raise GraphError(f"key {int(array.max())} does not fit in 64 bits with a sign")
    return array.astype(np.int64, copy=False)


def key_list(keys: ArrayLike, max_keys: int = 8) -> str:
    """Return ``key 3`` or ``keys 3, 4`` for a message, cut off after ``max_keys``."""
    some = np.atleast_1d(np.asarray(keys)).tolist()
    more = f" ... ({len(some)} in all)" if len(some) > max_keys else ""
    return ("key " if len(some) == 1 else "keys ") + ", ".join(map(key_name, some[:max_keys])) + more


def key_columns(kind: str, columns: tuple[ArrayLike, ...]) -> Keys:
    """Return the keys (N, arity), read-only, of one int or (N,) ints a variable; one key serves all.

    Raises
    ------
    GraphError
        Not integers, more than one axis, or different numbers of them.
    """
    if all(map(plain_key, columns)):
        single = np.array([columns], dtype=np.int64)
        single.setflags(write=False)
        return single
    arrays = [as_keys(column) for column in columns]
    if any(array.ndim > 1 for array in arrays):
        raise GraphError(f"{kind}: keys are one int or (N,) ints a variable, got {[array.shape for array in arrays]}")
    count = max(array.size for array in arrays)
    if any(array.size not in (1, count) for array in arrays):
        raise GraphError(f"{kind}: different numbers of keys a variable, {[array.shape for array in arrays]}")
    stack = np.empty((count, len(arrays)), dtype=np.int64)
    for k, array in enumerate(arrays):
        stack[:, k] = array
    stack.setflags(write=False)
    return stack


def as_measurement(kind: str, value: Value, count: int) -> tuple[Array, Family]:
    """Return packed measurements (count, m) and their family; a single one serves all.

    Raises
    ------
    GraphError
        Another number of measurements than of factors.
    """
    elements, family, _ = stacked(value)
    return _spread(kind, family.pack_elements(elements), count), family


def _spread(kind: str, packed: Array, count: int) -> Array:
    if len(packed) != count and len(packed) != 1:
        raise GraphError(f"{kind}: {len(packed)} measurements for {count} factors; give one each, or one for all")
    spread = np.empty((count, packed.shape[1]))
    spread[:] = packed
    return spread


class FactorRecord:
    """N factors of one kind, added to a graph in one call. Read-only.

    Attributes
    ----------
    keys : (N, arity) int64
        Keys of the variables.
    measurement : (N, m) float64
        Packed as the native side reads it.
    rows : int
        Rows of one residual.
    noise : Noise
        One, or one each.
    kernel : Kernel or None
        For each factor's whitened length.
    allowed : tuple of tuples of Family
        Families that each variable may have.
    """

    __slots__ = ("allowed", "kernel", "keys", "measured", "measurement", "noise", "single", "sound")

    type: ClassVar[int]  # by which the native side knows it

    keys: Keys
    measurement: Array
    noise: Noise
    kernel: Kernel | None
    measured: Family | None
    rows: int
    allowed: tuple[tuple[Family, ...], ...]
    sound: bool  # keys and measurement have been looked at already
    single: tuple[tuple[int, ...], Value] | None  # keys and value of one factor: packed when they are asked for

    def _fill(
        self,
        *,
        keys: Keys,
        measurement: Array,
        measured: Family | None,
        rows: int | None = None,  # None: the class says
        noise: Noise,
        kernel: Kernel | None,
        allowed: tuple[tuple[Family, ...], ...],
        sound: bool = False,
    ) -> None:
        if not isinstance(noise, Noise):
            raise GraphError(
                f"{self.kind}: its noise is a {type(noise).__name__}; use Isotropic, Diagonal, Covariance, ..."
            )
        if kernel is not None and not isinstance(kernel, Kernel):
            raise GraphError(f"{self.kind}: its kernel is a {type(kernel).__name__}; use None, Huber(width), ...")
        measurement.setflags(write=False)
        give = object.__setattr__  # one by one: a loop over pairs would take as long as all the rest of one factor
        give(self, "keys", keys)
        give(self, "measurement", measurement)
        give(self, "measured", measured)
        give(self, "noise", noise)
        give(self, "kernel", kernel)
        give(self, "allowed", allowed)
        give(self, "sound", sound)
        give(self, "single", None)
        if rows is not None:
            give(self, "rows", rows)

    @classmethod
    def restored(cls, *, data: tuple[Array, ...] | None = None, **parts: Any) -> FactorRecord:  # noqa: ANN401
        """Return a record from its parts as they were, for archives: nothing is packed or normalised again.

        Parameters
        ----------
        data : tuple of (N, ...) float64, optional
            Data of a user's own factor.
        parts
            The other attributes by name; ``rows=None`` where the class says it.

        Raises
        ------
        ValueError
            Keys, measurement and data are not of as many factors.
        """
        keys, measurement = parts["keys"], parts["measurement"]
        if measurement.ndim != 2 or any(len(array) != len(keys) for array in (measurement, *(data or ()))):
            raise ValueError(f"{len(keys)} factors with a measurement of {measurement.shape}")
        record: FactorRecord = cls.__new__(cls)
        record._fill(**parts)
        if data is not None:
            object.__setattr__(record, "data", data)
        return record

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401
        """Pack a single factor's keys and measurement; only called for what has not been set."""
        if name not in ("keys", "measurement") or self.single is None:
            raise AttributeError(f"{type(self).__name__} has no {name}")
        keys, value = self.single
        array = np.array([keys], dtype=np.int64) if name == "keys" else as_single(value)[0]  # type: ignore[index]
        array.setflags(write=False)
        object.__setattr__(self, name, array)
        return array

    def __setattr__(self, name: str, value: object) -> None:
        raise AttributeError(f"a {self.kind} record cannot be changed; make another one")

    def __len__(self) -> int:
        return len(self.keys) if self.single is None else 1

    def __repr__(self) -> str:
        return f"{self.kind}({len(self)} x {key_list(self.keys[0]) if len(self) else 'none'}, {self.noise!r:.60})"

    @property
    def kind(self) -> str:
        """What messages call it."""
        return type(self).__name__

    @property
    def arity(self) -> int:
        """Variables of one factor."""
        return int(self.keys.shape[1]) if self.single is None else len(self.single[0])

    def flat_keys(self) -> list[int]:
        """Return the keys of its variables, one factor after the other."""
        return list(self.single[0]) if self.single is not None else self.keys.ravel().tolist()

    @property
    def width(self) -> int:
        """Doubles of one measurement."""
        return self.measurement.shape[1] if self.single is None else self.measured.storage  # type: ignore[union-attr]

    def flaws(self) -> NDArray[np.bool_]:
        """Return which measurements (N,) are not finite or not on their manifold."""
        if self.measured is None:
            return np.asarray(~np.isfinite(self.measurement).all(axis=1))
        return self.measured.off_manifold(self.measured.elements(self.measurement))

    def mismatch(self, families: tuple[Family, ...]) -> str | None:
        """Return what is wrong with variables of these families, or None."""
        if all(family in allowed for family, allowed in zip(families, self.allowed, strict=True)):
            return None
        wanted = ", ".join(" or ".join(family.name for family in allowed) for allowed in self.allowed)
        return f"{self.kind} needs {wanted}, but its variables are {', '.join(family.name for family in families)}"


def joined_keys(records: Sequence[FactorRecord]) -> Keys:
    """Return the keys (N, arity) of records one after another."""
    singles = [record.single for record in records]
    if len(singles) > 1 and None not in singles:
        return np.array([single[0] for single in singles if single is not None], dtype=np.int64)
    arrays = [record.keys for record in records]
    return arrays[0] if len(arrays) == 1 else np.concatenate(arrays)


def joined_measurements(records: Sequence[FactorRecord]) -> Array:
    """Return the measurements (N, m) of records of one kind one after another."""
    family = records[0].measured
    values = [record.single[1] for record in records if record.single is not None]
    if family is not None and len(values) == len(records) > 1:
        return family.pack_elements(np.array([value.vector if family.lie is S2 else value.matrix for value in values]))
    arrays = [record.measurement for record in records]
    return arrays[0] if len(arrays) == 1 else np.concatenate(arrays)


def plain_key(key: object) -> bool:
    """Return whether a key is an int of 64 bits: nothing to be checked or converted."""
    return type(key) is int and -_LIMIT <= key < _LIMIT


class NativeRecord(FactorRecord):
    """A record of factors that are evaluated natively."""

    __slots__ = ("rows",)

    def _fill_single(
        self,
        keys: tuple[object, ...],
        value: Value,
        noise: Noise,
        kernel: Kernel | None,
        allowed: Mapping[type[Any], tuple[tuple[Family, ...], ...]],
    ) -> bool:
        """Fill a record of one factor with a lie value if nothing about it needs a closer look; return whether it was.

        What is added one by one would spend its time on arrays of one element.
        """
        lie = type(value)
        if lie not in allowed or not isinstance(noise, Noise) or not (kernel is None or isinstance(kernel, Kernel)):
            return False
        for key in keys:
            if type(key) is not int or not -_LIMIT <= key < _LIMIT:
                return False
        family = FAMILIES[lie]
        elements = value.vector if lie is S2 else value.matrix
        itself = len(keys) > 1 and keys[0] == keys[1]
        if itself or elements.ndim != len(family.shape) or not _core.is_sound(family.code, elements):
            return False
        give = object.__setattr__
        give(self, "single", (keys, value))
        give(self, "sound", True)
        give(self, "measured", family)
        give(self, "rows", family.dof)
        give(self, "noise", noise)
        give(self, "kernel", kernel)
        give(self, "allowed", allowed[lie])
        return True

    def evaluate(self, *variables: Value) -> tuple[Array, tuple[Array, ...]]:
        """Return the factors' residuals and Jacobians at values of their variables; keys and noise play no part.

        Parameters
        ----------
        *variables : lie value or (d,) or (N, d) float64
            One a variable of the factor: a batch of N, or one value that serves all.

        Returns
        -------
        residual : (N, rows) float64
            Not whitened.
        jacobians : tuple of (N, rows, dof) float64
            One a variable, by right perturbation, rotation first.

        Raises
        ------
        GraphError
            Another number of variables or values, or a family that the factor does not take.
        """
        count = len(self)
        if len(variables) != self.arity:
            raise GraphError(f"{self.kind} joins {self.arity} variables, got values of {len(variables)}")
        elements, families = zip(*[stacked(value)[:2] for value in variables], strict=True)
        fault = self.mismatch(families)
        if fault is not None:
            raise GraphError(fault)
        packed = [_spread(self.kind, f.pack_elements(e), count) for e, f in zip(elements, families, strict=True)]
        none = np.empty(0)
        residual, _, jacobians, *_ = _core.evaluate_factors(
            self.type,
            np.array([(family.code, family.dof, count) for family in families], dtype=np.int64),
            np.concatenate([part.reshape(-1) for part in packed]),
            np.ascontiguousarray(np.arange(count * self.arity, dtype=np.int32).reshape(self.arity, count).T),
            self.rows,
            self.measurement.reshape(-1),
            SCALAR,
            True,
            np.ones(1),
            0,
            1.0,
            none,
            none,
            none,
        )
        return residual, tuple(jacobians)
