"""Numbers of a chart for the page's own script, which shows those under the pointer or the arrow keys."""

from __future__ import annotations

import base64
import json
from collections.abc import Sequence
from html import escape
from importlib.resources import files

import numpy as np
from numpy.typing import NDArray

__all__ = ["MAX_ROWS", "hover_attributes", "hover_script"]

MAX_ROWS = 6_000
"""Rows of a chart that are kept as numbers: ten minutes of scans; of more, every second, third ... one."""


def hover_attributes(
    names: Sequence[str], columns: Sequence[NDArray[np.float64]], axes: Sequence[float] | None = None
) -> str:
    """Return the attributes that a chart's ``<svg>`` carries its numbers in.

    Parameters
    ----------
    names : sequence of str
        What is shown of a row, a line each, with units; a name that ends with ``±`` takes two columns.
    columns : sequence of (N,) float64
        With ``axes`` the abscissa first, which is shown as well; without, the pixels x and y first, which are not.
    axes : sequence of float, optional
        Ends of the abscissa, their pixels, and the pixels of the plot's top and bottom.
    """
    every = -(-max(len(columns[0]), 1) // MAX_ROWS)
    table = np.array([np.asarray(column, dtype=np.float64)[::every] for column in columns]).astype("<f4")
    about = {
        "columns": list(names),
        "places": len(columns),
        "axes": None if axes is None else [round(float(value), 6) for value in axes],
    }
    values = base64.b64encode(np.ascontiguousarray(table).tobytes()).decode()
    return f'tabindex="0" data-hover="{escape(json.dumps(about, ensure_ascii=False))}" data-values="{values}"'


def hover_script() -> str:
    """Return the script that every page with charts ends with."""
    source = files("heliograph.report").joinpath("hover.js").read_text(encoding="utf-8")
    return f"<script>{source}</script>"
