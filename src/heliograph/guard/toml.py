"""TOML from strangers: the standard library's parser takes time that grows with the square of a dotted key's length."""

from __future__ import annotations

import re
import sys
from typing import Any

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

__all__ = ["TOMLDecodeError", "parse_toml"]

TOMLDecodeError = tomllib.TOMLDecodeError

_MAX_LENGTH = 1 << 19  # of a whole file [characters]; settings, plans and mountings are a hundredth of it
_MAX_PARTS = 64  # of a dotted key
_STRINGS = re.compile(r'"[^"\n]*"|\'[^\'\n]*\'')
_BETWEEN = re.compile(r"[\s,=\[\]{}#]+")


def parse_toml(text: str) -> dict[str, Any]:
    """Return the table that a TOML text holds.

    Parameters
    ----------
    text : str

    Raises
    ------
    TOMLDecodeError
        It is no TOML, is longer than half a million characters, nests deeper than can be read, or has a key of 64
        dotted parts or more.
    """
    if len(text) > _MAX_LENGTH:
        raise TOMLDecodeError(f"{len(text)} characters; it may have {_MAX_LENGTH}")
    joined = ".".join(part.strip(" \t") for part in _STRINGS.sub("q", text).split("."))
    longest = max((word.count(".") for word in _BETWEEN.split(joined)), default=0)
    if longest >= _MAX_PARTS:
        raise TOMLDecodeError(f"a name has {longest + 1} dotted parts; it must have fewer than {_MAX_PARTS}")
    try:
        table: dict[str, Any] = tomllib.loads(text)
    except RecursionError as error:
        raise TOMLDecodeError("it nests too deep") from error
    return table
