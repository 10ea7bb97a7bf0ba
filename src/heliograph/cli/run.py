"""`heliograph run`: the main job."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from heliograph.cli import options
from heliograph.cli.activity import stage
from heliograph.cli.closing import print_closing
from heliograph.cli.extra_sinks import extra_sinks
from heliograph.cli.names import default_folder, title, unused
from heliograph.cli.options import MapFormat
from heliograph.cli.resume import checkpoints_of, finished_run, is_run, taken_up
from heliograph.cli.survey import check_coordinate_system, deliver_run

if TYPE_CHECKING:
    from heliograph.config import RunConfig
    from heliograph.io import Recording
    from heliograph.output.run_folder import RunFolder
    from heliograph.output.sink import Sink

__all__ = ["execute", "run"]


def run(
    recordings: options.Recordings,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="DIR", help="Default: ./<recording>_heliograph, or _2 ...")
    ] = None,
    overwrite: options.Overwrite = False,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on with a run that was cut off, from its last checkpoint.")
    ] = False,
    reader: options.Reader = None,
    odometry: Annotated[
        str | None, typer.Option("--odometry", metavar="NAME|FILE", help="Estimator, or poses of another system.")
    ] = None,
    sensors: Annotated[
        str | None,
        typer.Option("--sensors", metavar="LIST", help="lidar,imu | lidar | imu; default: what the recording holds."),
    ] = None,
    lidar_topic: options.LidarTopic = None,
    imu_topic: options.ImuTopic = None,
    extrinsic: options.Extrinsic = None,
    start: options.Start = None,
    duration: options.Duration = None,
    threads: options.Threads = None,
    frame: Annotated[
        str | None,
        typer.Option("--frame", metavar="NAME", help="Body of the poses: imu, lidar or a frame of the recording."),
    ] = None,
    no_graph: Annotated[bool, typer.Option("--no-graph", help="Odometry alone: no keyframes, no graph.")] = False,
    no_loops: Annotated[bool, typer.Option("--no-loops", help="Look for no loops.")] = False,
    no_gnss: Annotated[bool, typer.Option("--no-gnss", help="Use no satellite fixes.")] = False,
    gnss: Annotated[
        Path | None,
        typer.Option(
            "--gnss", metavar="FILE", help="Fixes beside the recording: NMEA, RTKLIB .pos, CSV with a header."
        ),
    ] = None,
    wheels: Annotated[
        str | None,
        typer.Option(
            "--wheels", metavar="FILE|TOPIC", help="Speeds of wheels or legs: a CSV stamp,vx[,vy,vz], or a topic."
        ),
    ] = None,
    crs: Annotated[
        str | None,
        typer.Option("--crs", metavar="NAME", help="Deliver in a coordinate system too: local, utm, EPSG:25832 ..."),
    ] = None,
    no_repair: Annotated[bool, typer.Option("--no-repair", help="Mend no fault of the data, however plain.")] = False,
    keep_moving: Annotated[
        bool, typer.Option("--keep-moving", help="Leave in the map what other scans saw through.")
    ] = False,
    dump_scans: Annotated[
        Path | None, typer.Option("--dump-scans", metavar="DIR", help="De-skewed scans too, a PLY each.")
    ] = None,
    view: Annotated[bool, typer.Option("--view", help="Watch it in Rerun while it runs.")] = False,
    rrd: Annotated[
        Path | None, typer.Option("--rrd", metavar="FILE", help="Write what --view shows to a file to share.")
    ] = None,
    map_format: Annotated[MapFormat | None, typer.Option("--map-format", help="Format of the map file.")] = None,
    config: options.ConfigFile = None,
    settings: options.Settings = None,
    json: options.Json = False,
    quiet: options.Quiet = False,
) -> None:
    """Estimate a recording's trajectory and de-skewed map, and say how far they are to be trusted."""
    resolved = options.build_config(
        config,
        settings,
        run={"odometry": odometry, "sensors": options.sensor_list(sensors), "threads": threads},
        input={
            **options.input_options(lidar_topic, imu_topic, extrinsic, start, duration, reader),
            "repair": False if no_repair else None,
        },
        slam={"graph": False if no_graph else None, "loops": False if no_loops else None},
        wheels=options.wheel_options(wheels),
        gnss={"use": False if no_gnss else None, "file": None if gnss is None else str(gnss)},
        output={
            "body": frame,
            "map_format": map_format and map_format.value,
            "drop_moving": False if keep_moving else None,
        },
    )
    if crs is not None:
        check_coordinate_system(crs)
    if resume and overwrite:
        raise typer.BadParameter("--resume goes on with a run, --overwrite begins it anew: give one of them")
    output = output or unused(destination(recordings, None), again=resume or overwrite)
    if resume and (facts := finished_run(destination(recordings, output))) is not None:
        print_closing(facts, destination(recordings, output), json=json, quiet=quiet)
        return
    with extra_sinks(destination(recordings, output).name, view=view, rrd=rrd, dump_scans=dump_scans) as extra:
        folder, interrupted = execute(
            recordings, resolved, output, overwrite=overwrite, progress=not quiet, resume=resume, sinks=extra.sinks
        )
        if extra.screen is not None:
            stage("showing the whole run")
        extra.show(folder.path)
    print_closing(folder.facts, folder.path, json=json, quiet=quiet)
    if crs is not None:
        deliver_run(folder.path, crs)
    if interrupted:
        raise typer.Exit(interrupted)


