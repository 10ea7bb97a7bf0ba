"""Scale bar, axes and a world file for the map's picture, so that it can be used without the report."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from heliograph.report.raster import View
from heliograph.report.svg import round_length

__all__ = ["lettered", "world_file"]

# Five by seven dots a sign, a row a number: what a scale and two axes need is no reason for a font library.
_SIGNS = {
    "0": (14, 17, 19, 21, 25, 17, 14), "1": (4, 12, 4, 4, 4, 4, 14), "2": (14, 17, 1, 2, 4, 8, 31),
    "3": (31, 2, 4, 2, 1, 17, 14), "4": (2, 6, 10, 18, 31, 2, 2), "5": (31, 16, 30, 1, 1, 17, 14),
    "6": (6, 8, 16, 30, 17, 17, 14), "7": (31, 1, 2, 4, 8, 8, 8), "8": (14, 17, 17, 14, 17, 17, 14),
    "9": (14, 17, 17, 15, 1, 2, 12), ".": (0, 0, 0, 0, 0, 12, 12), "m": (0, 0, 26, 21, 21, 21, 21),
    "x": (0, 0, 17, 10, 4, 10, 17), "y": (0, 0, 17, 17, 15, 1, 14), "−": (0, 0, 0, 31, 0, 0, 0), " ": (0,) * 7,
}  # fmt: skip
_INK, _SHADOW = (238, 243, 248), (13, 19, 28)
_ARROW = 18  # dots


def lettered(image: NDArray[np.uint8], view: View) -> NDArray[np.uint8]:
    """Return the picture with a scale bar at the lower right and the axes at the lower left.

    Parameters
    ----------
    image : (H, W, 3) uint8
        A picture of ``view``.
    view : View
    """
    out: NDArray[np.uint8] = image.copy()
    rows, columns = out.shape[:2]
    dot = max(1, round(min(rows, columns) / 300))
    length = round_length(columns * view.pixel / 5.0)
    bar = round(length / view.pixel)
    words = f"{length:.15g} m" if length < 1e15 else ""  # the sheet of signs has no exponent
    if rows < 24 * dot or columns < bar + 40 * dot:
        return out
    base, right = rows - 6 * dot, columns - 6 * dot
    _box(out, base - dot, base, right - bar, right)
    _box(out, base - 5 * dot, base, right - bar, right - bar + dot)
    _box(out, base - 5 * dot, base, right - dot, right)
    _write(out, words, base - 15 * dot, right - bar // 2 - 3 * dot * len(words), dot)
    left, long = 8 * dot, _ARROW * dot
    _box(out, base - dot, base, left, left + long)
    _box(out, base - long, base, left, left + dot)
    _write(out, view.labels[0], base - 5 * dot, left + long + 2 * dot, dot)
    _write(out, view.labels[1], base - long - 9 * dot, left - 2 * dot, dot)
    return out


def world_file(view: View) -> str:
    """Return the six lines that place a picture in the map frame (an ESRI world file): pixel's steps, then its corner.

    Parameters
    ----------
    view : View
        From above.
    """
    right, up = view.axes[0, :2], view.axes[1, :2]
    corner = right * (view.low[0] + 0.5 * view.pixel) + up * (view.high[1] - 0.5 * view.pixel)
    steps = (right * view.pixel, -up * view.pixel)
    return "".join(f"{value:.9f}\n" for value in (*steps[0], *steps[1], *corner))


def _box(image: NDArray[np.uint8], top: int, bottom: int, left: int, right: int) -> None:
    image[max(top - 1, 0) : bottom + 1, max(left - 1, 0) : right + 1] = _SHADOW
    image[top:bottom, left:right] = _INK


def _write(image: NDArray[np.uint8], words: str, top: int, left: int, dot: int) -> None:
    for paint, spread in ((_SHADOW, 1), (_INK, 0)):
        for place, sign in enumerate(words):
            for row, bits in enumerate(_SIGNS[sign]):
                for column in (c for c in range(5) if bits >> (4 - c) & 1):
                    y, x = top + row * dot, left + (6 * place + column) * dot
                    image[max(y - spread, 0) : y + dot + spread, max(x - spread, 0) : x + dot + spread] = paint
