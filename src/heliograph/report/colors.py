"""Colour scales: light enough at both ends to stand on a dark ground, and ordered in lightness."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["GROUND", "HEIGHT", "INTENSITY", "OBSERVABILITY", "css_gradient", "scale"]

HEIGHT = ("#2f5fb3", "#2b93b8", "#35b597", "#86cf6a", "#e3d85a", "#f59f45", "#e8563f")
INTENSITY = ("#2a3f5f", "#4f7597", "#8fb2c4", "#dfe7e4", "#ffe6a6", "#ffb65c", "#ff7f3f")
OBSERVABILITY = ("#e5484d", "#f07b3f", "#f5b83d", "#a9c94f", "#46b07b", "#2f97a8", "#3178c6")
GROUND = (13, 19, 28)


def rgb(color: str) -> tuple[int, int, int]:
    """Return ``#rrggbb`` as three integers."""
    return int(color[1:3], 16), int(color[3:5], 16), int(color[5:7], 16)


def scale(colors: tuple[str, ...], steps: int = 256) -> NDArray[np.float32]:
    """Return a (steps, 3) float32 table of 0..255 that runs through the colours."""
    anchors = np.array([rgb(color) for color in colors], dtype=np.float64)
    at = np.linspace(0.0, len(colors) - 1.0, steps)
    return np.stack([np.interp(at, np.arange(len(colors)), anchors[:, c]) for c in range(3)], axis=1).astype(np.float32)


def css_gradient(colors: tuple[str, ...]) -> str:
    """Return the scale as a CSS background, low end left."""
    return f"linear-gradient(90deg, {', '.join(colors)})"
