"""`heliograph localize`: a recording in a saved map."""

from __future__ import annotations

import time
from contextlib import ExitStack, closing
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from heliograph.cli import options
from heliograph.cli.activity import stage
from heliograph.cli.closing import print_closing
from heliograph.cli.names import default_folder, title, unused
from heliograph.guard.scratch import ScratchFolder

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from heliograph.config import RunConfig

__all__ = ["check_extension", "extend_map", "localize", "localized_lines", "start_pose"]


def localize(
    recordings: options.Recordings,
    saved_map: Annotated[
        Path, typer.Option("--map", metavar="RUN|CLOUD", help="Folder of a run, or a cloud: LAZ, LAS, PLY, PCD.")
    ],
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="DIR", help="Default: ./<recording>_localized, or _2 ...")
    ] = None,
    start_at: Annotated[
        str | None,
        typer.Option("--start-pose", metavar="X,Y,Z,YAW", help="Where it begins in the map: metres, degrees."),
    ] = None,
    extend: Annotated[
        Path | None,
        typer.Option("--extend", metavar="DIR", help="Write the map with this recording's keyframes in it to DIR."),
    ] = None,
    overwrite: options.Overwrite = False,
    reader: options.Reader = None,
    odometry: Annotated[
        str | None, typer.Option("--odometry", metavar="NAME|FILE", help="Estimator, or poses of another system.")
    ] = None,
    lidar_topic: options.LidarTopic = None,
    imu_topic: options.ImuTopic = None,
    extrinsic: options.Extrinsic = None,
    start: options.Start = None,
    duration: options.Duration = None,
    threads: options.Threads = None,
    config: options.ConfigFile = None,
    settings: options.Settings = None,
    json: options.Json = False,
    quiet: options.Quiet = False,
) -> None:
    """Find a recording in a saved map and follow it there: localised, ambiguous, or not localised, scan by scan.

    What is not known is an answer: exit code 0, and no pose in trajectory.tum.
    """
    from heliograph import pipeline
    from heliograph.cli.interrupt import interruptible
    from heliograph.cli.progress import ProgressSink
    from heliograph.config_toml import dump_config
    from heliograph.errors import DataError
    from heliograph.io import open_recording
    from heliograph.localization import Localizer
    from heliograph.localization.folder import LocalizationFolder
    from heliograph.localization.open_map import open_map
    from heliograph.output.facts import plain, versions
    from heliograph.output.manifest import hashed_inputs

    resolved = options.build_config(
        config,
        settings,
        run={"odometry": odometry, "threads": threads},
        input=options.input_options(lidar_topic, imu_topic, extrinsic, start, duration, reader),
        slam={"graph": extend is not None},
    )
    check_extension(saved_map, extend, output)
    T_start = None if start_at is None else start_pose(start_at)
    began = time.perf_counter()
    stage("reading the map")
    saved = open_map(saved_map, resolved)
    stage("opening the recording")
    opening = time.perf_counter() - began
    name = title(recordings[0])
    with ExitStack() as stack:
        stop = stack.enter_context(interruptible())
        recording = stack.enter_context(open_recording(recordings, resolved.input, sensors=resolved.sensors))
        if "lidar" not in pipeline.sensors_in_use(recording, resolved):
            raise DataError("a map is matched with scans, and the recording holds no LiDAR; name its topic")
        cores = pipeline.thread_count(resolved)

        def facts() -> dict[str, Any]:
            summary = plain(recording.summary())
            summary.pop("inferences", None)
            return {
                "map": {"path": saved_map.name, "submaps": len(saved), "opening_s": opening},
                "recording": summary,
                "inputs": hashed_inputs(recordings, resolved.output.hash_inputs),
                "versions": versions(),
            }

        folder = LocalizationFolder(
            output or unused(default_folder(recordings, "localized"), again=overwrite),
            lambda: Localizer(saved, resolved, start=T_start, threads=cores),
            name=name, config=dump_config(resolved), facts=facts, overwrite=overwrite,
        )  # fmt: skip
        bar = [] if quiet else [ProgressSink(recording.total_scans, name)]
        scratch = stack.enter_context(closing(ScratchFolder())) if extend else None
        keyframes = scratch.path if scratch else None
        pipeline.run(recording, resolved, sinks=[*bar, folder], stop=stop, folder=keyframes)
        print_closing(folder.facts, folder.path, json=json, quiet=quiet, lines=localized_lines)
        if extend is not None and keyframes is not None:
            extend_map(saved_map, keyframes, name, resolved, extend, overwrite=overwrite, quiet=json or quiet)
    if folder.facts["interrupted"] and stop.code:
        raise typer.Exit(stop.code)


