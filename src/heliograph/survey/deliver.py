"""The files of a survey, from a run's folder: map, tracks, and how accurate they are."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import Array, Mask, Points, Stamps
from heliograph.atomic import write_text
from heliograph.config_toml import load_config
from heliograph.edits import EDITS, RunEdits, read_edits
from heliograph.errors import ConfigError, DataError, FormatError
from heliograph.io.files.clouds import read_cloud
from heliograph.io.files.poses import read_poses
from heliograph.lie import se3
from heliograph.output.survey_files import ACCURACY, replaced_files
from heliograph.revision import kept_points, write_keyframe_map
from heliograph.slam import KEYFRAMES, KeyframeStore
from heliograph.survey.coordinates import CoordinateSystem, find_coordinate_system
from heliograph.survey.e57 import station_poses, write_survey_e57
from heliograph.survey.las import write_survey_las, write_survey_tiles
from heliograph.survey.placed_run import PlacedRun
from heliograph.survey.sbet import write_sbet, write_smrmsg
from heliograph.survey.tracks import SurveyTrack, write_csv_track, write_gpx_track, write_kml_track

__all__ = ["accuracy", "deliver"]

_CELL = 2.0  # points in a cube of this edge share a time [m]
_BLOCK = 2048  # cubes compared with the keyframes at once


def deliver(
    run: PlacedRun, crs: str, control: dict[str, Any] | None = None, *, tile: float = 0.0, e57: bool = False
) -> list[Path]:
    """Write map, trajectories and ``accuracy.json`` into the run's folder.

    Parameters
    ----------
    run : PlacedRun
    crs : str
        As `find_coordinate_system` takes it.
    control : mapping, optional
        What the account of accuracy says of control points.
    tile : float
        Edge of the map's tiles, each a file, with an index [m]; 0: one file.
    e57 : bool
        Whether the keyframes' clouds are written too, each with its pose.

    Returns
    -------
    list of Path
        The files.

    Raises
    ------
    DataError
        The run is not placed on Earth, and the system is not ``local``.
    ConfigError
        The system is not known or cannot be used, or a tile has no such edge.
    MissingDependencyError
        A file needs a package that is not installed.
    """
    if run.origin_deg is None and crs.lower() != "local":
        why = run.facts["graph"].get("gnss", {}).get("reason") or "there were no satellite fixes"
        raise DataError(
            f"the run is not placed on Earth ({why}): --crs {crs} cannot be; give control points, or --crs local"
        )
    if tile != 0.0 and not 1.0 <= tile <= 100_000.0:
        raise ConfigError(f"--tile {tile:g} is no edge of a tile: give 1 to 100000 m, or 0 for one file")
    origin_deg = np.zeros(3) if run.origin_deg is None else run.origin_deg
    system = find_coordinate_system(crs, origin_deg)
    track = _track(run)
    files = [*_map_files(run, system, tile), *_track_files(run, track, system)]
    if e57:
        files.append(run.folder / f"map_{system.tag}.e57")
        store = KeyframeStore.open(run.folder / KEYFRAMES)
        try:
            write_survey_e57(files[-1], store, station_poses(run.T_enu_map @ run.T_map_imu, system), system)
        finally:
            store.close()
    names = [str(path.relative_to(run.folder)) for path in files]
    earlier = replaced_files(run.folder, f"map_{system.tag}", names)
    said = {**accuracy(run, system, track, control), "files": [*names, *earlier]}
    write_text(run.folder / ACCURACY, json.dumps(said, indent=2) + "\n")
    return [*files, run.folder / ACCURACY]


def _map_files(run: PlacedRun, system: CoordinateSystem, tile: float) -> Iterator[Path]:
    """Write the map and yield its files: one, or tiles and their index."""
    points, intensity = _map(run)
    p, stamps = system.from_enu(se3.act(run.T_enu_map, points)), _times(points, run)
    identifier = f"Heliograph {run.folder.name}"
    if tile == 0.0:
        path = run.folder / f"map_{system.tag}.laz"
        write_survey_las(path, p, intensity, stamps, system, identifier)
        yield path
        return
    yield from write_survey_tiles(run.folder / f"map_{system.tag}", tile, p, intensity, stamps, system, identifier)


def _track_files(run: PlacedRun, track: SurveyTrack, system: CoordinateSystem) -> list[Path]:
    files = [run.folder / f"trajectory_{system.tag}.csv"]
    write_csv_track(files[0], track, system)
    if run.origin_deg is None:
        return files
    writers = {"gpx": write_gpx_track, "kml": write_kml_track, "sbet": write_sbet, "smrmsg": write_smrmsg}
    for suffix, write in writers.items():
        files.append(run.folder / f"trajectory.{suffix}")
        write(files[-1], track, system.origin)
    return files


def accuracy(
    run: PlacedRun, system: CoordinateSystem, track: SurveyTrack, control: dict[str, Any] | None
) -> dict[str, Any]:
    """Return how accurate the survey is, per axis, and how that was obtained."""
    gnss = run.facts["graph"].get("gnss", {})
    absolute = None
    if run.origin_deg is not None:
        absolute = {
            "sigma_east_north_up_m": np.sqrt((track.sigma**2).mean(axis=0)).tolist(),
            "worst_sigma_m": float(track.sigma.max()),
            "sigma_heading_deg": float(np.degrees(track.sigma_heading).max()),
            "residual_rms_enu_m": gnss.get("residual_rms_enu_m"),
            "how": "marginals of the solved graph: odometry, loops, satellite fixes, control points; root mean square "
            "over the trajectory. Errors that all fixes share (the reference station, the datum) are not in them.",
        }
    return {
        "coordinate_system": system.name,
        "heights_above": system.height,
        "absolute": absolute,
        "relative": {
            "sigma_start_to_end_m": _relative(run),
            "how": "position of the last keyframe against the first one, of the same graph",
        },
        "control_points": control,
        "status": run.facts.get("status"),
    }


def _relative(run: PlacedRun) -> list[float]:
    from heliograph.graph import Marginals, Symbol

    P = Marginals(run.graph, run.values).covariance(int(Symbol("X")(len(run.stamps_ns) - 1)))[3:6, 3:6]
    R = run.T_map_imu[-1, :3, :3]
    return np.sqrt(np.diag(R @ P @ R.T)).tolist()  # type: ignore[no-any-return]


def _track(run: PlacedRun) -> SurveyTrack:
    """Return the run's trajectory in east-north-up; sigmas are those of the keyframes, between them interpolated."""
    trajectory = read_poses(run.folder / "trajectory.tum", stamped=True)
    position, heading = run.sigmas()
    at = [np.interp(trajectory.stamps_ns, run.stamps_ns, column) for column in (*position.T, heading)]
    return SurveyTrack(
        stamps_ns=trajectory.stamps_ns,
        T_enu_body=run.T_enu_map @ run.moved.T_map_odom(trajectory.stamps_ns) @ trajectory.T_frame_body,
        sigma=np.stack(at[:3], axis=-1),
        sigma_heading=at[3],
    )


