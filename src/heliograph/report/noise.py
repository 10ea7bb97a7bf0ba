"""The pictures of a noise calibration: Allan deviations at rest, spectra in motion."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from heliograph.imu.noise_terms import FLICKER_FLOOR, allan_variance
from heliograph.report.loglog import Curve, Guide, loglog_svg

if TYPE_CHECKING:
    from heliograph.calibration.noise import NoiseCalibration, RestNoise
    from heliograph.imu.white_floor import WhiteFloor

__all__ = ["TERM_UNITS", "noise_charts"]

_NAMES = {"gyro": "Gyroscope", "accel": "Accelerometer"}
_UNITS = {"gyro": "rad/s", "accel": "m/s²"}
TERM_UNITS = {
    "quantisation": {"gyro": "rad", "accel": "m/s"},
    "white": {"gyro": "rad/s/√Hz", "accel": "m/s²/√Hz"},
    "flicker": {"gyro": "rad/s", "accel": "m/s²"},
    "walk": {"gyro": "rad/s²/√Hz", "accel": "m/s³/√Hz"},
    "ramp": {"gyro": "rad/s²", "accel": "m/s³"},
}
"""Units of the coefficients of `heliograph.imu.noise_terms.TERMS` and the ramp."""


def noise_charts(result: NoiseCalibration) -> dict[str, str]:
    """Return file name -> SVG, one for each sensor."""
    charts = {}
    for first, sensor in ((0, "gyro"), (3, "accel")):
        if result.rest is not None:
            charts[f"noise_{sensor}.svg"] = _allan_chart(result.rest, sensor, first, result.rate)
        else:
            assert result.motion is not None
            charts[f"noise_{sensor}.svg"] = _spectrum_chart(result.motion, sensor, first, result.duration)
    return charts


def _allan_chart(rest: RestNoise, sensor: str, first: int, rate: float) -> str:
    tau = rest.curve.tau
    curves: list[Curve] = []
    for k, axis in enumerate("xyz"):
        channel = rest.channels[first + k]
        low, high = rest.intervals[first + k].T
        curves.append(Curve(x=tau, y=rest.curve.deviation[:, first + k], low=low, high=high, color=k + 1, label=axis))
        if channel.model:
            parts = allan_variance(channel.model, tau, rest.curve.period)
            fitted = np.sqrt(sum(parts.values(), np.zeros_like(tau)))
            curves.append(Curve(x=tau, y=fitted, color=k + 1, dashed=True, label="fit" if k == 2 else ""))
    length = sum(seconds for _, seconds in rest.stretches)
    return loglog_svg(
        curves,
        _guides(rest, sensor, first),
        title=f"{_NAMES[sensor]} at rest: Allan deviation",
        note=f"{length:.0f} s at {rate:.4g} Hz; bands hold the true value with 68 %; dotted: one term alone",
        x_label="averaging time τ [s]",
        y_label=f"Allan deviation [{_UNITS[sensor]}]",
    )


def _guides(rest: RestNoise, sensor: str, first: int) -> list[Guide]:
    """Return where the terms are read off, for the mean of the axes that show them: N at 1 s, K at 3 s, B anywhere."""
    guides = []
    tau = rest.curve.tau
    middle = float(np.exp(np.mean(np.log(rest.floor_tau[first : first + 3]))))
    for name, letter, at, slope, gain, words in (
        ("white", "N", 1.0, -0.5, 1.0, "slope −½"),
        ("flicker", "B", middle, 0.0, FLICKER_FLOOR, "level 0.664 B"),
        ("walk", "K", 3.0, 0.5, 1.0, "slope +½"),
        ("quantisation", "Q", float(tau[0]), -1.0, 3.0**0.5 / float(tau[0]), "slope −1"),
    ):
        values = [rest.channels[k].term(name).value for k in range(first, first + 3)]
        known = [value for value in values if value is not None]
        if known:
            value = float(np.sqrt(np.mean(np.square(known))))
            # A read-off point outside the record or far below the curves is moved along its line to where it shows.
            at_shown = _shown_at(rest, first, at, value * gain, slope)
            y = value * gain * (at_shown / at) ** slope
            title = f"{letter} {value:.2g} {TERM_UNITS[name][sensor]}, {words}"
            guides.append(Guide(x=at_shown, y=y, slope=slope, name=title, below=name == "quantisation"))
    return guides


def _shown_at(rest: RestNoise, first: int, at: float, y: float, slope: float) -> float:
    """Return the averaging time nearest to ``at`` where the line is not far below the measured curves."""
    tau, curve = rest.curve.tau, rest.curve.deviation[:, first : first + 3].min(axis=1)
    line = y * (tau / at) ** slope
    near = line > 0.4 * curve
    if not near.any():
        near = line >= (line / curve).max() * curve * 0.999
    choices = tau[near]
    return float(choices[np.argmin(np.abs(np.log(choices / at)))])


def _spectrum_chart(motion: WhiteFloor, sensor: str, first: int, duration: float) -> str:
    axes = slice(first, first + 3)
    curves = [
        Curve(x=motion.frequency, y=motion.spectrum[:, first + k], color=k + 1, label=axis)
        for k, axis in enumerate("xyz")
    ]
    for k in range(3):
        if motion.flat[first + k]:
            band = motion.band[first + k]
            curves.append(
                Curve(
                    x=np.maximum(band, motion.frequency[0]),
                    y=np.full(2, motion.density[first + k]),
                    color=k + 1,
                    dashed=True,
                    label="floor" if k == 2 else "",
                )
            )
    unit, guides = _UNITS[sensor], []
    if motion.flat[axes].all():
        value = float(np.sqrt(np.mean(motion.density[axes] ** 2)))
        at = float(np.sqrt(np.prod(motion.band[first])))
        guides.append(Guide(x=at, y=value, slope=0.0, name=f"N {value:.2g} {unit}/√Hz"))
    return loglog_svg(
        curves,
        guides,
        title=f"{_NAMES[sensor]} in motion: spectrum",
        note=f"{duration:.0f} s, the calm {100.0 * motion.calm:.0f} % of it; motion fills the low frequencies, "
        "the floor is noise",
        x_label="frequency [Hz]",
        y_label=f"density [{unit}/√Hz]",
    )
