"""`heliograph calibrate RECORDING --noise`: the IMU's noise, with plots and a configuration that `run` takes."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from heliograph.cli.activity import stage
from heliograph.report.noise import TERM_UNITS, noise_charts

if TYPE_CHECKING:
    import numpy as np

    from heliograph.calibration.noise import NoiseCalibration, SensorNoise
    from heliograph.config import RunConfig
    from heliograph.data import Event, ImuBatch
    from heliograph.imu.noise_fit import TermEstimate
    from heliograph.io import Recording

__all__ = ["NOISE", "calibrate_noise", "noise_command", "noise_config", "noise_facts", "noise_lines", "read_imu"]

NOISE = "noise.toml"
_AXES = tuple(f"{sensor} {axis}" for sensor in ("gyro", "accel") for axis in "xyz")
_LETTERS = {"quantisation": "Q", "white": "N", "flicker": "B", "walk": "K", "ramp": "R"}


def noise_command(
    paths: list[Path], config: RunConfig, folder: Path, *, overwrite: bool, json: bool, quiet: bool
) -> None:
    """Do what ``heliograph calibrate --noise`` does: measure, write, print.

    Raises
    ------
    OutputError
        The folder holds a noise calibration and ``overwrite`` is off, or cannot be written.
    """
    import sys

    import typer

    from heliograph.errors import OutputError

    if (folder / NOISE).exists() and not overwrite:
        raise OutputError(f"{folder} holds a noise calibration already; choose another with -o or add --overwrite")
    lines, facts = calibrate_noise(paths, config, folder)
    if json:
        typer.echo(_json(facts))
    if json or quiet:
        for warning in facts["warnings"]:
            print(f"warning: {warning['message']}", file=sys.stderr)
    else:
        typer.echo("\n".join(lines))


def calibrate_noise(paths: list[Path], config: RunConfig, folder: Path) -> tuple[list[str], dict[str, Any]]:
    """Measure the noise of a recording's IMU and write what was found into a folder.

    Parameters
    ----------
    paths : list of Path
        The recording; it needs no LiDAR.
    config : RunConfig
        Input options, and densities to fall back on.
    folder : Path
        Made where it is missing; gets ``noise.toml``, ``noise.json``, ``noise.csv`` and two pictures.

    Returns
    -------
    lines : list of str
        For people.
    facts : dict
        For ``--json``.

    Raises
    ------
    DataError
        No IMU, or too few samples.
    OutputError
        A file cannot be written.
    """
    return _write_files(*_measure(paths, config, folder), config, folder)


def _measure(paths: list[Path], config: RunConfig, folder: Path) -> tuple[NoiseCalibration, str, list[Event]]:
    """Return the result, the recording's name, and its own warnings."""
    from heliograph.atomic import check_output_directory
    from heliograph.calibration.noise import calibrate_noise as measure
    from heliograph.io import open_recording

    stage("reading the IMU")
    with open_recording(paths, config.input, sensors="imu") as recording:
        check_output_directory(folder, overwrite=True)  # before the work; nothing in it is replaced yet
        imu = read_imu(recording)
        warnings = [event for event in recording.events if event.severity != "info"]
        name = recording.description
    stage("measuring the noise")
    return measure(imu, config.imu), name, warnings


def _write_files(
    result: NoiseCalibration, name: str, warnings: list[Event], config: RunConfig, folder: Path
) -> tuple[list[str], dict[str, Any]]:
    """Write the files; return lines and facts."""
    from heliograph.atomic import write_text

    files = {NOISE: noise_config(result, config, name), **noise_charts(result)}
    for file, content in files.items():
        write_text(folder / file, content)
    _write_table(folder / "noise.csv", result)
    facts = noise_facts(result, name)
    facts["warnings"] = [{"code": e.code, "message": e.message} for e in warnings] + facts["warnings"]
    facts |= {"folder": str(folder), "files": [*files, "noise.csv", "noise.json"]}
    write_text(folder / "noise.json", _json(facts) + "\n")
    lines = [*noise_lines(result), *(f"warning: {event.message}" for event in warnings)]
    lines.append(f"written to {folder}: {', '.join(facts['files'])}")
    lines.append(f"use it: heliograph run RECORDING --config {folder / NOISE}")
    return lines, facts


def read_imu(recording: Recording) -> ImuBatch:
    """Return all IMU samples of a recording as one batch.

    Raises
    ------
    DataError
        There are none.
    """
    from heliograph.data import ImuBatch
    from heliograph.errors import DataError

    batches = [record for record in recording.stream() if isinstance(record, ImuBatch)]
    if not batches:
        raise DataError(f"{recording.description}: no usable IMU sample; see `heliograph info`")
    return ImuBatch.joined(batches)


