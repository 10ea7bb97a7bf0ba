"""`heliograph calibrate`: how the LiDAR sits on the IMU, how their clocks agree, and what the motion could tell."""

from __future__ import annotations

import json as jsonlib
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from heliograph.cli.activity import stage

if TYPE_CHECKING:
    from heliograph.calibration import Calibration
    from heliograph.calibration.observability import CalibratedAxis
    from heliograph.config import RunConfig

__all__ = ["EXTRINSIC", "calibration_facts", "mounting_command"]

EXTRINSIC, _FACTS = "extrinsic.toml", "calibration.json"
_HEADER = """Found by `heliograph calibrate`; give it to `heliograph run --extrinsic FILE`.
p_imu = T_imu_lidar @ p_lidar; t_imu = t_lidar + offset + drift_ppm * 1e-6 * (t_lidar - reference_ns), in seconds.
The clock belongs to this recording: on another day calibrate again, or leave drift_ppm out."""


def mounting_command(
    paths: list[Path], config: RunConfig, folder: Path, *, overwrite: bool, json: bool, quiet: bool
) -> None:
    """Do what ``heliograph calibrate`` does without ``--noise``: find, write, print.

    Raises
    ------
    OutputError
        The folder holds a calibration and ``overwrite`` is off, or cannot be written.
    DataError, CalibrationError
        The recording does not serve.
    """
    from heliograph.errors import OutputError

    if (folder / EXTRINSIC).exists() and not overwrite:
        raise OutputError(f"{folder} holds a calibration already; choose another with -o or add --overwrite")
    found, warnings = _calibrate(paths, config, folder)
    facts = {**calibration_facts(found), "warnings": warnings, "folder": str(folder), "files": [EXTRINSIC, _FACTS]}
    try:
        _write(folder, found, facts)
    except OutputError:  # the disk may have filled up meanwhile; what was found is told all the same
        _tell(found, {**facts, "files": []}, json=json, quiet=quiet)
        raise
    _tell(found, facts, json=json, quiet=quiet)


def _tell(found: Calibration, facts: dict[str, Any], *, json: bool, quiet: bool) -> None:
    if json or quiet:
        for warning in facts["warnings"]:
            print(f"warning: {warning}", file=sys.stderr)
        if json:
            typer.echo(jsonlib.dumps(facts, allow_nan=False))
        return
    _show(found, facts)


def _calibrate(paths: list[Path], config: RunConfig, folder: Path) -> tuple[Calibration, list[str]]:
    """Calibrate a recording; return what was found, and what to warn of."""
    from contextlib import closing

    from heliograph import pipeline
    from heliograph.atomic import check_output_directory
    from heliograph.calibration import calibrate as find
    from heliograph.io import open_recording

    threads = pipeline.thread_count(config)
    stage("opening the recording")
    with open_recording(paths, config.input, sensors="lidar,imu") as recording:
        check_output_directory(folder, overwrite=True)  # before the work; nothing in it is replaced yet
        with closing(pipeline.messages(recording, frozenset({"lidar", "imu"}), threads)) as stream:
            found = find(_counted(stream, recording.total_scans), recording.rig, config, threads=threads)
        warnings = [e.message for e in recording.events if e.severity != "info" and e.code != "unknown-mount"]
    if not found.converged:
        warnings.append(
            f"the rounds had not converged after {found.passes}: take the sigmas with care, or allow more with "
            "--set calibration.passes=12"
        )
    return found, warnings


def _counted(stream: Iterable[Any], total: int | None) -> Iterator[Any]:
    """Pass messages on, and tell how many scans have gone by."""
    from heliograph.data import Scan

    scans = 0
    for message in stream:
        scans += isinstance(message, Scan)
        stage("following the scans", scans, total or 0)
        yield message
    stage("solving for mounting and clock")


