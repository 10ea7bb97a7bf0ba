"""What a finished run hands to those who draw it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import freeze
from heliograph.output.scan_log import ScanTable
from heliograph.output.summary import RunSummary

__all__ = ["RunRecord"]


@dataclass(frozen=True, slots=True, kw_only=True)
class RunRecord:
    """A run as a whole.

    Parameters
    ----------
    name : str
        The recording's name.
    folder : Path
        Where the files lie.
    summary : RunSummary
        Verdict, totals, timings, warnings.
    scans : ScanTable
        One row a scan, map-frame axes.
    points_map : (N, 3) float32
        The map, or an even choice of very many points [m]; empty without a LiDAR.
    intensity : (N,) float32 or None
        Intensity of those points.
    map_points, moving_points : int
        How many points the map has, and how many cubes were left out because what was there moved.
    facts : mapping
        What ``run.json`` says so far: recording, inferences, versions.
    config : str
        The resolved configuration, as TOML.
    """

    name: str
    folder: Path
    summary: RunSummary
    scans: ScanTable
    points_map: NDArray[np.float32] = field(default_factory=lambda: np.zeros((0, 3), dtype=np.float32))
    intensity: NDArray[np.float32] | None = None
    map_points: int = 0
    moving_points: int = 0
    facts: Mapping[str, Any] = field(default_factory=dict)
    config: str = ""

    def __post_init__(self) -> None:
        freeze(self)
