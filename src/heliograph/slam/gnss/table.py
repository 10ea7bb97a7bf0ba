"""gnss.csv: one row a fix, with its residual and what was decided."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from heliograph.atomic import write_text
from heliograph.data import JudgedFix

__all__ = ["write_gnss_table"]

_COLUMNS = (
    "stamp", "latitude_deg", "longitude_deg", "height_m", "solution", "east_m", "north_m", "up_m", "sigma_east_m",
    "sigma_north_m", "sigma_up_m", "residual_east_m", "residual_north_m", "residual_up_m", "weight", "decision",
    "reason",
)  # fmt: skip


def write_gnss_table(path: Path, fixes: Sequence[JudgedFix]) -> None:
    """Write the table; numbers that do not exist are left empty.

    Raises
    ------
    OutputError
        The file cannot be written.
    """
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(_COLUMNS)
    for fix in fixes:
        stamp = f"{fix.stamp_ns // 10**9}.{fix.stamp_ns % 10**9:09d}"
        degrees = [f"{value:.10f}" if np.isfinite(value) else "" for value in fix.geodetic_deg[:2]]
        metres = (fix.geodetic_deg[2], *fix.p_enu, *fix.sigma_enu, *fix.residual_enu)
        height, *others = [f"{value:.4f}" if np.isfinite(value) else "" for value in metres]
        rows.writerow([stamp, *degrees, height, fix.solution, *others, f"{fix.weight:.3f}", fix.decision, fix.reason])
    write_text(path, text.getvalue())
