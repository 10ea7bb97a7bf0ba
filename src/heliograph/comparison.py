"""Runs side by side: how far they are apart, what differs in their settings, and what each says of itself."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from heliograph import _core
from heliograph.arrays import freeze
from heliograph.config_toml import load_config
from heliograph.errors import DataError, FormatError, HeliographError
from heliograph.guard.account import read_account
from heliograph.io.files.clouds import CLOUD_SUFFIXES, read_cloud
from heliograph.io.files.poses import read_poses
from heliograph.metrics import evaluate

__all__ = ["MapDifference", "RunComparison", "RunLine", "compare_runs"]

_QUERIES = 200_000  # points of a map whose distance to the other map is measured
_FAR = 1.0  # points farther apart than this show different places [m]


@dataclass(frozen=True, slots=True, kw_only=True)
class MapDifference:
    """How far a map's points lie from another map's nearest ones, on the alignment of the two trajectories.

    Parameters
    ----------
    median, p95 : float
        Distance of those that have a point within 1 m [m].
    far_share : float
        Share of the points that have none.
    """

    median: float
    p95: float
    far_share: float


@dataclass(frozen=True, slots=True, kw_only=True)
class RunLine:
    """One run, and how far it is from the first.

    Parameters
    ----------
    folder : Path
    facts : mapping
        Status, reasons, totals, loops, timings of ``run.json``.
    settings : mapping
        Settings that differ from the first run's -> this run's value; of the first run empty.
    same_recording : bool or None
        Whether the recording's checksums are the first run's; None where a run has none.
    ate, ate_rotation_deg, ate_max : float or None
        Absolute trajectory error against the first run [m], [deg]; None for the first.
    poses : int
        Poses compared.
    map : MapDifference or None
        None for the first, and where a map is none that can be read (LAZ, E57).
    """

    folder: Path
    facts: Mapping[str, Any]
    settings: Mapping[str, Any]
    same_recording: bool | None = None
    ate: float | None = None
    ate_rotation_deg: float | None = None
    ate_max: float | None = None
    poses: int = 0
    map: MapDifference | None = None

    def __post_init__(self) -> None:
        freeze(self)


@dataclass(frozen=True, slots=True, kw_only=True)
class RunComparison:
    """Several runs, the first of which the others are compared with.

    Parameters
    ----------
    align : str
        Alignment of the trajectories.
    runs : tuple of RunLine
    settings : mapping
        Each setting in which they are not alike -> its value in each run.
    """

    align: str
    runs: tuple[RunLine, ...]
    settings: Mapping[str, tuple[Any, ...]]

    def __post_init__(self) -> None:
        freeze(self)

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        runs = [{**asdict(run), "folder": run.folder.name} for run in self.runs]
        return {"align": self.align, "runs": runs, "settings": {key: list(row) for key, row in self.settings.items()}}


def compare_runs(folders: Sequence[Path], *, align: str = "se3") -> RunComparison:
    """Compare runs with the first of them.

    Parameters
    ----------
    folders : sequence of Path
        Folders that `run` wrote, two or more.
    align : str
        As for `heliograph.metrics.evaluate`.

    Raises
    ------
    FormatError
        One is no folder of a run, or the run has not ended.
    DataError
        Fewer than two, or two runs that have no time in common.
    """
    if len(folders) < 2:
        raise DataError(f"{len(folders)} run was given; name two or more folders of runs")
    facts = [_facts(folder) for folder in folders]
    settings = [_settings(folder) for folder in folders]
    differing = {
        key: tuple(own.get(key) for own in settings)
        for key in dict.fromkeys(key for own in settings for key in own)
        if len({repr(own.get(key)) for own in settings}) > 1
    }
    lines = [RunLine(folder=folders[0], facts=facts[0], settings={})]
    for folder, own, known in zip(folders[1:], settings[1:], facts[1:], strict=True):
        lines.append(
            RunLine(
                folder=folder,
                facts=known,
                settings={key: own.get(key) for key in differing if own.get(key) != settings[0].get(key)},
                same_recording=_same_recording(facts[0], known),
                **_apart(folder, folders[0], align),
            )
        )
    return RunComparison(align=align, runs=tuple(lines), settings=differing)


def _apart(folder: Path, first: Path, align: str) -> dict[str, Any]:
    found = evaluate(read_poses(folder / "trajectory.tum"), read_poses(first / "trajectory.tum"), align=align)
    T_first_run = found.absolute.T_reference_estimate
    return {
        "ate": found.absolute.rmse,
        "ate_rotation_deg": found.absolute.rotation_rmse_deg,
        "ate_max": found.absolute.max,
        "poses": found.poses_compared,
        "map": _maps_apart(folder, first, T_first_run),
    }


def _maps_apart(folder: Path, first: Path, T_first_run: NDArray[np.float64]) -> MapDifference | None:
    maps = [
        next((path for s in CLOUD_SUFFIXES if (path := run / f"map{s}").is_file()), None) for run in (folder, first)
    ]
    if maps[0] is None or maps[1] is None:
        return None
    points, target = (read_cloud(path).points for path in maps if path is not None)
    if not len(points) or not len(target):
        return None
    chosen = points[:: max(len(points) // _QUERIES, 1)].astype(np.float64)
    moved = (chosen @ T_first_run[:3, :3].T + T_first_run[:3, 3]).astype(np.float32)
    squared, _ = _core.KdTree(np.ascontiguousarray(target)).nearest(np.ascontiguousarray(moved), 1, _FAR)
    near = np.sqrt(squared[:, 0][np.isfinite(squared[:, 0])])
    if not len(near):
        return MapDifference(median=float("inf"), p95=float("inf"), far_share=1.0)
    median, p95 = np.percentile(near, [50.0, 95.0]).tolist()
    return MapDifference(median=median, p95=p95, far_share=1.0 - len(near) / len(moved))


def _same_recording(a: Mapping[str, Any], b: Mapping[str, Any]) -> bool | None:
    if not a.get("inputs") or not b.get("inputs"):
        return None
    return bool(a["inputs"] == b["inputs"])


def _facts(folder: Path) -> dict[str, Any]:
    facts = read_account(folder)
    if "status" not in facts:
        raise FormatError(folder / "run.json", "is no account of a run; name the folder that `run` wrote")
    if facts["status"] == "running":
        raise FormatError(folder, "is a run that has not ended; wait for it, or run it again with --overwrite")
    return facts


def _settings(folder: Path) -> dict[str, Any]:
    try:
        config = load_config(folder / "config.toml")
    except HeliographError as error:
        raise FormatError(folder / "config.toml", f"cannot be compared ({error})") from error
    return dict(_flat(asdict(config)))


def _flat(tree: Mapping[str, Any], name: str = "") -> list[tuple[str, Any]]:
    found: list[tuple[str, Any]] = []
    for key, value in tree.items():
        found += _flat(value, f"{name}{key}.") if isinstance(value, Mapping) else [(f"{name}{key}", value)]
    return found
