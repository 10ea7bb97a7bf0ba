"""A run from its folder: map, way, what was measured scan by scan, keyframes against the map, loops, graph and tree."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from heliograph.config import KdTreeMapConfig
from heliograph.errors import FormatError, HeliographError
from heliograph.factors import SENSOR_FACTORS
from heliograph.graph import ISAM2, load_graph
from heliograph.graph.model.symbols import key_name
from heliograph.guard.account import read_account
from heliograph.guard.files import TABLE, plain_file
from heliograph.io.files.clouds import CLOUD_SUFFIXES, read_cloud
from heliograph.io.files.poses import read_poses
from heliograph.lie import interpolate_se3
from heliograph.maps import KdTreeMap
from heliograph.revision import RunGraph, open_run_graph
from heliograph.viewer.live import MAX_POINTS, SIGMAS
from heliograph.viewer.screen import FAR, HEIGHT, RESIDUAL, Screen, colored

__all__ = ["read_columns", "show_run"]

MAX_MAP_POINTS = 2_000_000
"""Points of the map that are shown; a viewer holds more, a file to share grows by 15 bytes each."""
MAX_CLIQUES = 2_000
"""Keyframes up to which the Bayes tree is built and shown."""
_PIXELS = 20.0  # a metre in the drawing of the graph
_SPACING = 0.1  # of the map's points where its planes are looked for [m]
_PATH, _LOOP, _REFUSED, _TREE = (90, 160, 250), (70, 176, 123), (150, 110, 110), (224, 161, 94)
_CURVES: dict[str, tuple[str, tuple[str, ...]]] = {
    "plots/eigenvalues/translation": ("eigenvalue_translation", ("min", "mid", "max")),
    "plots/eigenvalues/rotation": ("eigenvalue_rotation", ("min", "mid", "max")),
    "plots/gyro_bias": ("gyro_bias", ("x", "y", "z")),
    "plots/gyro_bias_sigma": ("sigma_gyro_bias", ("x", "y", "z")),
    "plots/accel_bias": ("accel_bias", ("x", "y", "z")),
    "plots/accel_bias_sigma": ("sigma_accel_bias", ("x", "y", "z")),
    "plots/position_sigma": ("sigma_position", ("x", "y", "z")),
    "plots/velocity": ("velocity", ("x", "y", "z")),
}
_SINGLE = {"plots/rms": "rms", "plots/matches": "matches", "plots/ms": "ms_total", "plots/weak_share": "weak_share"}


def show_run(folder: Path, screen: Screen, *, residuals: bool = True, scans: Path | None = None) -> list[str]:
    """Show a run that has ended; return what of it there was nothing to show of, a line each.

    Parameters
    ----------
    folder : Path
        What `run` wrote.
    screen : Screen
    residuals : bool
        Colour the clouds of keyframes and scans by their distance to the map's planes, which takes about 20 ms each.
    scans : Path, optional
        The folder that `run --dump-scans` filled: every scan is shown, not the keyframes only.

    Raises
    ------
    FormatError
        It is no folder of a run, the run has not ended, or another version wrote what cannot be read.
    """
    facts = _finished(folder)
    columns = read_columns(folder / "scans.csv")
    missing: list[str] = []
    _show_curves(columns, screen)
    _show_way(folder, columns, screen)
    cloud = _show_map(folder, screen)
    if cloud is None:
        missing.append(f"{folder} holds no map that can be shown: way and curves only")
    _show_account(facts, columns, screen)
    tree = _planes_of(cloud) if residuals and cloud is not None else None
    if scans is not None:
        _show_scans(folder, scans, screen, tree)
    try:
        run = open_run_graph(folder)
    except HeliographError as error:
        missing.append(f"no keyframes, loops or graph to show: {error}")
        return missing
    _show_keyframes(run, screen, tree)
    _show_loops(run, screen)
    missing += _show_graph(run, screen)
    return missing


def _finished(folder: Path) -> dict[str, Any]:
    facts = read_account(folder)
    status = facts.get("status")
    if status is None:
        raise FormatError(folder / "run.json", "is no account of a run; name the folder that `run` wrote")
    if status == "running":
        raise FormatError(
            folder, "is a run that has not ended; wait for it, or finish it with `heliograph run ... --resume`"
        )
    return facts


def read_columns(path: Path) -> dict[str, NDArray[Any]]:
    """Return the columns of a run's ``scans.csv`` by name: integers as int64, words as str, else float64.

    Raises
    ------
    FormatError
        It is missing, holds no row, or was written by a version whose columns are others.
    """
    try:
        with plain_file(path, TABLE).open(encoding="utf-8", newline="") as file:
            rows = list(csv.DictReader(file))
    except (OSError, ValueError, csv.Error) as error:
        raise FormatError(path, f"cannot be read ({error}); run the recording again") from error
    needed = {"end_ns", "verdict", *_SINGLE.values()} | {
        f"{name}_{part}" for name, parts in _CURVES.values() for part in parts
    }
    needed |= {f"position_{axis}" for axis in "xyz"}
    if not rows or (absent := sorted(needed - rows[0].keys())):
        what = "holds no scan" if not rows else f"has no column {absent[0]}: another version wrote it"
        raise FormatError(path, f"{what}; run the recording again")
    try:
        return {
            name: np.array([row[name] for row in rows])
            if name == "verdict"
            else np.array([int(row[name]) for row in rows], dtype=np.int64)
            if name == "end_ns"
            else np.array([float(row[name] or "nan") for row in rows])
            for name in needed
        }
    except (TypeError, ValueError) as error:
        raise FormatError(path, f"holds a row that is none ({error}); run the recording again") from error


def _show_curves(columns: Mapping[str, NDArray[Any]], screen: Screen) -> None:
    stamps = columns["end_ns"]
    for place, (name, parts) in _CURVES.items():
        screen.curves(place, stamps, np.stack([columns[f"{name}_{part}"] for part in parts], axis=1), parts)
    for place, name in _SINGLE.items():
        screen.curves(place, stamps, columns[name][:, None], (name,))
    speed = np.linalg.norm(np.stack([columns[f"velocity_{axis}"] for axis in "xyz"], axis=1), axis=1)
    screen.curves("plots/speed", stamps, speed[:, None], ("speed",))


def _show_way(folder: Path, columns: Mapping[str, NDArray[Any]], screen: Screen) -> None:
    way = read_poses(folder / "trajectory.tum", stamped=True)
    screen.lines("map/trajectory", [way.T_frame_body[:, :3, 3]], _PATH, static=True)
    for stamp, T in zip(way.stamps_ns.tolist(), way.T_frame_body, strict=True):
        screen.at(stamp)
        screen.pose("map/body", T)
    for i, stamp in enumerate(columns["end_ns"].tolist()):
        screen.at(stamp)
        centre = np.array([columns[f"position_{axis}"][i] for axis in "xyz"])
        sigma = np.array([columns[f"sigma_position_{axis}"][i] for axis in "xyz"])
        if np.isfinite(centre).all() and np.isfinite(sigma).all():
            screen.ellipsoid("map/sigma", centre, np.diag(sigma**2), SIGMAS)


def _show_map(folder: Path, screen: Screen) -> NDArray[np.float32] | None:
    path = next((path for suffix in CLOUD_SUFFIXES if (path := folder / f"map{suffix}").is_file()), None)
    if path is None:
        return None
    points = np.ascontiguousarray(read_cloud(path).points, dtype=np.float32)
    points = points[np.isfinite(points).all(axis=1)]
    if not len(points):
        return None
    shown = points[:: max(-(-len(points) // MAX_MAP_POINTS), 1)]
    low, high = np.percentile(shown[:, 2], [1.0, 99.0])
    screen.points("map/points", shown, colors=colored(shown[:, 2], float(low), float(high), HEIGHT), static=True)
    return points


def _show_account(facts: Mapping[str, Any], columns: Mapping[str, NDArray[Any]], screen: Screen) -> None:
    lines = [f"# {facts['status']}", *(f"* {reason}" for reason in facts.get("reasons", []))]
    lines += [f"* **{check['verdict']}** {check['title']}: {check['evidence']}" for check in facts.get("checks", [])]
    screen.document("account", "\n".join(lines))
    before = "first"
    for stamp, verdict in zip(columns["end_ns"].tolist(), columns["verdict"].tolist(), strict=True):
        if verdict != before:
            screen.at(stamp)
            screen.say("events", f"scans are {verdict} from here", "INFO" if verdict == "tracked" else "WARN")
        before = verdict


def _planes_of(cloud: NDArray[np.float32]) -> KdTreeMap:
    tree = KdTreeMap(KdTreeMapConfig(spacing=_SPACING))
    tree.insert(cloud, np.eye(4))
    return tree


def _show_points(
    place: str, points: NDArray[np.float32], T: NDArray[np.float64], screen: Screen, tree: KdTreeMap | None, curve: str
) -> None:
    """Show points (N, 3) [m] below a pose (4, 4), coloured by what they lie off the map's planes, and its RMS."""
    colors = None
    if tree is not None and len(points):
        placed = points.astype(np.float64) @ T[:3, :3].T + T[:3, 3]
        planes = tree.planes_at(placed, gate=1.0)
        off = np.abs(np.einsum("ij,ij->i", planes.normal.astype(np.float64), placed - planes.point))
        off = np.where(planes.source > 0, off, np.nan)
        colors = colored(off, 0.0, FAR, RESIDUAL)
        found = off[np.isfinite(off)]
        screen.values(curve, [float(np.sqrt(np.mean(found**2))) if len(found) else float("nan")])
    screen.points(place, points, colors=colors, size=2.0)


