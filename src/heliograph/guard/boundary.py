"""Where other people's libraries end: what they raise at a bad byte becomes one error with the file's name."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import TypeVar

from heliograph.errors import FormatError, HeliographError

__all__ = ["DAMAGE", "outside", "outside_each", "reason"]

T = TypeVar("T")

DAMAGE: tuple[type[Exception], ...] = (
    ArithmeticError,  # OverflowError among them: a number that no integer of the format holds
    EOFError,
    LookupError,
    MemoryError,
    OSError,
    RecursionError,
    RuntimeError,
    TypeError,
    ValueError,  # UnicodeDecodeError and JSON's among them
    struct.error,
    zlib.error,
)
"""What the standard library's own decoders raise at damaged bytes, where they are called directly."""


@contextmanager
def outside(path: Path | str, what: str = "is damaged") -> Iterator[None]:
    """Turn what a library raises inside the block into a `FormatError`; a defect of ours goes through as it is.

    The two are told apart by where the exception was raised: in a file of this package, or outside it.

    Parameters
    ----------
    path : Path or str
        The file that is being read, as the user knows it.
    what : str
        What is wrong with it.
    """
    try:
        yield
    except HeliographError:
        raise
    except Exception as error:
        if not _raised_outside(error):
            raise
        raise FormatError(path, reason(what, error)) from error


def outside_each(path: Path | str, items: Iterator[T], what: str = "is damaged") -> Iterator[T]:
    """Yield the items of a library's iterator; what it raises is treated as in `outside`, what its user does is not."""
    while True:
        with outside(path, what):
            try:
                item = next(items)
            except StopIteration:
                return
        yield item


def reason(what: str, error: BaseException) -> str:
    """Return what is wrong and the library's word for it, on one line of bounded length."""
    if isinstance(error, OSError) and error.strerror:
        return f"{what} ({error.strerror})"
    said = " ".join(str(error).split())
    return f"{what} ({said[:200] or type(error).__name__})"


def _raised_outside(error: BaseException) -> bool:
    """Tell whether the innermost frame of an exception is none of this package's."""
    trace: TracebackType | None = error.__traceback__
    name = ""
    while trace is not None:
        name = str(trace.tb_frame.f_globals.get("__name__", ""))
        trace = trace.tb_next
    return name.partition(".")[0] != "heliograph"