def check_extension(saved_map: Path, extend: Path | None, output: Path | None) -> None:
    """Raise `ConfigError` where a map cannot be extended, before an hour's work is done."""
    from heliograph.errors import ConfigError

    if extend is None:
        return
    if not saved_map.is_dir():
        raise ConfigError(f"--extend adds keyframes to those of a run, and {saved_map} is a cloud; give a run's folder")
    if extend.resolve() in (saved_map.resolve(), None if output is None else output.resolve()):
        raise ConfigError(f"--extend {extend} is the map itself or the output; the map is left as it is: name another")


def extend_map(
    saved_map: Path, keyframes: Path, name: str, config: RunConfig, to: Path, *, overwrite: bool, quiet: bool
) -> None:
    """Merge a recording's keyframes into a copy of the map's."""
    from heliograph.cli.merge import merged_lines
    from heliograph.merging import open_session, session_of_keyframes
    from heliograph.merging.folder import merge_into

    stage("adding to the map")
    sessions = [open_session(saved_map), session_of_keyframes(keyframes, name, config)]
    facts = merge_into(
        sessions, to, overwrite=overwrite, watch=lambda done, total: stage("adding to the map, place", done, total)
    )
    if not quiet:
        typer.echo("\n".join(merged_lines(facts, to)))


def start_pose(text: str) -> NDArray[np.float64]:
    """Return ``x,y,z,yaw`` in metres and degrees as a pose (4, 4).

    Raises
    ------
    ConfigError
        It is not four finite numbers.
    """
    import numpy as np

    from heliograph.errors import ConfigError
    from heliograph.lie import se3, so3

    try:
        x, y, z, yaw = (float(word) for word in text.split(","))
        if not np.isfinite([x, y, z, yaw]).all():
            raise ValueError
    except ValueError:
        raise ConfigError(
            f"--start-pose '{text}' is not x,y,z,yaw: four numbers with commas between, in metres and degrees, such as "
            "12.5,-3,1.2,90"
        ) from None
    return se3.from_rotation_translation(so3.from_rpy(0.0, 0.0, np.radians(yaw)), np.array([x, y, z]))


def localized_lines(facts: dict[str, Any], folder: Path) -> list[str]:
    """Return what a localisation amounted to."""
    lock, states = facts["first_lock_s"], facts["scans_by_state"]
    first = "never localised" if lock is None else f"localised after {lock:.1f} s"
    counts = ", ".join(f"{count} {state}" for state, count in states.items() if count)
    lines = [f"{facts['scans']} scans over {facts['distance_m']:.1f} m: {first}; {counts}"]
    begin = facts["states"][0]["begin_ns"] if facts["states"] else 0
    for span in facts["states"][:8]:
        seconds = [1e-9 * (span[key] - begin) for key in ("begin_ns", "end_ns")]
        places = f": {span['places']} places" if span["state"] == "ambiguous" else ""
        lines.append(f"  {seconds[0]:.1f} to {seconds[1]:.1f} s {span['state']}{places}")
    tracking = "" if facts["tracking_ms"] is None else f"; {facts['tracking_ms']:.1f} ms a scan in the map"
    query = facts["query_ms"]
    lines.append(
        f"{facts['queries']} queries of {facts['submaps']} submaps, {query['mean']:.0f} ms on average, at most "
        f"{query['max']:.0f}{tracking}, {facts['odometry_ms']:.1f} ms of odometry"
    )
    changes = facts["changes"]
    if changes["gone_points"] + changes["new_points"]:
        lines.append(
            f"changed since the map was made: {changes['gone_points']} points are gone, {changes['new_points']} new: "
            "changes.ply"
        )
    lines.append(f"written to {folder}: {', '.join(facts['files'])}")
    lines.append(f"status: {facts['status']}" + "".join(f"; {reason}" for reason in facts["reasons"]))
    return lines
