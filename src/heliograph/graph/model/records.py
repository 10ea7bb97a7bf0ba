"""What every record of factors has: keys, a packed measurement, noise and a kernel, checked when it is made."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from heliograph.arrays import Array, Keys
from heliograph.errors import GraphError
from heliograph.graph.model.families import Family, Value, stacked
from heliograph.graph.model.kernels import Kernel
from heliograph.graph.model.noise import Noise
from heliograph.graph.model.symbols import key_name

__all__ = ["FactorRecord", "NativeRecord", "as_keys", "as_measurement", "key_columns", "key_list"]


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
    arrays = [as_keys(column) for column in columns]
    if any(array.ndim > 1 for array in arrays):
        raise GraphError(f"{kind}: keys are one int or (N,) ints a variable, got {[array.shape for array in arrays]}")
    try:
        stack = np.stack(np.broadcast_arrays(*[np.atleast_1d(array) for array in arrays]), axis=-1)
    except ValueError:
        raise GraphError(f"{kind}: different numbers of keys a variable, {[array.shape for array in arrays]}") from None
    stack.flags.writeable = False
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
    return np.array(np.broadcast_to(packed, (count, packed.shape[1])), dtype=np.float64, order="C")


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

    __slots__ = ("allowed", "kernel", "keys", "measured", "measurement", "noise")

    type: ClassVar[int]  # by which the native side knows it

    keys: Keys
    measurement: Array
    noise: Noise
    kernel: Kernel | None
    measured: Family | None
    rows: int
    allowed: tuple[tuple[Family, ...], ...]

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
    ) -> None:
        if not isinstance(noise, Noise):
            raise GraphError(
                f"{self.kind}: its noise is a {type(noise).__name__}; use Isotropic, Diagonal, Covariance, ..."
            )
        if kernel is not None and not isinstance(kernel, Kernel):
            raise GraphError(f"{self.kind}: its kernel is a {type(kernel).__name__}; use None, Huber(width), ...")
        measurement.flags.writeable = False
        for name, value in (
            ("keys", keys),
            ("measurement", measurement),
            ("measured", measured),
            ("noise", noise),
            ("kernel", kernel),
            ("allowed", allowed),
        ):
            object.__setattr__(self, name, value)
        if rows is not None:
            object.__setattr__(self, "rows", rows)

    @classmethod
    def restored(cls, *, data: tuple[Array, ...] | None = None, **parts: Any) -> FactorRecord:  # noqa: ANN401
        """Return a record from its parts as they were, for archives: nothing is packed or normalised again.

        Parameters
        ----------
        data : tuple of (N, ...) float64, optional
            Data of a user's own factor.
        parts
            The other attributes by name; ``rows=None`` where the class says it.
        """
        record: FactorRecord = cls.__new__(cls)
        record._fill(**parts)
        if data is not None:
            object.__setattr__(record, "data", data)
        return record

    def __setattr__(self, name: str, value: object) -> None:
        raise AttributeError(f"a {self.kind} record cannot be changed; make another one")

    def __len__(self) -> int:
        return len(self.keys)

    def __repr__(self) -> str:
        return f"{self.kind}({len(self)} x {key_list(self.keys[0]) if len(self) else 'none'}, {self.noise!r:.60})"

    @property
    def kind(self) -> str:
        """What messages call it."""
        return type(self).__name__

    @property
    def arity(self) -> int:
        """Variables of one factor."""
        return int(self.keys.shape[1])

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


class NativeRecord(FactorRecord):
    """A record of built-in factors."""

    __slots__ = ("rows",)
