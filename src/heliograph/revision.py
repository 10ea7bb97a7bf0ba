"""A run's loops taken up again: one is added or revoked, the graph is solved anew, and the run's files follow."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from heliograph.arrays import Array, Mask, Points, freeze
from heliograph.atomic import atomic_folder, write_text
from heliograph.config import OutputConfig, RunConfig
from heliograph.config_toml import load_config
from heliograph.data import GraphAccount
from heliograph.edits import EDITS, RunEdits, read_edits
from heliograph.errors import DataError, FormatError
from heliograph.factors import SENSOR_FACTORS
from heliograph.graph import Symbol, load_graph
from heliograph.guard.account import read_account
from heliograph.maps import GlobalMap, transformed
from heliograph.output.facts import graph_facts
from heliograph.output.final_poses import FinalPoses
from heliograph.output.manifest import hashed_files
from heliograph.output.map_file import MapBounds, write_map
from heliograph.output.scan_log import rewrite_scans
from heliograph.output.tiles import MapTiles
from heliograph.output.trajectories import FILES, rewrite
from heliograph.slam import KEYFRAMES, BackEnd, KeyframeStore
from heliograph.slam.gnss import KeptFixes, kept_fixes
from heliograph.slam.graph_files import write_graph_files
from heliograph.slam.loops import Ledger, LedgerEntry
from heliograph.slam.loops.ledger_file import read_ledger
from heliograph.slam.plane_refinement import PlaneRefinement, StepsBetween, refine_planes

__all__ = ["RunGraph", "kept_points", "open_run_graph", "sessions_of", "write_keyframe_map"]

X = Symbol("X")
_SCANS = "scans.csv"
_REFINED_POINTS = 2_000_000  # of all keyframes that an adjustment over planes takes: more take memory, and tell little
_IN_MAP = tuple(name for name in FILES if name != "odometry.tum")


@dataclass(frozen=True, slots=True, kw_only=True)
class RunGraph:
    """A run's keyframes, its ledger, and where its files have the keyframes now.

    Parameters
    ----------
    folder : Path
    config : RunConfig
        The run's own.
    facts : mapping
        Its ``run.json``.
    store : KeyframeStore
    ledger : Ledger
    T_map_imu : (K, 4, 4) float64
        Poses of the keyframes in the files of the map frame.
    fixes : KeptFixes or None
        What the graph holds of satellite fixes.
    edits : RunEdits
        What a plan leaves out.
    """

    folder: Path
    config: RunConfig
    facts: Mapping[str, Any]
    store: KeyframeStore
    ledger: Ledger
    T_map_imu: Array
    fixes: KeptFixes | None = None
    edits: RunEdits = field(default_factory=RunEdits)

    def __post_init__(self) -> None:
        freeze(self)

    def points(self, index: int) -> Points:
        """Return a keyframe's cloud (N, 3) float32, imu frame [m], without what a plan of edits leaves out."""
        points = self.store.points(index)
        return np.ascontiguousarray(points[self._kept(points, index, self.T_map_imu[index])])

    def dropped(self, index: int) -> bool:
        """Whether a keyframe belongs to a session that a plan of edits drops."""
        return _dropped(self.edits, self.facts, index)

    def _kept(self, points_imu: Points, index: int, T_map_imu: Array) -> Mask:
        return kept_points(self.edits, self.facts, points_imu, index, T_map_imu)

    def revoke(self, number: int) -> LedgerEntry:
        """Take a loop back by hand; `resolve` brings it into the files.

        Raises
        ------
        DataError
            There is no such loop, or it does not stand.
        """
        return self.ledger.revoke(number)

    def add(self, query: int, match: int) -> LedgerEntry:
        """Register two keyframes and accept the loop by hand; `resolve` brings it into the files.

        Raises
        ------
        DataError
            There are no such keyframes, or their clouds do not match.
        """
        query, match = max(query, match), min(query, match)
        if not 0 <= match < query < len(self.store):
            raise DataError(
                f"a loop joins two of the keyframes 0 to {len(self.store) - 1}, not {query} and {match}; "
                "loops.csv and `heliograph loops` number them"
            )
        evidence = BackEnd.replayed(self.config, self.store, self.ledger, self.fixes).compare(query, match)
        if evidence.status not in ("converged", "degenerate"):
            raise DataError(
                f"keyframes {query} and {match} do not match ({evidence.status}, overlap {evidence.overlap:.0%}): "
                "no loop was added"
            )
        return self.ledger.add_by_hand(evidence)

    def resolve(self, *, beside: Mapping[str, str] | None = None, refine: bool = False) -> GraphAccount:
        """Solve the graph with the loops that stand, and write the run's files anew: all of them, or none.

        The map is put together from the keyframes' clouds, which are thinner than the run's own.

        Parameters
        ----------
        beside : mapping of str to str, optional
            Other files that are written with them: names and texts.
        refine : bool
            Whether the poses are then adjusted so that walls are thin, where they become so; ``run.json`` says what
            came of it, below ``graph.refined``. The next solution begins without it.

        Raises
        ------
        OutputError
            A file cannot be written; the run is as it was.
        """
        back_end = BackEnd.replayed(self.config, self.store, self.ledger, self.fixes)
        T_new = back_end.T_map_imu if back_end.moves else _levelled(self.facts, back_end.chain.T_odom_imu)
        refined = self._refined(back_end, T_new) if refine else None
        T_new = T_new if refined is None else refined.T_map_imu
        moved = FinalPoses(stamps_ns=back_end.chain.stamps_ns, T_odom_imu=self.T_map_imu, T_map_imu=T_new)
        with atomic_folder(self.folder) as folder:
            for name in _IN_MAP:
                if (self.folder / name).is_file():
                    rewrite(self.folder / name, moved, folder / name)
            account = back_end.account(files=write_graph_files(folder, back_end, T_new if refined else None))
            facts = {
                **self.facts,
                "graph": graph_facts(account),
                "map_points": write_keyframe_map(self.store, T_new, self.config.output, folder, self._kept),
            }
            if refined is not None:
                facts["graph"]["refined"] = _refined_facts(refined)
            if "wheels" in self.facts["graph"]:
                facts["graph"]["wheels"] = self.facts["graph"]["wheels"]
            if "gnss" in self.facts["graph"]:
                facts["graph"]["gnss"] = _gnss_facts(self.facts["graph"]["gnss"], back_end)
            if (self.folder / _SCANS).is_file():
                p = rewrite_scans(self.folder / _SCANS, moved, folder / _SCANS)
                facts["start_end_gap_m"] = float(np.linalg.norm(p[-1] - p[0])) if len(p) else 0.0
            new = {entry["name"]: entry for entry in hashed_files(sorted(folder.iterdir()))}
            facts["outputs"] = [new.get(entry["name"], entry) for entry in facts.get("outputs", ())]
            write_text(folder / "run.json", json.dumps(facts, indent=2) + "\n")
            for name, text in (beside or {}).items():
                write_text(folder / name, text)
        return account

    def _refined(self, back_end: BackEnd, T_map_imu: Array) -> PlaneRefinement:
        loops = [entry.evidence for entry in self.ledger.accepted()]
        K = len(self.store)
        sizes = sum(len(self.store.points(index)) for index in range(K))
        thin = 1 + sizes // _REFINED_POINTS
        clouds = [
            points[self._kept(points, index, T_map_imu[index])][::thin]
            for index, points in ((index, self.store.points(index)) for index in range(K))
        ]
        covariances = [*back_end.chain.step_covariances[1:], *(loop.covariance for loop in loops)]
        steps = StepsBetween(
            first=np.array([*range(K - 1), *(loop.match for loop in loops)], dtype=np.int64),
            second=np.array([*range(1, K), *(loop.query for loop in loops)], dtype=np.int64),
            covariance=np.array(covariances).reshape(-1, 6, 6),
        )
        return refine_planes(clouds, T_map_imu, steps)


