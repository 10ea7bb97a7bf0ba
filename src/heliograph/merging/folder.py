"""The folder of merged runs: what `heliograph loops`, `localize` and `merge` open like that of one run."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from heliograph.atomic import check_output_directory, write_text
from heliograph.config_toml import dump_config
from heliograph.editing import UNEDITED
from heliograph.edits import EDITS
from heliograph.io.files.tum import TumWriter
from heliograph.merging.links import PlaceCounter
from heliograph.merging.merge import MergedRuns, merge_runs, session_facts
from heliograph.merging.sessions import RunSession
from heliograph.output.facts import graph_facts, versions
from heliograph.output.lock import FolderLock
from heliograph.output.manifest import hashed_files
from heliograph.revision import write_keyframe_map
from heliograph.slam import KEYFRAMES
from heliograph.slam.graph_files import write_graph_files

__all__ = ["MERGE_SCHEMA", "merge_into"]

MERGE_SCHEMA = "heliograph merge 1"
"""Schema of ``run.json``: names may be added, none changes or goes."""


def merge_into(
    sessions: Sequence[RunSession], path: Path, *, overwrite: bool = False, watch: PlaceCounter | None = None
) -> dict[str, Any]:
    """Merge runs into a folder and return what its ``run.json`` says.

    Parameters
    ----------
    sessions : sequence of RunSession
        The first one's frame and settings are the merged map's.
    path : Path
        The folder; made if absent.
    overwrite : bool
        Replace what is there.
    watch : callable, optional
        Told which of how many places of a pair of runs has been compared.

    Raises
    ------
    DataError
        Nothing links them for sure.
    OutputError
        The folder is not empty, or cannot be written.
    """
    created = not path.exists()
    check_output_directory(path, overwrite)
    lock = FolderLock(path)
    for name in (EDITS, UNEDITED):  # of what was here before
        (path / name).unlink(missing_ok=True)
    try:
        merged = merge_runs(sessions, path / KEYFRAMES, watch)
        return _written(merged, sessions, path)
    except BaseException:
        lock.release()
        if created and not any(path.iterdir()):
            path.rmdir()
        raise
    finally:
        lock.release()


def _written(merged: MergedRuns, sessions: Sequence[RunSession], path: Path) -> dict[str, Any]:
    back_end, config = merged.back_end, sessions[0].run.config
    T = back_end.T_map_imu
    write_text(path / "config.toml", dump_config(config))
    files = write_graph_files(path, back_end)
    points = write_keyframe_map(back_end.store, T, config.output, path)
    head = "heliograph merge: T_map_imu (p_map = T p_imu), stamp = end of a keyframe's scan [s], x y z [m] qx qy qz qw"
    with TumWriter(path / "trajectory.tum", head) as writer:
        writer.extend(back_end.chain.stamps_ns, T)
    names = ["trajectory.tum", f"map.{config.output.map_format}", *files, "config.toml", "run.json"]
    facts = {
        "schema": MERGE_SCHEMA,
        "status": "degraded" if merged.apart else "ok",
        "reasons": [f"{name} is not linked for sure and stays apart" for name in merged.apart],
        "sessions": session_facts(merged),
        "graph": graph_facts(back_end.account()),
        "contradicted": merged.revoked,
        "map_points": points,
        "T_map_odom": np.eye(4).tolist(),
        "warnings": [],
        "versions": versions(),
        "folder": str(path),
        "files": names,
        "outputs": hashed_files(path / name for name in names if (path / name).is_file() and name != "run.json"),
    }
    write_text(path / "run.json", json.dumps(facts, indent=2) + "\n")
    return facts