def _map(run: PlacedRun) -> tuple[Array, NDArray[np.float32] | None]:
    """Return the run's map (N, 3); where it was bent since, put together anew from the keyframes' clouds."""
    T_moved = run.moved.rigid
    if T_moved is None:
        return _map_of_keyframes(run)
    for name in ("map.ply", "map.pcd"):
        if (run.folder / name).is_file():
            cloud = read_cloud(run.folder / name)
            return se3.act(T_moved, cloud.points.astype(np.float64)), cloud.intensity
    raise FormatError(
        run.folder, "holds no map.ply or map.pcd; run again without --map-format laz (--crs writes LAZ too)"
    )


def _map_of_keyframes(run: PlacedRun) -> tuple[Array, NDArray[np.float32] | None]:
    """Return the map as the run would write it from its keyframes, without what a plan of edits leaves out."""
    output = replace(load_config(run.folder / "config.toml").output, map_format="ply")
    edits = read_edits(run.folder / EDITS) if (run.folder / EDITS).is_file() else RunEdits()

    def kept(points: Points, index: int, _moved: Array) -> Mask:
        return kept_points(edits, run.facts, points, index, run.T_files_imu[index])  # boxes lie in the map as it was

    store = KeyframeStore.open(run.folder / KEYFRAMES)
    try:
        with TemporaryDirectory(prefix="heliograph_") as scratch:
            write_keyframe_map(store, run.T_map_imu, output, Path(scratch), kept)
            cloud = read_cloud(Path(scratch) / "map.ply")
    finally:
        store.close()
    return cloud.points.astype(np.float64), cloud.intensity


def _times(points: Array, run: PlacedRun) -> Stamps:
    """Return when the sensor was nearest to each point (N,), to the next keyframe; points of a cube share it."""
    cells = np.floor(points / _CELL).astype(np.int64)
    low, size = cells.min(axis=0), np.ptp(cells, axis=0) + 1
    code = ((cells[:, 0] - low[0]) * size[1] + cells[:, 1] - low[1]) * size[2] + cells[:, 2] - low[2]
    _, first, cube = np.unique(code, return_index=True, return_inverse=True)
    centres, keyframes = points[first], run.T_map_imu[:, :3, 3]
    nearest = np.empty(len(centres), dtype=np.int64)
    for start in range(0, len(centres), _BLOCK):
        part = centres[start : start + _BLOCK]
        square = (part**2).sum(axis=1)[:, None] - 2.0 * part @ keyframes.T + (keyframes**2).sum(axis=1)
        nearest[start : start + _BLOCK] = np.argmin(square, axis=1)
    return np.asarray(run.stamps_ns[nearest[cube.ravel()]])