def kept_points(edits: RunEdits, facts: Mapping[str, Any], points_imu: Points, index: int, T_map_imu: Array) -> Mask:
    """Return which of a keyframe's points (N, 3), imu frame, a plan of edits leaves in the map.

    Parameters
    ----------
    edits : RunEdits
    facts : mapping
        The run's ``run.json``.
    points_imu : (N, 3) float32
    index : int
        The keyframe's number.
    T_map_imu : (4, 4) float64
        Its pose in the map that the plan speaks of.
    """
    if _dropped(edits, facts, index):
        return np.zeros(len(points_imu), dtype=bool)
    if not edits.boxes:
        return np.ones(len(points_imu), dtype=bool)
    return edits.kept(transformed(points_imu, np.ascontiguousarray(T_map_imu)))


def _dropped(edits: RunEdits, facts: Mapping[str, Any], index: int) -> bool:
    sessions = sessions_of(facts)
    return any(index in sessions.get(name, range(0)) for name in edits.dropped)


def write_keyframe_map(
    store: KeyframeStore,
    T_map_imu: Array,
    output: OutputConfig,
    folder: Path,
    kept: Callable[[Points, int, Array], Mask] | None = None,
) -> int:
    """Put a map together from keyframes' clouds, write it as a run does, and return the number of its points.

    Parameters
    ----------
    store : KeyframeStore
    T_map_imu : (K, 4, 4) float64
    output : OutputConfig
    folder : Path
    kept : callable, optional
        Cloud, number and pose of a keyframe -> which of its points belong to the map; all by default.

    Raises
    ------
    OutputError
        It cannot be written.
    """
    tiles, part = MapTiles(folder, output.map_voxel), GlobalMap(output.map_voxel)
    try:
        for number, (keyframe, T) in enumerate(zip(store, T_map_imu, strict=True)):
            part.clear()
            points, intensity = keyframe.points_imu, keyframe.intensity
            if kept is not None:
                some = kept(points, keyframe.index, T)
                points, intensity = points[some], None if intensity is None else intensity[some]
            part.insert(np.ascontiguousarray(points), intensity, np.ascontiguousarray(T))
            tiles.add(part.cells(), number)
        bounds = MapBounds(stamps_ns=store.stamps_ns, largest=tiles.largest, brightest=tiles.brightest)
        blocks = (tile.own(tile.whole.averaged(output.surface_thickness)) for tile in tiles)
        return write_map(folder / f"map.{output.map_format}", ((bounds, block) for block in blocks)).count
    finally:
        tiles.close()