def noise_config(result: NoiseCalibration, config: RunConfig, name: str) -> str:
    """Return TOML for ``heliograph run --config``: densities that the recording shows, none that it does not."""
    rows = [
        f"# Noise of the IMU in {' '.join(name.split())}, read from {_evidence(result)}",
        "# by `heliograph calibrate --noise`; use it with `heliograph run --config`.",
        "# White noise is raised where more was measured, never lowered: no rest shows what else a moving IMU errs by,",
        "# such as its scale, and a filter told less than the default was found to track worse.",
        "[imu]",
    ]
    for sensor, found in (("gyro", result.gyro), ("accel", result.accel)):
        default = getattr(config.imu, f"{sensor}_noise")
        if found.white is None or found.for_filter is None:
            rows.append(f"# {sensor}_noise: not above {found.white_upper:.3g}; {default:g} stays")
        else:
            shaken = f", {found.with_vibration:.4g} with vibration" if found.with_vibration is not None else ""
            low = f"; {default:g} stays, see above" if found.for_filter < default else ""
            rows.append(f"# measured {found.white:.4g} +- {found.white_sigma:.1g}{shaken}{low}")
            rows.append(f"{sensor}_noise = {max(found.for_filter, default):.6g}")
        if found.walk is None:
            bound = f"not above {found.walk_upper:.3g}" if found.walk_upper < float("inf") else "unknown"
            rows.append(f"# {sensor}_walk: not seen in this recording, {bound}; the default stays")
        else:
            rows.append(f"# measured {found.walk:.4g} +- {found.walk_sigma:.1g}")
            rows.append(f"{sensor}_walk = {found.walk:.6g}")
    return "\n".join(rows) + "\n"


def noise_facts(result: NoiseCalibration, name: str) -> dict[str, Any]:
    """Return the result as plain values for JSON; what the recording does not show is null with an upper bound."""
    from heliograph.output.facts import plain

    facts: dict[str, Any] = {
        "recording": name,
        "evidence": result.evidence,
        "rate_hz": result.rate,
        "duration_s": result.duration,
        "densities": {"gyro": _sensor_facts(result.gyro), "accel": _sensor_facts(result.accel)},
        "axes": [_axis_facts(result, k) for k in range(6)],
        "warnings": [{"code": e.code, "message": e.message} for e in result.events if e.severity != "info"],
        "remarks": [{"code": e.code, "message": e.message} for e in result.events if e.severity == "info"],
    }
    if result.rest is not None:
        facts["rest"] = [
            {"begin_s": 1e-9 * (begin - result.begin_ns), "duration_s": length}
            for begin, length in result.rest.stretches
        ]
    plain_facts: dict[str, Any] = plain(facts)
    return plain_facts


def noise_lines(result: NoiseCalibration) -> list[str]:
    """Return the result in words: a table of the axes, the densities for a filter, the remarks."""
    lines = [f"{result.duration:.1f} s at {result.rate:.4g} Hz; read from {_evidence(result)}"]
    lines += _rest_table(result) if result.rest is not None else _motion_table(result)
    for sensor, found in (("gyro", result.gyro), ("accel", result.accel)):
        white = _value(found.white, found.white_sigma, found.white_upper, TERM_UNITS["white"][sensor])
        walk = _value(found.walk, found.walk_sigma, found.walk_upper, TERM_UNITS["walk"][sensor])
        lines.append(f"{sensor} for a filter: white noise {white}, random walk that stands for flicker too {walk}")
    lines += [f"{event.severity}: {event.message}" for event in result.events]
    return lines


def _evidence(result: NoiseCalibration) -> str:
    if result.rest is None:
        return "the spectrum above the motion"
    total = sum(length for _, length in result.rest.stretches)
    if len(result.rest.stretches) == 1:
        begin = 1e-9 * (result.rest.stretches[0][0] - result.begin_ns)
        return f"{total:.1f} s at rest from {begin:.1f} s on"
    return f"{total:.1f} s at rest in {len(result.rest.stretches)} stretches"


def _value(value: float | None, sigma: float | None, upper: float, unit: str = "") -> str:
    if value is not None and sigma is not None:
        # As many digits as the sigma leaves meaning to, but few enough to read.
        digits = min(max(math.ceil(math.log10(value / sigma)) + 1, 2), 5) if 0.0 < sigma < value else 2
        return f"{value:#.{digits}g} ±{sigma:.1g} {unit}".rstrip()
    return f"not seen (< {upper:.2g})" if 0.0 < upper < float("inf") else "not seen"


