"""Keys with names: a letter and a number in one integer, so that messages say X3."""

from __future__ import annotations

import operator
from typing import overload

import numpy as np
from numpy.typing import NDArray

from heliograph.errors import GraphError

__all__ = ["Symbol", "key_name"]

_SHIFT = 56  # the letter's ASCII code is the uppermost byte, as in the symbols of gtsam
_MASK = (1 << _SHIFT) - 1


class Symbol:
    """A letter that gives keys by number: ``X = Symbol("X")``, then ``X(3)`` is an integer that messages call ``X3``.

    Parameters
    ----------
    letter : str
        One ASCII letter; ``Symbol("x")`` gives the keys of gtsam's ``symbol('x', ...)``.

    Raises
    ------
    GraphError
        It is no ASCII letter.

    Examples
    --------
    >>> X, L = Symbol("X"), Symbol("L")
    >>> values.insert(X(np.arange(100)), poses)
    >>> graph.add(Landmark(X(3), L(5), p_i, Isotropic(0.1)))
    """

    __slots__ = ("letter",)

    def __init__(self, letter: str) -> None:
        if not (isinstance(letter, str) and len(letter) == 1 and letter.isascii() and letter.isalpha()):
            raise GraphError(f"a symbol is one ASCII letter, not {letter!r}")
        self.letter = letter

    @overload
    def __call__(self, number: int) -> int: ...
    @overload
    def __call__(self, number: NDArray[np.integer] | list[int] | range) -> NDArray[np.int64]: ...

    def __call__(self, number: int | NDArray[np.integer] | list[int] | range) -> int | NDArray[np.int64]:
        """Return the key of a number, or of each of (N,).

        Raises
        ------
        GraphError
            It is no whole number from 0 to 2^56 - 1.
        """
        base = ord(self.letter) << _SHIFT
        try:
            index = operator.index(number)  # type: ignore[arg-type]
        except TypeError:
            array = np.asarray(number)
            if array.dtype.kind not in "iu" or (array.size and not 0 <= int(array.min()) <= int(array.max()) <= _MASK):
                raise GraphError(f"{self!r} takes whole numbers from 0 to 2^56 - 1, not {number!r:.60}") from None
            return base + array.astype(np.int64)
        if not 0 <= index <= _MASK:
            raise GraphError(f"{self!r} takes whole numbers from 0 to 2^56 - 1, not {index}")
        return base + index

    def __repr__(self) -> str:
        return f"Symbol({self.letter!r})"


def key_name(key: int) -> str:
    """Return what messages call a key: ``X3`` where its uppermost byte is a letter, else the number."""
    letter = chr(key >> _SHIFT) if key > _MASK else ""
    return f"{letter}{key & _MASK}" if letter.isascii() and letter.isalpha() else str(key)
