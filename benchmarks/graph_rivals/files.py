"""What the programs share: a g2o file as arrays, and their last line. Needs NumPy alone: rivals have no Heliograph."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np


def read(path: str) -> SimpleNamespace:
    """Return dimension, vertices (N, 3 | 7), edges i, j (E,), relative poses (E, 3 | 7), information in file order."""
    vertices, edges = [], []
    for line in Path(path).read_text().splitlines():
        words = line.split()
        (vertices if words[0].startswith("VERTEX") else edges).append(words[1:])
    ids = {word[0]: k for k, word in enumerate(vertices)}
    values = np.array([word[1:] for word in vertices], dtype=np.float64)
    width = values.shape[1]
    d = 3 if width == 3 else 6
    numbers = np.array([word[2:] for word in edges], dtype=np.float64)
    information = np.zeros((len(edges), d, d))
    information[(slice(None), *np.triu_indices(d))] = numbers[:, width:]
    information += np.swapaxes(np.triu(information, 1), 1, 2)
    return SimpleNamespace(
        dimension=2 if d == 3 else 3,
        vertices=values,
        i=np.array([ids[word[0]] for word in edges]),
        j=np.array([ids[word[1]] for word in edges]),
        relative=numbers[:, :width],
        information=information,
    )


def rotations(xyzw: np.ndarray) -> np.ndarray:
    """Return rotation matrices (N, 3, 3) of quaternions (N, 4)."""
    x, y, z, w = (xyzw / np.linalg.norm(xyzw, axis=1, keepdims=True)).T
    rows = [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)]
    rows += [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)]
    rows += [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]
    return np.stack(rows, axis=1).reshape(-1, 3, 3)


def run(solve: Callable[[], tuple[Any, float, int]], poses: Callable[[Any], np.ndarray], version: str) -> None:
    """Warm up, solve on the clock, write the poses and print the account; `solve` gives result, seconds, iterations."""
    if "--cold" not in sys.argv:
        solve()
    result, seconds, iterations = solve()
    np.save(sys.argv[2], poses(result))
    print(json.dumps({"seconds": seconds, "iterations": iterations, "version": version}))