def execute(
    recordings: list[Path],
    config: RunConfig,
    output: Path | None,
    *,
    overwrite: bool,
    progress: bool,
    resume: bool = False,
    sinks: Sequence[Sink] = (),
) -> tuple[RunFolder, int]:
    """Open a recording, run the pipeline on it, and write its folder; or go on with a run that was cut off.

    Returns
    -------
    folder : RunFolder
        With the account (``facts``) and the record of the run.
    interrupted : int
        Exit code for what ended it early, Ctrl-C or a signal; 0 where nothing did.
    """
    from heliograph import pipeline
    from heliograph.cli.interrupt import interruptible
    from heliograph.cli.progress import ProgressSink
    from heliograph.errors import OutputError
    from heliograph.io import open_recording
    from heliograph.io.files.poses import is_pose_file
    from heliograph.odometry import find_odometry
    from heliograph.output.manifest import hashed_inputs

    if not is_pose_file(config.odometry):
        find_odometry(config.odometry)  # a wrong name is told before a recording is opened
    stage("opening the recording")
    began = time.perf_counter()
    with interruptible() as stop, open_recording(recordings, config.input, sensors=config.sensors) as recording:
        pipeline.sensors_in_use(recording, config)  # a wrong choice is told before a folder is made
        inputs = hashed_inputs(recordings, config.output.hash_inputs)
        checkpoints = checkpoints_of(destination(recordings, output), config, inputs)
        resume, overwrite = resume and taken_up(checkpoints), overwrite or (resume and is_run(checkpoints.folder))
        made = _folder(recording, config, recordings, checkpoints.folder, inputs, overwrite=overwrite, resume=resume)
        with made as folder:
            opening = time.perf_counter() - began
            bar = [ProgressSink(recording.total_scans, folder.name)] if progress else []
            try:
                summary = pipeline.run(
                    recording,
                    config,
                    sinks=[*bar, *sinks, folder],
                    stop=stop,
                    opening_seconds=opening,
                    folder=folder.path,
                    checkpoints=checkpoints,
                )
            except OutputError as error:
                done = folder.record.summary.scans if folder.record else 0
                if not done:
                    raise
                raise OutputError(f"{error}; what could be saved of {done} scans is in {folder.path}") from error
    return folder, stop.code if summary.interrupted else 0


def destination(recordings: list[Path], output: Path | None) -> Path:
    """Return the folder that a run writes: the one given, or one named after the recording."""
    return output or default_folder(recordings, "heliograph")


def _folder(
    recording: Recording,
    config: RunConfig,
    paths: list[Path],
    output: Path,
    inputs: list[dict[str, Any]],
    *,
    overwrite: bool,
    resume: bool,
) -> RunFolder:
    """Prepare the output folder for a recording."""
    import numpy as np

    from heliograph.config_toml import dump_config
    from heliograph.output.facts import plain, versions
    from heliograph.output.run_folder import RunFolder
    from heliograph.pipeline import sensors_in_use, thread_count
    from heliograph.report import write_report

    known_versions = versions()

    def facts() -> dict[str, Any]:
        recorded = plain(recording.summary())
        return {
            "inferences": recorded.pop("inferences", []),
            "recording": recorded,
            "inputs": inputs,
            "versions": known_versions,
        }

    return RunFolder(
        output,
        name=title(paths[0]),
        config=dump_config(config),
        output=config.output,
        T_imu_body=np.asarray(recording.transform(config.output.body)),
        has_map="lidar" in sensors_in_use(recording, config),
        threaded=thread_count(config) > 1,
        facts=facts,
        finishers=(write_report,),
        overwrite=overwrite,
        resume=resume,
    )
