"""The account of a run, ``run.json``, from anybody: what commands rely on is there as they expect it, or absent."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NoReturn

from heliograph.errors import FormatError
from heliograph.guard.files import SETTINGS, plain_file

__all__ = ["read_account"]

_MAX_DEPTH = 50
_MAX_INTEGER = 1 << 63
_GENERATION = 1
"""Number at the end of the schemas; names may be added within one, none changes or goes."""


class _Whole(dict[str, Any]):
    """A mapping of which every name must be there."""


# What is read by name somewhere: a type, [type of each item], {name: type}, or several of them in a tuple.
_NUMBER = (float, int)
_TEXTS = [str]
_FINDING = _Whole(title=str, verdict=str, evidence=str, remedy=str)
_GNSS = {
    "aligned": bool,
    "reason": str,
    "origin": _Whole(latitude_deg=_NUMBER, longitude_deg=_NUMBER, height_ellipsoid_m=_NUMBER),
    "residual_rms_enu_m": [_NUMBER],
}
_SHAPE: dict[str, Any] = {
    "status": str,
    "reasons": _TEXTS,
    "interrupted": bool,
    "failure": str,
    "scans": int,
    "distance_m": (*_NUMBER, None),
    "duration_s": (*_NUMBER, None),
    "start_end_gap_m": (*_NUMBER, None),
    "peak_memory_mb": (*_NUMBER, None),
    "map_points": int,
    "T_map_odom": [[_NUMBER]],
    "checks": [_FINDING],
    "graph": {
        "keyframes": int,
        "loops": dict,
        "gnss": _GNSS,
        "wheels": {"scale": (*_NUMBER, None)},
    },
    "timings": {"wall_ms_per_scan": (*_NUMBER, None)},
    "versions": {"heliograph": str},
    "inputs": [_Whole(name=str)],
    "outputs": [_Whole(name=str)],
    "recording": dict,
}


def read_account(folder: Path) -> dict[str, Any]:
    """Return what ``run.json`` says; names may be missing, as in the account of a run that has not ended.

    Parameters
    ----------
    folder : Path
        A run's.

    Raises
    ------
    FormatError
        There is none, it is of another generation of the format, it is no JSON, nests deeper than any account, holds a
        number that is none, or something of another type than `run` writes.
    """
    path = folder / "run.json"
    try:
        text = plain_file(path, SETTINGS).read_text(encoding="utf-8")
        facts = json.loads(text, parse_float=_number, parse_int=_integer, parse_constant=_refuse)
    except FileNotFoundError as error:
        raise FormatError(folder, "is no folder of a run (it holds no run.json); name what `run` wrote") from error
    except (OSError, ValueError, RecursionError) as error:
        raise FormatError(folder, f"is no folder of a run (run.json: {error}); name what `run` wrote") from error
    if isinstance(facts, dict) and (newer := _newer_schema(facts.get("schema"))):
        raise FormatError(
            path,
            f"was written by another version of Heliograph ('{newer}' where this one reads {_GENERATION}); read it "
            "with that version, or run again with this one",
        )
    wrong = next(_misfits(facts, _SHAPE, ""), None) if isinstance(facts, dict) else "it"
    if wrong is None and _depth(facts) > _MAX_DEPTH:
        wrong = "its depth"
    if wrong is not None:
        raise FormatError(path, f"is no account of a run ({wrong} is not what `run` writes); run it again")
    return facts  # type: ignore[no-any-return]


def _newer_schema(schema: object) -> str:
    """Return a schema that is not of this generation, cut short; "" for one that is, or that says nothing."""
    if not isinstance(schema, str) or not schema.startswith("heliograph "):
        return ""
    generation = schema.rpartition(" ")[2]
    return schema[:40] if generation.isdecimal() and int(generation[:9]) != _GENERATION else ""


def _number(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        _refuse(text)
    return value


def _integer(text: str) -> int:
    if len(text) > len(str(_MAX_INTEGER)) + 1 or abs(int(text)) >= _MAX_INTEGER:
        _refuse(text)
    return int(text)


def _refuse(text: str) -> NoReturn:
    raise ValueError(f"'{text[:20]}' is no number")


def _misfits(value: Any, shape: Any, name: str) -> Iterator[str]:  # noqa: ANN401 - a tree of JSON
    """Yield the names whose values are not of their shape."""
    fits = True
    if isinstance(shape, tuple):
        fits = not all(any(_misfits(value, kind, name)) for kind in shape)
    elif isinstance(shape, list):
        fits = isinstance(value, list)
        for item in value if fits else ():
            yield from _misfits(item, shape[0], name)
    elif isinstance(shape, dict):
        fits = isinstance(value, dict)
        for key in (key for key in shape if fits and (key in value or isinstance(shape, _Whole))):
            yield from _misfits(value.get(key), shape[key], f"{name}.{key}".lstrip("."))
    else:
        kind = type(None) if shape is None else shape
        fits = isinstance(value, kind) and (kind is bool or not isinstance(value, bool))
    if not fits:
        yield name


def _depth(tree: Any) -> int:  # noqa: ANN401 - a tree of JSON
    """Return how deep it nests, without recursion."""
    depth, level = 0, [tree]
    while level:
        depth += 1
        level = [
            child
            for value in level
            if isinstance(value, (dict, list))
            for child in (value.values() if isinstance(value, dict) else value)
        ]
    return depth
