"""Noise of factors: how a residual is weighed. Each gives S with ``r_white = S r``, so ``S' S`` is the information."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from heliograph import _core
from heliograph.arrays import Array, freeze
from heliograph.errors import GraphError

__all__ = [
    "DIAGONAL",
    "FULL",
    "SCALAR",
    "Constrained",
    "Covariance",
    "Diagonal",
    "Information",
    "Isotropic",
    "Noise",
    "SquareRoot",
    "Whitening",
]

Namer = Callable[[int], str]

SCALAR, DIAGONAL, FULL = 0, 1, 2  # the forms of S, as the native side numbers them

_LEAST, _LARGEST = 1e-100, 1e100  # standard deviations between which squares stay finite

# Of the matrix scaled to a unit diagonal: six printed digits leave up to 5e-6 in every number.
_ROUNDING = 3e-5
# Likewise: an eigenvalue of this size is the rounding error of zero.
_ZERO = 1e-14


@dataclass(frozen=True, slots=True, kw_only=True)
class Whitening:
    """Square roots of information, ready for the native side.

    Parameters
    ----------
    form : int
        `SCALAR`, `DIAGONAL` or `FULL`.
    shared : bool
        One S serves all factors.
    sqrt_information : (K, 1 | rows | rows * rows) float64
        K is 1 if shared, else the number of factors. Full ones are upper triangular, row by row.
    constrained : bool
        The residual must vanish; S only sets the scale.
    """

    form: int
    shared: bool
    sqrt_information: Array
    constrained: bool = False

    def __post_init__(self) -> None:
        freeze(self)


def _name(index: int) -> str:
    return f"noise {index}"


@functools.lru_cache(maxsize=256)
def _shared(sigmas: tuple[float, ...]) -> Whitening | None:
    """Return the S of one noise from its standard deviations, or None where one of them needs a closer look.

    Graphs that are built factor by factor make the same noise over and over.
    """
    roots = [1.0 / sigma for sigma in sigmas if _LEAST < sigma < _LARGEST]
    if len(roots) != len(sigmas):
        return None
    if roots.count(roots[0]) == len(roots):
        return _alike(sigmas[0])
    numbers = np.array([roots])
    numbers.setflags(False)  # type: ignore[call-arg]
    return Whitening(form=DIAGONAL, shared=True, sqrt_information=numbers)


@functools.lru_cache(maxsize=256)
def _alike(sigma: float) -> Whitening | None:
    """Return what `_shared` does for one standard deviation of all rows."""
    if not _LEAST < sigma < _LARGEST:
        return None
    numbers = np.array([[1.0 / sigma]])
    numbers.setflags(False)  # type: ignore[call-arg]  # by position: three times as quick as by name
    return Whitening(form=SCALAR, shared=True, sqrt_information=numbers)


class Noise:
    """What the noise models share; use a subclass.

    A model is given for one factor and shared by all, or batched with the factors along the first axis.
    """

    __slots__ = ("_numbers", "_ready")

    form: ClassVar[int]
    constrained: ClassVar[bool] = False
    core: ClassVar[int]  # axes of one factor's numbers

    def __init__(self, numbers: ArrayLike) -> None:
        array = np.array(numbers, dtype=np.float64, order="C")
        if array.ndim not in (self.core, self.core + 1):
            raise GraphError(
                f"{type(self).__name__}: one factor's noise has {self.core} axes and a batch {self.core + 1}, "
                f"got an array of shape {array.shape}"
            )
        array.flags.writeable = False
        self._numbers = array
        self._ready: dict[int, Whitening] = {}  # by rows, where one serves all factors

    def ready(self, rows: int) -> Whitening | None:
        """Return the S that serves all factors with ``rows`` rows, where no closer look is needed, else None."""
        found = self._ready.get(rows)
        if found is None and (sigmas := self._sigmas(rows)) is not None:
            found = _shared(sigmas)
            if found is not None:
                self._ready[rows] = found
        return found

    def _sigmas(self, rows: int) -> tuple[float, ...] | None:  # noqa: ARG002
        """Return the standard deviations, one or `rows`, if they are all that there is to one noise for all factors."""
        return None

    def __repr__(self) -> str:
        return f"{type(self).__name__}({np.array2string(self._numbers, threshold=20)})"

    @property
    def numbers(self) -> Array:
        """What it was made from, read-only; `core` axes, and one more in front for a batch."""
        return self._numbers

    @property
    def shared(self) -> bool:
        """One for all factors."""
        return self._numbers.ndim == self.core

    def sqrt_information(self, rows: int, count: int, name: Namer = _name) -> Array:
        """Return the S of every factor, (K, 1 | rows | rows * rows), K = 1 if shared, else `count`.

        Parameters
        ----------
        rows : int
            Rows of the residual.
        count : int
            Number of factors.
        name : callable
            Gives what messages call the factor of an index.

        Raises
        ------
        GraphError
            The shape does not fit, or a number is not finite, or not positive (semi-definite).
        """
        stack = self._numbers[None] if self.shared else self._numbers
        if stack.shape[1:] != (rows,) * self.core:
            expected = " x ".join([str(rows)] * self.core)
            raise GraphError(
                f"{name(0)}: its residual has {rows} rows, so {type(self).__name__} needs {expected} numbers a factor, "
                f"got shape {stack.shape[1:]}"
            )
        if not self.shared and len(stack) != count:
            raise GraphError(
                f"{name(0)}: {type(self).__name__} is given for {len(stack)} factors, but there are {count}"
            )
        bad = ~np.isfinite(stack.reshape(len(stack), rows**self.core)).all(axis=1)
        if bad.any():
            raise GraphError(f"{name(_first(bad))}: its noise is not finite: {type(self).__name__}")
        return np.ascontiguousarray(self._roots(stack, name).reshape(len(stack), rows**self.core))

    def whitening(self, rows: int, count: int, name: Namer = _name) -> Whitening:
        """Return the S of every factor in the simplest form that holds it; errors as in `sqrt_information`."""
        roots = self.sqrt_information(rows, count, name)
        if len(roots) > 1 and np.array_equal(roots, np.broadcast_to(roots[:1], roots.shape)):
            roots = roots[:1]
        form, roots = _simplest(self.form, roots, rows)
        roots = np.ascontiguousarray(roots)
        roots.flags.writeable = False
        shared = self.shared or (len(roots) == 1 and count != 1)
        found = Whitening(form=form, shared=shared, sqrt_information=roots, constrained=self.constrained)
        if self.shared:
            self._ready[rows] = found
        return found

    def _roots(self, stack: Array, name: Namer) -> Array:
        raise NotImplementedError


def _first(mask: NDArray[np.bool_] | np.bool_) -> int:
    return int(np.argmax(mask))


def _simplest(form: int, roots: Array, rows: int) -> tuple[int, Array]:
    """Return the form and the numbers with triangles that are diagonal, and diagonals that are equal, recognised."""
    if form == FULL:
        matrices = roots.reshape(-1, rows, rows)
        diagonal = np.einsum("nii->ni", matrices)
        if np.count_nonzero(matrices) != np.count_nonzero(diagonal):
            return FULL, roots
        roots = diagonal
        form = DIAGONAL
    if form == DIAGONAL and (roots == roots[:, :1]).all():
        return SCALAR, roots[:, :1]
    return form, roots


def _require_positive(sigmas: Array, name: Namer) -> Array:
    bad = ~((sigmas > _LEAST) & (sigmas < _LARGEST))
    if bad.any():
        index = np.argwhere(bad)[0]
        raise GraphError(
            f"{name(int(index[0]))}: its standard deviation is {sigmas[tuple(index)]:g}; it must be positive "
            "(use Constrained() for a residual that must vanish)"
        )
    return 1.0 / sigmas


class Isotropic(Noise):
    """The same standard deviation in every row.

    Parameters
    ----------
    sigma : float or (N,) float64
        Standard deviation, in the residual's units.
    """

    __slots__ = ("_sigma",)
    _sigma: float | None
    form: ClassVar[int] = SCALAR
    core: ClassVar[int] = 0

    def __init__(self, sigma: ArrayLike) -> None:
        if isinstance(sigma, float):  # the usual case: an array is made when it is asked for
            self._sigma = float(sigma)
            self._ready = {}
        else:
            super().__init__(sigma)

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401
        """Make the array of a single number; only called for what has not been set."""
        if name == "_sigma":
            return None
        if name != "_numbers":
            raise AttributeError(f"{type(self).__name__} has no {name}")
        array = np.array(self._sigma)
        array.flags.writeable = False
        self._numbers = array
        return array

    def ready(self, rows: int) -> Whitening | None:
        """Return the S that serves all factors, whatever their rows, where no closer look is needed, else None."""
        return super().ready(rows) if self._sigma is None else _alike(self._sigma)

    def _sigmas(self, rows: int) -> tuple[float, ...] | None:  # noqa: ARG002
        return (self._numbers.item(),) if self.shared else None

    def _roots(self, stack: Array, name: Namer) -> Array:
        return _require_positive(stack, name)


class Diagonal(Noise):
    """Independent rows.

    Parameters
    ----------
    sigmas : (rows,) or (N, rows) float64
        Standard deviations, each in its row's units.
    """

    __slots__ = ()
    form: ClassVar[int] = DIAGONAL
    core: ClassVar[int] = 1

    def __init__(self, sigmas: ArrayLike) -> None:
        super().__init__(sigmas)

    def _sigmas(self, rows: int) -> tuple[float, ...] | None:
        return tuple(self._numbers.tolist()) if self._numbers.shape == (rows,) else None

    def _roots(self, stack: Array, name: Namer) -> Array:
        return _require_positive(stack, name)


def _symmetric(stack: Array, name: Namer, what: str) -> tuple[Array, Array]:
    """Return the symmetric parts and the scale of each row (the root of the diagonal; 1 where that is zero)."""
    diagonal = np.einsum("nii->ni", stack)
    scale = np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0))
    skew = np.abs(stack - np.swapaxes(stack, 1, 2)) / (scale[:, :, None] * scale[:, None, :])
    bad = skew.max(axis=(1, 2)) > _ROUNDING
    if bad.any():
        raise GraphError(f"{name(_first(bad))}: its {what} matrix is not symmetric; give all of it, not one triangle")
    return 0.5 * (stack + np.swapaxes(stack, 1, 2)), scale


class Information(Noise):
    """An information matrix, the inverse of a covariance. Semi-definite ones leave some directions free.

    Parameters
    ----------
    omega : (rows, rows) or (N, rows, rows) float64
        Symmetric, positive semi-definite but for rounding.
    """

    __slots__ = ()
    form: ClassVar[int] = FULL
    core: ClassVar[int] = 2

    def __init__(self, omega: ArrayLike) -> None:
        super().__init__(omega)

    def _roots(self, stack: Array, name: Namer) -> Array:
        omega, scale = _symmetric(stack, name, "information")
        diagonal = np.einsum("nii->ni", omega)
        if np.count_nonzero(omega) == np.count_nonzero(diagonal) and (diagonal >= 0.0).all():
            return np.asarray(np.sqrt(diagonal)[:, :, None] * np.eye(omega.shape[1]), dtype=np.float64)
        try:
            lower = np.linalg.cholesky(omega)
        except np.linalg.LinAlgError:
            return _semidefinite_roots(omega, scale, name)
        # A pivot may be what rounding leaves of zero; as information it would hold what nothing holds.
        if (np.einsum("nii->ni", lower) <= np.sqrt(_ZERO) * scale).any():
            return _semidefinite_roots(omega, scale, name)
        return np.swapaxes(lower, 1, 2)


def _semidefinite_roots(omega: Array, scale: Array, name: Namer) -> Array:
    """Return upper triangular roots where some matrices are singular: by eigenvalues, then a QR decomposition.

    The eigenvalues are those of the matrix scaled to a unit diagonal, so that units of very different size, such as
    radians and metres, are judged alike.
    """
    values, directions = np.linalg.eigh(omega / (scale[:, :, None] * scale[:, None, :]))
    bad = values[:, 0] < -_ROUNDING
    if bad.any():
        index = _first(bad)
        smallest = float(np.linalg.eigvalsh(omega[index])[0])
        raise GraphError(
            f"{name(index)}: its information matrix is not positive semi-definite: smallest eigenvalue {smallest:.6g}"
        )
    values = np.where(values <= _ZERO, 0.0, values)
    roots = np.sqrt(values)[:, :, None] * np.swapaxes(directions, 1, 2) * scale[:, None, :]
    return _upper(roots)


def _upper(roots: Array) -> Array:
    """Return upper triangles R with ``R' R = S' S``, the diagonal not negative."""
    triangles = np.triu(np.linalg.qr(roots, mode="r"))
    signs = np.where(np.einsum("nii->ni", triangles) < 0.0, -1.0, 1.0)
    return np.asarray(triangles * signs[:, :, None], dtype=np.float64)


class Covariance(Noise):
    """A covariance matrix.

    Parameters
    ----------
    P : (rows, rows) or (N, rows, rows) float64
        Symmetric, positive definite.
    """

    __slots__ = ()
    form: ClassVar[int] = FULL
    core: ClassVar[int] = 2

    def __init__(self, P: ArrayLike) -> None:
        super().__init__(P)

    def _roots(self, stack: Array, name: Namer) -> Array:
        P, _ = _symmetric(stack, name, "covariance")
        roots, failed = _core.covariance_roots(np.ascontiguousarray(P))
        if failed >= 0:
            smallest = np.linalg.eigvalsh(P[failed])[0]
            raise GraphError(
                f"{name(failed)}: its covariance matrix is not positive definite: smallest eigenvalue {smallest:.6g}; "
                "use Constrained() or Information for what is certain or unknown"
            )
        return np.asarray(roots)

    def ready(self, rows: int) -> Whitening | None:
        """Return the S of one covariance where no closer look is needed, else None."""
        found = self._ready.get(rows)
        P = self._numbers.reshape(-1, *self._numbers.shape[-2:])
        if found is None and P.shape == (1, rows, rows) and (P[0] == P[0].T).all():
            roots, failed = _core.covariance_roots(P)
            if failed < 0 and np.count_nonzero(roots) > rows:
                S = roots.reshape(1, -1)
                S.setflags(write=False)
                found = self._ready[rows] = Whitening(form=FULL, shared=self.shared, sqrt_information=S)
        return found


class SquareRoot(Noise):
    """A square root of the information.

    Parameters
    ----------
    S : (rows, rows) or (N, rows, rows) float64
        ``S' S`` is the information; upper triangular or not.
    """

    __slots__ = ()
    form: ClassVar[int] = FULL
    core: ClassVar[int] = 2

    def __init__(self, S: ArrayLike) -> None:
        super().__init__(S)

    def _roots(self, stack: Array, name: Namer) -> Array:  # noqa: ARG002
        return stack if np.array_equal(stack, np.triu(stack)) else _upper(stack)


class Constrained(Noise):
    """No noise: the residual must vanish. The solver treats it as a hard constraint."""

    __slots__ = ()
    form: ClassVar[int] = SCALAR
    constrained: ClassVar[bool] = True
    core: ClassVar[int] = 0

    def __init__(self) -> None:
        super().__init__(1.0)

    def __repr__(self) -> str:
        return "Constrained()"

    def _roots(self, stack: Array, name: Namer) -> Array:  # noqa: ARG002
        return stack