def _rest_table(result: NoiseCalibration) -> list[str]:
    assert result.rest is not None
    rows = [["", *(f"{_LETTERS[name]} {name}" for name in _LETTERS), "least deviation"]]
    for k, channel in enumerate(result.rest.channels):
        cells = [_value(t.value, t.sigma, t.upper) for t in (channel.term(name) for name in _LETTERS)]
        floor = f"{result.rest.floor[k]:.3g} at {result.rest.floor_tau[k]:.3g} s"
        rows.append([_AXES[k], *cells, floor])
    for k, sensor in enumerate(("gyro", "accel")):
        rows.insert(
            1 + 4 * k,
            [sensor, *(f"[{TERM_UNITS[name][sensor]}]" for name in _LETTERS), f"[{TERM_UNITS['flicker'][sensor]}]"],
        )
    unclear = [_AXES[k] for k, channel in enumerate(result.rest.channels) if not channel.told_apart]
    remark = f"{', '.join(unclear)}: a slow drift is seen, but flicker and walk cannot be told apart; record longer"
    return [*_align_columns(rows), *([remark] if unclear else [])]


def _motion_table(result: NoiseCalibration) -> list[str]:
    motion = result.motion
    assert motion is not None
    rows = [["", "N white", "read from", "with vibration"]]
    for k, name in enumerate(_AXES):
        white = _value(
            float(motion.density[k]) if motion.flat[k] else None, float(motion.sigma[k]), _motion_upper(motion, k)
        )
        rows.append([name, white, f"{motion.band[k, 0]:.3g} to {motion.band[k, 1]:.3g} Hz", f"{motion.loud[k]:.3g}"])
    for k, (sensor, unit) in enumerate(TERM_UNITS["white"].items()):
        rows.insert(1 + 4 * k, [sensor, f"[{unit}]", "", f"[{unit}]"])
    return _align_columns(rows)


def _motion_upper(motion: Any, k: int) -> float:  # noqa: ANN401 - WhiteFloor, imported for types only
    return float(motion.density[k] + 1.645 * motion.sigma[k])


def _align_columns(rows: list[list[str]]) -> list[str]:
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    return ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]


def _sensor_facts(found: SensorNoise) -> dict[str, float | None]:
    return {
        "white": found.white,
        "white_sigma": found.white_sigma,
        "white_upper": found.white_upper,
        "walk": found.walk,
        "walk_sigma": found.walk_sigma,
        "walk_upper": found.walk_upper,
        "with_vibration": found.with_vibration,
    }


def _axis_facts(result: NoiseCalibration, k: int) -> dict[str, Any]:
    facts: dict[str, Any] = {"axis": _AXES[k]}
    if result.rest is not None:
        channel = result.rest.channels[k]
        facts |= {_LETTERS[t.name]: _term_facts(t) for t in channel.terms}
        facts |= {
            "least_deviation": result.rest.floor[k],
            "least_deviation_tau_s": result.rest.floor_tau[k],
            "top_hz": channel.top,
            "flicker_and_walk_told_apart": channel.told_apart,
        }
    if result.motion is not None:
        motion = result.motion
        facts["in_motion"] = {
            "white": motion.density[k],
            "white_sigma": motion.sigma[k],
            "flat": bool(motion.flat[k]),
            "band_hz": motion.band[k],
            "with_vibration": motion.loud[k],
        }
    return facts


def _term_facts(term: TermEstimate) -> dict[str, float | None]:
    return {"value": term.value, "sigma": term.sigma, "upper": term.upper}


def _write_table(path: Path, result: NoiseCalibration) -> None:
    """Write the curves: Allan deviations with their intervals at rest, spectra in motion."""
    from heliograph.io.files.csvs import CsvWriter

    columns, table = _curve_table(result)
    with CsvWriter(path, columns) as writer:
        for row in table:
            writer.append([float(value) for value in row])


def _curve_table(result: NoiseCalibration) -> tuple[list[str], np.ndarray[Any, np.dtype[np.float64]]]:
    import numpy as np

    names = [axis.replace(" ", "_") for axis in _AXES]
    if result.rest is not None:
        rest = result.rest
        parts = [rest.curve.tau[:, None]]
        parts += [np.column_stack([rest.curve.deviation[:, k], rest.intervals[k]]) for k in range(6)]
        return ["tau_s", *(f"{name}{tail}" for name in names for tail in ("", "_low", "_high"))], np.hstack(parts)
    assert result.motion is not None
    return ["frequency_hz", *names], np.column_stack([result.motion.frequency, result.motion.spectrum])


def _json(facts: dict[str, Any]) -> str:
    import json

    return json.dumps(facts, indent=1, allow_nan=False)
