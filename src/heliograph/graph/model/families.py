"""The families a variable can belong to: vectors, rotations, motions, directions and extended poses."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from heliograph import _core
from heliograph.arrays import Array
from heliograph.errors import GraphError
from heliograph.lie import S2, SE2, SE3, SO2, SO3, ExtendedPose
from heliograph.lie import s2 as s2_ops

__all__ = [
    "FAMILIES",
    "LARGEST_VECTOR",
    "Family",
    "Value",
    "as_single",
    "family_named",
    "family_of",
    "lone_value",
    "stacked",
    "vectors",
]

Value: TypeAlias = Any  # a lie value (one or a batch), or an array of vectors (..., d)

LARGEST_VECTOR = 16  # degrees of freedom of one variable that the native kernels have room for

_SIZES = range(1, LARGEST_VECTOR + 1)

# How far from a rotation or a unit vector a value may be. Files print six digits, so rounding stays far below.
_OFF_MANIFOLD = 1e-3


@dataclass(frozen=True, slots=True, kw_only=True)
class Family:
    """A kind of variable, and how its values lie in memory.

    Parameters
    ----------
    name : str
        As messages call it.
    code : int
        Number by which the native side knows it.
    dof : int
        Dimension of the tangent space; perturbations are on the right, rotation first.
    storage : int
        Doubles of one packed value.
    shape : tuple of int
        Shape of one value as an array: a matrix, or a vector.
    lie : type or None
        The class of its values; None for plain vectors.
    space : int
        Dimension of the space in which the value has a position; 0: it has none.
    """

    name: str
    code: int
    dof: int
    storage: int
    shape: tuple[int, ...]
    lie: type[Any] | None
    space: int
    packer: Callable[[Array], Array] = field(repr=False, compare=False)
    opener: Callable[[Array], Array] = field(repr=False, compare=False)
    flaw: Callable[[Array], Array] = field(repr=False, compare=False)

    def __hash__(self) -> int:  # of all fields it would be slow, and families are looked up for every factor
        return 32 * self.code + self.dof

    def pack_elements(self, elements: Array) -> Array:
        """Return the packed form (N, storage), C-contiguous, of values as arrays (N, *shape)."""
        return np.ascontiguousarray(self.packer(elements))

    def elements(self, packed: Array) -> Array:
        """Return values as arrays (N, *shape) from their packed form (N, storage)."""
        return self.opener(packed)

    def pack(self, value: Value) -> Array:
        """Return the packed form (N, storage) float64, C-contiguous; one value gives N = 1."""
        return self.pack_elements(stacked(value)[0])

    def unpack(self, packed: Array) -> Value:
        """Return the lie value (a batch of N), or the array (N, d), of a packed form (N, storage)."""
        return self.wrap(self.elements(np.asarray(packed, dtype=np.float64)))

    def wrap(self, elements: Array) -> Value:
        """Return the lie value of arrays (..., *shape); vectors are returned as they are."""
        return elements if self.lie is None else self.lie(elements)

    def retract(self, elements: Array, delta: ArrayLike) -> Array:
        """Return the arrays (N, *shape) moved by tangent vectors (N, dof) on the right."""
        if self.lie is None:
            return np.asarray(elements + np.asarray(delta, dtype=np.float64))
        ops = s2_ops if self.lie is S2 else self.lie.ops
        return np.asarray(ops.retract(elements, delta), dtype=np.float64)

    def local(self, elements: Array, others: Array) -> Array:
        """Return the tangent vectors (N, dof) that `retract` the first arrays (N, *shape) to the second."""
        if self.lie is None:
            return others - elements
        ops = s2_ops if self.lie is S2 else self.lie.ops
        return np.asarray(ops.local(elements, others), dtype=np.float64)

    def off_manifold(self, elements: Array) -> NDArray[np.bool_]:
        """Return which of the arrays (N, *shape) are not finite or not on the manifold, (N,)."""
        distance = self.flaw(elements)
        return np.asarray(~(distance <= _OFF_MANIFOLD))


def _finite(elements: Array) -> Array:
    return np.where(np.isfinite(elements).all(axis=tuple(range(1, elements.ndim))), 0.0, np.inf)


def _skewness(elements: Array, size: int) -> Array:
    """Return how far the leading blocks (N, size, size) are from rotations; not finite where any number is not."""
    R = elements[:, :size, :size]
    with np.errstate(all="ignore"):
        if size == 2:
            c, s = R[:, 0, 0], R[:, 1, 0]
            off = np.abs(c - R[:, 1, 1]) + np.abs(s + R[:, 0, 1]) + np.abs(c * c + s * s - 1.0)
        else:
            off = np.abs(np.einsum("nij,nik->njk", R, R) - np.eye(3)).max(axis=(1, 2))
            off += np.abs(np.linalg.det(R) - 1.0)
    return np.asarray(off + _finite(elements[:, :size, size:]), dtype=np.float64)


def _pack_planar(m: Array) -> Array:
    out = np.empty((len(m), 2 if m.shape[-1] == 2 else 4))
    out[:, 0], out[:, 1] = m[:, 0, 0], m[:, 1, 0]
    if m.shape[-1] == 3:
        out[:, 2], out[:, 3] = m[:, 0, 2], m[:, 1, 2]
    return out


def _open_planar(packed: Array) -> Array:
    size = 2 if packed.shape[-1] == 2 else 3
    out = np.zeros((len(packed), size, size))
    out[:, 0, 0] = out[:, 1, 1] = packed[:, 0]
    out[:, 1, 0] = packed[:, 1]
    out[:, 0, 1] = -packed[:, 1]
    if size == 3:
        out[:, 0, 2], out[:, 1, 2] = packed[:, 2], packed[:, 3]
        out[:, 2, 2] = 1.0
    return out


def _pack_spatial(m: Array) -> Array:
    """Return the rotation row by row, then each further column."""
    rotation = m[:, :3, :3].reshape(len(m), 9)
    columns = np.swapaxes(m[:, :3, 3:], 1, 2).reshape(len(m), -1)
    return np.concatenate([rotation, columns], axis=1)


def _open_spatial(packed: Array) -> Array:
    size = packed.shape[-1] // 3
    out = np.zeros((len(packed), size, size))
    out[:, :3, :3] = packed[:, :9].reshape(-1, 3, 3)
    out[:, :3, 3:] = np.swapaxes(packed[:, 9:].reshape(len(packed), size - 3, 3), 1, 2)
    for k in range(3, size):
        out[:, k, k] = 1.0
    return out


def _same(elements: Array) -> Array:
    return elements


def _matrix_family(lie: type[Any], code: int, storage: int, space: int) -> Family:
    turns = 2 if storage <= 4 else 3
    return Family(
        name=lie.__name__,
        code=code,
        dof=lie.dof,
        storage=storage,
        shape=(lie.size, lie.size),
        lie=lie,
        space=space,
        packer=_pack_planar if turns == 2 else _pack_spatial,
        opener=_open_planar if turns == 2 else _open_spatial,
        flaw=functools.partial(_skewness, size=turns),
    )


def _direction_flaw(elements: Array) -> Array:
    clean = np.where(np.isfinite(elements), elements, 0.0)
    return np.asarray(np.abs(np.einsum("ni,ni->n", clean, clean) - 1.0) + _finite(elements), dtype=np.float64)


_S2 = Family(
    name="S2", code=5, dof=2, storage=3, shape=(3,), lie=S2, space=0, packer=_same, opener=_same, flaw=_direction_flaw
)

FAMILIES: dict[type[Any], Family] = {
    SO2: _matrix_family(SO2, 1, 2, 0),
    SO3: _matrix_family(SO3, 2, 9, 0),
    SE2: _matrix_family(SE2, 3, 4, 2),
    SE3: _matrix_family(SE3, 4, 12, 3),
    S2: _S2,
    ExtendedPose: _matrix_family(ExtendedPose, 6, 15, 3),
}


@functools.cache
def vectors(dimension: int) -> Family:
    """Return the family of vectors of a dimension.

    Raises
    ------
    GraphError
        The dimension is not between 1 and 16.
    """
    if not 1 <= dimension <= LARGEST_VECTOR:
        raise GraphError(
            f"a vector variable has 1 to {LARGEST_VECTOR} dimensions, not {dimension}; split it into several variables"
        )
    return Family(
        name=f"vectors of dimension {dimension}",
        code=0,
        dof=dimension,
        storage=dimension,
        shape=(dimension,),
        lie=None,
        space=dimension if dimension in (2, 3) else 0,
        packer=_same,
        opener=_same,
        flaw=_finite,
    )


def family_named(name: object) -> Family:
    """Return the family of a lie class such as ``SE3``, or of vectors by their dimension.

    Raises
    ------
    GraphError
        It is neither.
    """
    if isinstance(name, Family):
        return name
    if isinstance(name, (int, np.integer)) and not isinstance(name, bool):
        return vectors(int(name))
    if isinstance(name, type):
        for lie in name.__mro__:
            if lie in FAMILIES:
                return FAMILIES[lie]
    known = ", ".join(lie.__name__ for lie in FAMILIES)
    raise GraphError(f"{name!r} is no family of variables; use one of {known}, or the dimension of a vector")


def family_of(value: Value) -> Family:
    """Return the family of a lie value, or of an array of vectors (..., d) by its last axis."""
    return stacked(value)[1]


def stacked(value: Value) -> tuple[Array, Family, bool]:
    """Return a value as a batch of arrays (N, *shape), its family, and whether it was a single one.

    Raises
    ------
    GraphError
        More than one leading axis, or not a value at all.
    """
    if type(value) in FAMILIES:
        elements, family = value.vector if isinstance(value, S2) else value.matrix, FAMILIES[type(value)]
    else:
        try:
            elements = np.asarray(value, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise GraphError(f"a {type(value).__name__} is no value of a variable: {error}") from error
        if elements.ndim == 0:
            elements = elements[None]
        family = vectors(elements.shape[-1])
    single = elements.ndim == len(family.shape)
    if not single and elements.ndim != len(family.shape) + 1:
        raise GraphError(
            f"values of {family.name} need the shape {family.shape} or (N, {', '.join(map(str, family.shape))}), "
            f"got {elements.shape}"
        )
    return (elements[None] if single else elements), family, single


def as_single(value: Value) -> tuple[Array, Family] | None:
    """Return the packed form (1, storage) and the family of one sound value; None for what needs a closer look.

    What is added one by one would spend its time on arrays of one element.
    """
    lone = lone_value(value)
    if lone is None:
        return None
    elements, family = lone
    packed = np.empty((1, family.storage))
    return (packed, family) if _core.pack_single(family.code, elements, packed) else None


def lone_value(value: Value) -> tuple[Array, Family] | None:
    """Return the array (*shape) and the family of what is plainly one value, finite or not; else None."""
    family = FAMILIES.get(type(value))
    if family is not None:
        elements = value.vector if family.lie is S2 else value.matrix
        return (elements, family) if elements.ndim == len(family.shape) else None
    if (
        type(value) is np.ndarray
        and value.ndim == 1
        and value.dtype == np.float64
        and 1 <= len(value) <= LARGEST_VECTOR
    ):
        return value, vectors(len(value))
    return None