def calibration_facts(found: Calibration) -> dict[str, Any]:
    """Return a calibration in plain values, SI units."""
    rig, clock = found.rig, found.rig.clock
    return {
        "T_imu_lidar": rig.T_imu_lidar.tolist(),
        "clock": {"offset_s": clock.offset, "drift": clock.drift, "reference_ns": clock.reference_ns},
        "axes": [
            {
                "name": axis.name,
                "value": axis.value,
                "sigma": axis.sigma,
                "prior_sigma": axis.prior_sigma,
                "verdict": axis.verdict,
                "remedy": axis.remedy,
            }
            for axis in found.axes
        ],
        "kept": list(found.kept),
        "covariance": found.covariance.tolist(),
        "excitation": [
            {
                "axis": e.axis,
                "rate_rms": e.rate,
                "acceleration_rms": e.acceleration,
                "rotation_gain": e.rotation_gain,
                "lever_gain": e.lever_gain,
            }
            for e in found.excitation
        ],
        "gravity": {"vector_odom": found.g_odom.tolist(), "direction_sigma": found.tilt_sigma},
        "gyro_bias": {"value": found.gyro_bias.tolist(), "sigma": found.bias_sigma[:3].tolist()},
        "accel_bias": {"value": found.accel_bias.tolist(), "sigma": found.bias_sigma[3:].tolist()},
        "imu_noise": {
            "gyro": found.noise.gyro,
            "accel": found.noise.accel,
            "gyro_walk": found.noise.gyro_walk,
            "accel_walk": found.noise.accel_walk,
        },
        "scan_noise": {"rotation": found.residual_rotation, "position": found.residual_position},
        "prior": {"T_imu_lidar": found.prior.T_imu_lidar.tolist(), "source": found.prior.source},
        "duration_s": found.duration,
        "scans": found.scans,
        "passes": found.passes,
        "converged": found.converged,
    }


def _write(folder: Path, found: Calibration, facts: dict[str, Any]) -> None:
    from heliograph.atomic import write_text
    from heliograph.io.files.extrinsic import write_extrinsic

    notes = {
        "axes": [f"{axis.name}: {_value(axis)} +- {_sigma(axis)}, {axis.verdict}" for axis in found.axes],
        "kept": list(found.kept),
        "scans": found.scans,
        "duration_s": round(found.duration, 3),
    }
    write_extrinsic(folder / EXTRINSIC, found.rig, notes, header=_HEADER)
    write_text(folder / _FACTS, jsonlib.dumps(facts, allow_nan=False, indent=1) + "\n")


_SHOWN = {"rotation": ("deg", 57.29577951308232, 3), "lever": ("m", 1.0, 4), "clock offset": ("ms", 1e3, 3)}


def _unit(axis: CalibratedAxis) -> tuple[str, float, int]:
    """Return unit, factor from SI and decimals to show a number with."""
    for start, shown in _SHOWN.items():
        if axis.name.startswith(start):
            return shown
    return "ppm", 1e6, 1


def _value(axis: CalibratedAxis) -> str:
    unit, factor, decimals = _unit(axis)
    return f"{factor * axis.value:+.{decimals}f} {unit}"


def _sigma(axis: CalibratedAxis) -> str:
    unit, factor, decimals = _unit(axis)
    return f"{factor * axis.sigma:.{decimals}f} {unit}"


def _show(found: Calibration, facts: dict[str, Any]) -> None:
    from heliograph.cli.info import print_table
    from heliograph.cli.terminal import console as words_console

    console = words_console()
    clock = found.rig.clock
    print(
        f"calibrated from {found.scans} scans over {found.duration:.1f} s in {found.passes} rounds; "
        f"start: {found.prior.source}"
    )
    print_table(
        console,
        ("axis (imu)", "found", "1-sigma", "verdict", "remedy"),
        [(axis.name, _value(axis), _sigma(axis), axis.verdict, axis.remedy) for axis in found.axes],
    )
    print_table(
        console,
        ("imu axis", "rate rms", "acceleration rms", "rotation gained", "lever arm gained"),
        [
            (
                e.axis,
                f"{57.29577951308232 * e.rate:.1f} deg/s",
                f"{e.acceleration:.2f} m/s^2",
                f"x {e.rotation_gain:.3g}",
                f"x {e.lever_gain:.3g}",
            )
            for e in found.excitation
        ],
    )
    print()
    for line in found.kept:
        print(line)
    for warning in facts["warnings"]:
        print(f"warning: {warning}")
    gyro, accel = (", ".join(f"{x:+.{d}f}" for x in v) for v, d in ((found.gyro_bias, 5), (found.accel_bias, 4)))
    print(f"rotations are changes from the start, about the imu's axes; clock at {clock.reference_ns} ns")
    print(
        f"gyro bias ({gyro}) rad/s, accelerometer bias ({accel}) m/s^2; gravity's direction to "
        f"+- {57.29577951308232 * found.tilt_sigma:.3f} deg"
    )
    if facts["files"]:
        print(f"written to {facts['folder']}: {', '.join(facts['files'])}")
        print(f"use it: heliograph run RECORDING --extrinsic {Path(facts['folder']) / EXTRINSIC}")
