"""Records compared bit by bit."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

__all__ = ["bits"]


def bits(value: Any) -> object:  # noqa: ANN401 - any record, and any field of one
    """Return a record as something that compares bit by bit; NaN equals NaN."""
    if isinstance(value, np.ndarray):
        return value.dtype, value.shape, value.tobytes()
    if dataclasses.is_dataclass(value):
        return [bits(getattr(value, field.name)) for field in dataclasses.fields(value)]
    if isinstance(value, tuple):
        return [bits(item) for item in value]
    return repr(value) if isinstance(value, float) else value
