"""`heliograph calibrate`: what a recording tells about its own sensors.

Each kind of calibration is a module of its own with one function that measures, writes and prints; this one reads the
options and calls it. So far there is the IMU's noise (``--noise``, `heliograph.cli.calibrate_noise`); that of the
mounting and the clocks is what the command will do without ``--noise``.
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

    if not noise:
        raise ConfigError("say what to calibrate: --noise for the noise of the IMU")
    resolved = options.build_config(
        config, settings, input=options.input_options(None, imu_topic, None, start, duration)
    )
    folder = output or Path(f"{recordings[0].resolve().stem}_calibration")
    noise_command(recordings, resolved, folder, overwrite=overwrite, json=json, quiet=quiet)
