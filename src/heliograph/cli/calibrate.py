"""`heliograph calibrate`: what a recording tells about its own sensors.

Each kind of calibration is a module of its own that measures, writes and prints; this one reads the options and calls
it. So far there is the noise of the IMU (``--noise``, `heliograph.cli.calibrate_noise.noise_command`). What the command
does without ``--noise``, mounting and clocks, comes after the first ``if`` of `calibrate`, which stays as it is.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from heliograph.cli import options

__all__ = ["calibrate"]


def calibrate(
    recordings: options.Recordings,
    noise: Annotated[
        bool, typer.Option("--noise", help="Noise of the IMU, from a rest or from the motion; needs no LiDAR.")
    ] = False,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="DIR", help="Default: ./<recording>_calibration.")
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace a calibration in the folder.")] = False,
    imu_topic: options.ImuTopic = None,
    start: options.Start = None,
    duration: options.Duration = None,
    config: options.ConfigFile = None,
    settings: options.Settings = None,
    json: options.Json = False,
    quiet: options.Quiet = False,
) -> None:
    """Measure what a recording tells about its own sensors, each number with its uncertainty."""
    from heliograph.cli.calibrate_noise import noise_command
    from heliograph.errors import ConfigError

    resolved = options.build_config(
        config, settings, input=options.input_options(None, imu_topic, None, start, duration)
    )
    folder = output or Path(f"{recordings[0].resolve().stem}_calibration")
    if noise:
        noise_command(recordings, resolved, folder, overwrite=overwrite, json=json, quiet=quiet)
        return
    raise ConfigError("say what to calibrate: --noise for the noise of the IMU")
