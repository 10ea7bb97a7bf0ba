"""ODOMETRY and LANDMARK lines of iSAM's text files, in the words of g2o."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from heliograph.graph.files.row_kinds import KINDS
from heliograph.graph.files.tables import Table

__all__ = ["as_g2o"]

_TO_G2O = {"ODOMETRY": "EDGE_SE2", "LANDMARK": "EDGE_SE2_XY"}


def as_g2o(tables: Sequence[Table]) -> tuple[list[Table], list[str]]:
    """Return the tables with those of iSAM as g2o would state them, and what was renumbered.

    iSAM counts poses and landmarks each from 0. Where their ids overlap, landmarks move behind the poses.
    """
    mine = [table for table in tables if table.kind.tag in _TO_G2O]
    seen = [table for table in mine if table.kind.tag == "LANDMARK"]
    if not mine:
        return list(tables), []
    poses = np.concatenate([t.ids[:, :1] if t.kind.role == "landmark" else t.ids for t in mine], axis=None)
    points = np.concatenate([table.ids[:, 1] for table in seen]) if seen else np.zeros(0, dtype=np.int64)
    overlap = bool(np.isin(points, poses).any())
    shift = int(poses.max()) + 1 - int(points.min()) if overlap else 0
    out: list[Table] = []
    for table in tables:
        tag = _TO_G2O.get(table.kind.tag)
        if tag is None:
            out.append(table)
            continue
        ids = table.ids + np.array([0, shift]) if tag == "EDGE_SE2_XY" else table.ids
        out.append(replace(table, kind=KINDS[tag], ids=ids))
    if not overlap:
        return out, []
    moved = f"landmark {points.min()} has become {points.min() + shift}, and so on"
    return out, [f"landmarks and poses share ids; {moved}"]