def _show_keyframes(run: RunGraph, screen: Screen, tree: KdTreeMap | None) -> None:
    for index, stamp in enumerate(run.store.stamps_ns.tolist()):
        screen.at(stamp)
        screen.pose("map/keyframe", run.T_map_imu[index])
        _show_points("map/keyframe/points", run.points(index), run.T_map_imu[index], screen, tree, "plots/map_residual")


def _show_scans(folder: Path, scans: Path, screen: Screen, tree: KdTreeMap | None) -> None:
    """Show the scans that were written as files, each where the finished run has it."""
    files = sorted(scans.glob("*.ply")) if scans.is_dir() else []
    if not files:
        raise FormatError(scans, "holds no scans; name the folder that `run --dump-scans` filled")
    ends = _ends_of_scans(folder / "scans.csv")
    rate = folder / "trajectory_imu_rate.tum"
    way = read_poses(rate if rate.is_file() else folder / "trajectory.tum", stamped=True)
    for file in files:
        if (end_ns := ends.get(file.stem.lstrip("0") or "0")) is None:
            raise FormatError(file, f"is no scan of {folder}; name the folder that this run's --dump-scans filled")
        points = np.ascontiguousarray(read_cloud(file).points, dtype=np.float32)
        T = interpolate_se3(way.stamps_ns, way.T_frame_body, np.array([end_ns]), extrapolate=True)[0]
        screen.at(end_ns)
        screen.pose("map/scan", T)
        _show_points(
            "map/scan/points", points[:: -(-len(points) // MAX_POINTS)], T, screen, tree, "plots/scan_residual"
        )


def _ends_of_scans(path: Path) -> dict[str, int]:
    """Return number -> end of each scan [ns]; `read_columns` has seen to it that there is one."""
    with plain_file(path, TABLE).open(encoding="utf-8", newline="") as file:
        return {row["index"]: int(row["end_ns"]) for row in csv.DictReader(file)}


def _show_loops(run: RunGraph, screen: Screen) -> None:
    places = run.T_map_imu[:, :3, 3]
    for place, stands, color in (("map/loops/accepted", True, _LOOP), ("map/loops/rejected", False, _REFUSED)):
        chosen = [entry for entry in run.ledger if (entry.decision.verdict == "accepted") is stands]
        ends = [(entry.evidence.match, entry.evidence.query) for entry in chosen]
        if ends:
            labels = [f"{entry.number}: {entry.decision.text}" for entry in chosen]
            screen.lines(place, [places[list(pair)] for pair in ends], color, static=True, labels=labels)


def _show_graph(run: RunGraph, screen: Screen) -> list[str]:
    """Show keyframes with their steps and loops as a network, and the tree into which the whole graph is eliminated."""
    count = len(run.store)
    names = [f"X{index}" for index in range(count)]
    places = (_PIXELS * run.T_map_imu[:, :2, 3] * [1.0, -1.0]).tolist()  # a picture's y points down
    nodes = {name: (x, y) for name, (x, y) in zip(names, places, strict=True)}
    edges = list(pairwise(names))
    edges += [(names[entry.evidence.match], names[entry.evidence.query]) for entry in run.ledger.accepted()]
    screen.network("graph/factors", nodes, edges, [_PATH] * count)
    if count > MAX_CLIQUES:
        return [f"{count} keyframes: their Bayes tree is not shown (at most {MAX_CLIQUES})"]
    graph, values = load_graph(run.folder / "graph.npz", factors=SENSOR_FACTORS)
    smoother = ISAM2()
    smoother.update(graph, values)
    cliques = smoother.cliques()
    label = {
        clique.number: f"{','.join(map(key_name, clique.pivots))} | {','.join(map(key_name, clique.rows))}".rstrip(" |")
        for clique in cliques
    }
    joined = [(label[c.parent], label[c.number]) for c in cliques if c.parent is not None]
    screen.network("graph/bayes_tree", dict.fromkeys(label.values()), joined, [_TREE] * len(label), directed=True)
    return []
