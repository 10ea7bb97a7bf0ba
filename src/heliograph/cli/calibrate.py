"""`heliograph calibrate`: what a recording tells about its own sensors.

Each kind of calibration is a module of its own that measures, writes and prints; this one reads the options and calls
it: mounting and clock (`heliograph.cli.calibrate_mounting`), or with ``--noise`` the noise of the IMU
(`heliograph.cli.calibrate_noise`).
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from heliograph.cli import options
from heliograph.cli.names import default_folder, unused

__all__ = ["calibrate"]


def calibrate(
    recordings: options.Recordings,
    noise: Annotated[
        bool, typer.Option("--noise", help="Noise of the IMU, from a rest or from the motion; needs no LiDAR.")
    ] = False,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="DIR", help="Default: ./<recording>_calibration, or _2 ...")
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace a calibration in the folder.")] = False,
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
    """Find rotation, lever arm and clock of the LiDAR on the IMU, each with its uncertainty, or the IMU's noise.

    Directions that the motion did not excite are named, and keep the mounting to start from: the recording's, or that
    of --extrinsic.
    """
    from heliograph.cli.calibrate_mounting import EXTRINSIC, mounting_command
    from heliograph.cli.calibrate_noise import NOISE, noise_command

    resolved = options.build_config(
        config,
        settings,
        run={"threads": threads},
        input=options.input_options(lidar_topic, imu_topic, extrinsic, start, duration),
    )
    result = NOISE if noise else EXTRINSIC  # the two may lie side by side
    folder = output or unused(
        default_folder(recordings, "calibration"), again=overwrite, taken=lambda place: (place / result).exists()
    )
    if noise:
        noise_command(recordings, resolved, folder, overwrite=overwrite, json=json, quiet=quiet)
        return
    mounting_command(recordings, resolved, folder, overwrite=overwrite, json=json, quiet=quiet)