def sessions_of(facts: Mapping[str, Any]) -> dict[str, range]:
    """Return the merged sessions that a run's account names, and which keyframes are theirs."""
    sessions: dict[str, range] = {}
    for row in facts.get("sessions", ()):
        if isinstance(row, dict) and type(row.get("first_keyframe")) is int and type(row.get("keyframes")) is int:
            sessions[str(row.get("name"))] = range(row["first_keyframe"], row["first_keyframe"] + row["keyframes"])
    return sessions


def open_run_graph(folder: Path | str) -> RunGraph:
    """Open the graph of a run that has ended.

    Raises
    ------
    FormatError
        It is no folder of a run, the run had no graph, or a file of it is missing or damaged.
    """
    folder = Path(folder)
    facts = read_account(folder)
    if "graph" not in facts:
        raise FormatError(folder, "is a run without a graph (--no-graph, or it has not ended); run it again")
    config = load_config(folder / "config.toml")
    store = KeyframeStore.open(folder / KEYFRAMES)
    ledger = read_ledger(folder / "loops.csv", config.loops)
    _check_ledger(folder / "loops.csv", ledger, len(store))
    if not len(store):
        raise FormatError(folder / KEYFRAMES, "holds no whole keyframe; the store is damaged, run it again")
    T_odom = np.stack([store.T_odom_imu(index) for index in range(len(store))])
    T = _levelled(facts, T_odom)
    fixes = None
    if ledger.accepted() or _held(facts["graph"]):
        graph, values = load_graph(folder / "graph.npz", factors=SENSOR_FACTORS)
        keys = X(np.arange(len(store)))
        if any(key not in values for key in keys.tolist()):
            raise FormatError(
                folder / "graph.npz", f"does not hold the {len(store)} keyframes of the run; run it again"
            )
        T, fixes = np.ascontiguousarray(values.at(keys).matrix[:, :4, :4]), kept_fixes(graph, values)
    edits = read_edits(folder / EDITS) if (folder / EDITS).is_file() else RunEdits()
    return RunGraph(
        folder=folder, config=config, facts=facts, store=store, ledger=ledger, T_map_imu=T, fixes=fixes, edits=edits
    )


def _check_ledger(path: Path, ledger: Ledger, keyframes: int) -> None:
    """Raise where the ledger names keyframes that the store has not, or no longer."""
    for entry in ledger:
        ends = (entry.evidence.query, entry.evidence.match)
        if not 0 <= min(ends) <= max(ends) < keyframes:
            raise FormatError(path, f"loop {entry.number} joins keyframes {ends[0]} and {ends[1]}, and the store holds "
                                    f"{keyframes}; run the recording again")  # fmt: skip


def _refined_facts(refined: PlaneRefinement) -> dict[str, Any]:
    return {
        "refined": refined.refined,
        "reason": refined.reason,
        "planes": refined.planes,
        "thickness_before_m": refined.thickness_before,
        "thickness_after_m": refined.thickness_after,
        "moved_m": refined.moved,
    }


def _held(graph: Mapping[str, Any]) -> bool:
    """Whether more than odometry and loops holds the keyframes: fixes, wheels, or an adjustment over planes."""
    return bool(
        graph.get("gnss", {}).get("aligned")
        or graph.get("wheels", {}).get("scale") is not None
        or graph.get("refined", {}).get("refined")
    )


def _gnss_facts(facts: Mapping[str, Any], back_end: BackEnd) -> dict[str, Any]:
    """Return what the run said of its fixes, with where the map lies now."""
    _, values = back_end.graph()
    if int(Symbol("E")(0)) not in values:
        return dict(facts)
    return {**facts, "T_map_enu": values.at(Symbol("E")(0)).matrix.tolist()}


def _levelled(facts: Mapping[str, Any], T_odom_imu: Array) -> Array:
    """Return the keyframes as a run without loops has them in its map."""
    T_map_odom = np.array(facts.get("T_map_odom", np.eye(4).tolist()), dtype=np.float64)
    return np.ascontiguousarray(T_map_odom @ T_odom_imu)
