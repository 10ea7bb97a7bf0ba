"""Factors written by users: a class with a batched residual, evaluated for all its instances in one call."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from heliograph.arrays import Array
from heliograph.errors import GraphError
from heliograph.graph.model.differences import central_differences, keep_memory
from heliograph.graph.model.families import FAMILIES, Family, family_named, stacked
from heliograph.graph.model.kernels import Kernel
from heliograph.graph.model.noise import Noise
from heliograph.graph.model.records import FactorRecord, key_columns

__all__ = ["Factor"]

Namer = Callable[[int], str]

_MAX_VARIABLES = 8  # room in the native kernels


def _instance(index: int) -> str:
    return f"instance {index}"


class Factor(FactorRecord):
    """Base of a user's own factors.

    A subclass says which `variables` it joins, how many `rows` its residual has, and how to compute it for N instances
    at once. Matrices come as (N, k, k), directions as (N, 3), vectors as (N, d), and each datum with N in front.

    Parameters
    ----------
    *keys : int or (N,) int
        Which variables: one argument a variable, as for the built-in factors, or one tuple of all.
    data : sequence of lie values, arrays or numbers
        Handed to the residual after the variables. For int keys each datum is one instance's; for (N,) keys the first
        axis counts the instances. A single lie value or a number serves all.
    noise : Noise
        Noise of the residual.
    kernel : Kernel, optional
        For robust costs.

    Attributes
    ----------
    variables : tuple
        The lie class of each variable, such as ``SE3``, or the dimension of a vector; or a tuple of those, where it may
        be of any of them. The arrays' shapes then tell which it is.
    rows : int
        Rows of the residual.

    Raises
    ------
    GraphError
        The class lacks something, or keys and data do not fit it.

    Examples
    --------
    >>> class Distance(Factor):
    ...     variables = (2, 2)
    ...     rows = 1
    ...
    ...     @staticmethod
    ...     def residual(p_i, p_j, distance):  # (N, 2), (N, 2), (N,)
    ...         return np.linalg.norm(p_j - p_i, axis=-1, keepdims=True) - distance[:, None]
    >>> graph.add(Distance(0, 1, data=(3.0,), noise=Isotropic(0.1)))

    Notes
    -----
    An optional static ``jacobians`` takes the same arguments and returns one array (N, rows, dof) a variable, by right
    perturbation with the rotation first. Without it derivatives are central differences, with all perturbations of all
    instances stacked into one call of ``residual`` (of many, in several of 2^18 rows); so ``residual`` must treat every
    instance by itself.
    """

    __slots__ = ("data",)

    type: ClassVar[int] = 0
    variables: ClassVar[tuple[Any, ...]] = ()
    families: ClassVar[tuple[tuple[Family, ...], ...]] = ()  # of each variable, those that it may be of
    has_jacobians: ClassVar[bool] = False

    data: tuple[Array, ...]

    residual: ClassVar[Callable[..., Any]]
    jacobians: ClassVar[Callable[..., Any]]

    def __init_subclass__(cls, **options: object) -> None:
        super().__init_subclass__(**options)
        name = cls.__name__
        if not isinstance(cls.variables, tuple) or not 1 <= len(cls.variables) <= _MAX_VARIABLES:
            raise GraphError(
                f"class {name} needs `variables`: a tuple of 1 to {_MAX_VARIABLES} families, "
                "such as (SE3, SE3) or (SE2, 2)"
            )
        try:
            cls.families = tuple(
                tuple(family_named(one) for one in (variable if isinstance(variable, tuple) else (variable,)))
                for variable in cls.variables
            )
        except GraphError as error:
            raise GraphError(f"class {name}: {error}") from None
        rows = getattr(cls, "rows", None)
        if not isinstance(rows, int) or isinstance(rows, bool) or rows < 1:
            raise GraphError(f"class {name} needs `rows`: how many numbers its residual has, an int of at least 1")
        for method, needed in (("residual", True), ("jacobians", False)):
            found = inspect.getattr_static(cls, method, None)
            if found is None and not needed:
                continue
            if not isinstance(found, staticmethod):
                raise GraphError(
                    f"class {name} needs `{method}` as a @staticmethod of the variables' arrays and the data"
                )
        cls.has_jacobians = hasattr(cls, "jacobians")

    def __init__(
        self,
        *keys: ArrayLike | tuple[ArrayLike, ...],
        noise: Noise,
        data: Sequence[object] = (),
        kernel: Kernel | None = None,
    ) -> None:
        cls = type(self)
        if cls is Factor:
            raise GraphError("Factor is a base class: derive from it with `variables`, `rows` and `residual`")
        columns: tuple[Any, ...] = keys[0] if len(keys) == 1 and isinstance(keys[0], tuple) else keys
        if len(columns) != len(cls.families):
            raise GraphError(
                f"{cls.__name__} joins {len(cls.families)} variables, got keys for {len(columns)}; give one int or "
                f"(N,) ints a variable, {cls.__name__}({_key_names(len(cls.families))}, data=..., noise=...)"
            )
        single = all(np.ndim(column) == 0 for column in columns)
        array = key_columns(cls.__name__, columns)
        self._fill(
            keys=array,
            measurement=np.zeros((len(array), 0)),
            measured=None,
            noise=noise,
            kernel=kernel,
            allowed=cls.families,
        )
        if not isinstance(data, (tuple, list)):
            raise GraphError(f"{cls.__name__}: data is a tuple with one item an argument, not a {type(data).__name__}")
        items = tuple(_datum(cls.__name__, k, item, len(array), single) for k, item in enumerate(data))
        object.__setattr__(self, "data", items)
        try:
            inspect.signature(cls.residual).bind(*range(len(columns) + len(items)))
        except TypeError as error:
            raise GraphError(
                f"{cls.__name__}.residual does not take {len(columns)} variables and {len(items)} data: {error}"
            ) from None

    def flaws(self) -> NDArray[np.bool_]:
        """Return which instances (N,) have data that are not finite."""
        bad = np.zeros(len(self), dtype=bool)
        for item in self.data:
            bad |= ~np.isfinite(item.reshape(len(self), -1)).all(axis=1)
        return bad

    @classmethod
    def evaluate(
        cls,
        arrays: Sequence[Array],
        data: Sequence[Array],
        *,
        families: Sequence[Family] | None = None,
        name: Namer = _instance,
    ) -> tuple[Array, list[Array]]:
        """Return residuals and Jacobians of N instances.

        Parameters
        ----------
        arrays : sequence of (N, *shape) float64
            One a variable: matrices, directions or vectors.
        data : sequence of (N, ...) float64
            As given to the constructor.
        families : sequence of Family, optional
            The family of each variable; by default the first that it may be of.
        name : callable
            Gives what messages call the instance of an index.

        Returns
        -------
        residual : (N, rows) float64
        jacobians : list of (N, rows, dof) float64
            One a variable, by right perturbation.

        Raises
        ------
        GraphError
            What the class returns has another shape or is not finite.
        """
        keep_memory()
        families = families or [allowed[0] for allowed in cls.families]
        if not cls.has_jacobians:
            variables = len(families)
            copies, done = 1 + 2 * sum(family.dof for family in families), 0

            def stacked_residual(*stacks: Array) -> Array:
                nonlocal done
                first, count = done, len(stacks[0]) // copies
                done += count
                return cls._residuals(stacks[:variables], stacks[variables:], lambda row: name(first + row % count))

            return central_differences(stacked_residual, families, arrays, data)
        residual = cls.residuals(arrays, data, name=name)
        found = cls.jacobians(*arrays, *data)
        if not isinstance(found, (tuple, list)) or len(found) != len(families):
            given = f"{len(found)} of them" if isinstance(found, (tuple, list)) else f"a {type(found).__name__}"
            raise GraphError(f"{cls.__name__}.jacobians returns one array a variable, {len(families)}, got {given}")
        count = len(arrays[0])
        checked = [
            _checked(f"{cls.__name__}.jacobians, variable {k}", array, (count, cls.rows, family.dof), name)
            for k, (array, family) in enumerate(zip(found, families, strict=True))
        ]
        return residual, checked

    @classmethod
    def residuals(
        cls, arrays: Sequence[Array], data: Sequence[Array], *, name: Namer = _instance, finite: bool = True
    ) -> Array:
        """Return the residuals (N, rows) alone; parameters and errors as in `evaluate`.

        Without `finite`, numbers that are not finite are returned: a step may lead to where a residual is not defined.
        """
        keep_memory()
        return cls._residuals(arrays, data, name, finite)

    @classmethod
    def _residuals(cls, arrays: Sequence[Array], data: Sequence[Array], name: Namer, finite: bool = True) -> Array:
        found = cls.residual(*arrays, *data)
        return _checked(f"{cls.__name__}.residual", found, (len(arrays[0]), cls.rows), name, finite)


def _key_names(count: int) -> str:
    return ", ".join("ijklmnop"[:count])


def _checked(what: str, found: object, shape: tuple[int, ...], name: Namer, finite: bool = True) -> Array:
    """Return the array if its shape is right and, where asked for, all is finite."""
    array = np.asarray(found, dtype=np.float64)
    if array.shape != shape:
        raise GraphError(f"{what} must return shape {shape} for {shape[0]} instances, got {array.shape}")
    if finite and not np.isfinite(array).all():
        bad = ~np.isfinite(array.reshape(len(array), -1)).all(axis=1)
        raise GraphError(f"{what} is not finite for {name(int(np.argmax(bad)))}")
    return array


def _datum(kind: str, index: int, item: object, count: int, single: bool) -> Array:
    """Return a datum as an array with the instances in front, (count, ...)."""
    if type(item) in FAMILIES:
        elements = stacked(item)[0]
        if len(elements) not in (1, count):
            raise GraphError(f"{kind}: datum {index} is a batch of {len(elements)} for {count} instances")
        array = np.broadcast_to(elements, (count, *elements.shape[1:]))
    else:
        try:
            array = np.asarray(item, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise GraphError(f"{kind}: datum {index} is no array of numbers: {error}") from error
        if array.ndim == 0 or single:
            array = np.broadcast_to(array, (count, *array.shape))
        elif len(array) != count:
            raise GraphError(
                f"{kind}: datum {index} has shape {array.shape}; the first axis counts the {count} instances "
                "(np.broadcast_to repeats one for all)"
            )
    copy = np.array(array, dtype=np.float64, order="C")
    copy.flags.writeable = False
    return copy
