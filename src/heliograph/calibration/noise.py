"""The noise of an IMU from any recording: at rest by all its terms, in motion by its white noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from heliograph.arrays import Array, freeze
from heliograph.config import ImuConfig
from heliograph.data import Event, ImuBatch, ImuNoise
from heliograph.imu.allan import AllanCurve, allan_curve
from heliograph.imu.bands import band_spectrum
from heliograph.imu.noise_fit import ChannelNoise, TermEstimate, fit_channel
from heliograph.imu.noise_terms import allan_variance
from heliograph.imu.stretches import Grid, even_stretches, still_stretches
from heliograph.imu.white_floor import WhiteFloor, white_floor

__all__ = ["NoiseCalibration", "RestNoise", "SensorNoise", "calibrate_noise", "noise_at_rest"]


_SENSORS = ("gyro", "accel")
_MIN_REST_SHARE = 0.8  # with less of the record at rest, what vibration adds in motion is measured too
_MAX_FILLED_SHARE = 0.05  # of interpolated samples that are not worth a warning
_MAX_MISFIT = 0.2  # of an octave's power that is worth a remark
_LOUD_FACTOR = 1.5  # vibration this much above the floor is worth a remark


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorNoise:
    """One density of a sensor, as a filter takes it: the root mean square over the axes that show it.

    Parameters
    ----------
    white, white_sigma : float or None
        White noise [rad/s/sqrt(Hz)] or [m/s^2/sqrt(Hz)]; None where the record gives no more than a bound.
    walk, walk_sigma : float or None
        Random walk of the bias [rad/s^2/sqrt(Hz)] or [m/s^3/sqrt(Hz)]; None where no axis shows one.
    white_upper, walk_upper : float
        With 95 % confidence no axis is above it; infinite where nothing is known.
    with_vibration : float or None
        White noise and the vibration that a filter meets as noise, over the whole recording; None where it was all at
        rest or has no floor.
    """

    white: float | None
    white_sigma: float | None
    walk: float | None
    walk_sigma: float | None
    white_upper: float
    walk_upper: float
    with_vibration: float | None

    @property
    def for_filter(self) -> float | None:
        """White noise that a filter should be given; None where it is not known."""
        return max((d for d in (self.white, self.with_vibration) if d is not None), default=None)


@dataclass(frozen=True, slots=True, kw_only=True)
class RestNoise:
    """What a rest tells: six channels, gyroscope first.

    Parameters
    ----------
    channels : tuple of ChannelNoise
        Fitted terms.
    curve : AllanCurve
        Allan deviations.
    intervals : (6, t, 2) float64
        Their one-sigma intervals.
    floor, floor_tau : (6,) float64
        Least Allan deviation and the averaging time where it lies [s]; a data sheet's "in-run bias stability".
    stretches : tuple of (int, float)
        Begin [ns] and length [s] of each rest.
    """

    channels: tuple[ChannelNoise, ...]
    curve: AllanCurve
    intervals: Array
    floor: Array
    floor_tau: Array
    stretches: tuple[tuple[int, float], ...]

    def __post_init__(self) -> None:
        freeze(self)


@dataclass(frozen=True, slots=True, kw_only=True)
class NoiseCalibration:
    """The noise of an IMU and where it was read.

    Parameters
    ----------
    evidence : str
        ``"rest"`` or ``"motion"``.
    gyro, accel : SensorNoise
        For a filter.
    noise : ImuNoise
        The same, with the configured value for whatever the recording does not show.
    rest : RestNoise or None
        What the still part tells.
    motion : WhiteFloor or None
        What the whole tells; None where it rests nearly throughout.
    begin_ns : int
        Time of the first sample [ns].
    rate, duration : float
        Samples a second [Hz]; time covered by samples [s].
    events : tuple of Event
        Warnings and remarks.
    """

    evidence: str
    gyro: SensorNoise
    accel: SensorNoise
    noise: ImuNoise
    rest: RestNoise | None
    motion: WhiteFloor | None
    begin_ns: int
    rate: float
    duration: float
    events: tuple[Event, ...]


def calibrate_noise(imu: ImuBatch, config: ImuConfig) -> NoiseCalibration:
    """Return the noise of an IMU from a recording, moving or not.

    Where the IMU rests for five seconds or more the terms of IEEE 952 are fitted there. Where it never does, its white
    noise is read from the part of the spectrum that motion does not reach, and random walks stay unknown.

    Parameters
    ----------
    imu : ImuBatch
        All samples of the recording.
    config : ImuConfig
        Limits of stillness, and densities to fall back on.

    Raises
    ------
    DataError
        Too few samples, or stamps that do not increase.
    """
    grid = even_stretches(imu)
    still = still_stretches(grid, config)
    events = _grid_events(grid)
    rest = noise_at_rest(still) if still.stretches else None
    motion = white_floor(grid) if still.duration < _MIN_REST_SHARE * grid.duration else None
    if rest is not None:
        gyro, accel = (_from_rest(rest.channels[3 * k : 3 * k + 3], motion, slice(3 * k, 3 * k + 3)) for k in range(2))
        events += _rest_events(rest)
    else:
        assert motion is not None
        gyro, accel = (_from_motion(motion, slice(3 * k, 3 * k + 3)) for k in range(2))
        events.append(_moving_event(grid))
    if motion is not None:
        events += _motion_events(motion, alone=rest is None)
    return NoiseCalibration(
        evidence="rest" if rest is not None else "motion",
        gyro=gyro,
        accel=accel,
        noise=ImuNoise(
            gyro=gyro.for_filter or config.gyro_noise,
            accel=accel.for_filter or config.accel_noise,
            gyro_walk=gyro.walk or config.gyro_walk,
            accel_walk=accel.walk or config.accel_walk,
        ),
        rest=rest,
        motion=motion,
        begin_ns=int(imu.stamps_ns[0]),
        rate=1.0 / grid.period,
        duration=grid.duration,
        events=tuple(events),
    )


def noise_at_rest(still: Grid) -> RestNoise:
    """Return Allan deviations and fitted terms of a record at rest.

    Parameters
    ----------
    still : Grid
        From `heliograph.imu.stretches.still_stretches`, with at least one stretch.

    Raises
    ------
    DataError
        No stretch is long enough.
    """
    curve = allan_curve(still)
    signals = [stretch.samples for stretch in still.stretches]
    channels = tuple(fit_channel(band_spectrum([s[:, k] for s in signals], still.period)) for k in range(6))
    intervals = np.stack([curve.interval(_dominating(channel, curve), k) for k, channel in enumerate(channels)])
    lowest = curve.deviation.argmin(axis=0)
    return RestNoise(
        channels=channels,
        curve=curve,
        intervals=intervals,
        floor=curve.deviation[lowest, np.arange(6)],
        floor_tau=curve.tau[lowest],
        stretches=tuple((s.begin_ns, still.period * len(s)) for s in still.stretches),
    )


def _dominating(channel: ChannelNoise, curve: AllanCurve) -> list[str]:
    """Return the strongest term at each averaging time, on which the confidence depends."""
    parts = allan_variance(channel.model, curve.tau, curve.period)
    names = list(parts)
    strongest = np.argmax(np.stack(list(parts.values())), axis=0)
    return [names[k] if channel.model else "white" for k in strongest]


def _from_rest(axes: tuple[ChannelNoise, ...], motion: WhiteFloor | None, part: slice) -> SensorNoise:
    white, white_sigma, white_upper = _pool([axis.term("white") for axis in axes])
    walk, walk_sigma, walk_upper = _pool([axis.walk_of_filter for axis in axes])
    return SensorNoise(
        white=white,
        white_sigma=white_sigma,
        walk=walk,
        walk_sigma=walk_sigma,
        white_upper=white_upper,
        walk_upper=walk_upper,
        with_vibration=_vibrating(motion, part),
    )


def _vibrating(motion: WhiteFloor | None, axes: slice) -> float | None:
    if motion is None or not motion.flat[axes].all():
        return None
    return float(np.sqrt(np.mean(motion.loud[axes] ** 2)))


def _pool(terms: list[TermEstimate]) -> tuple[float | None, float | None, float]:
    """Return root mean square, its sigma, and the largest bound; an axis that does not show the term is left out."""
    upper = max(term.upper for term in terms)
    seen = [(term.value, term.sigma) for term in terms if term.value is not None and term.sigma is not None]
    if not seen:
        return None, None, upper
    value, sigma = np.array(seen).T
    rms = float(np.sqrt(np.mean(value**2)))
    return rms, float(np.sqrt(np.sum((value * sigma) ** 2))) / (rms * len(seen)), upper


def _from_motion(motion: WhiteFloor, axes: slice) -> SensorNoise:
    density, sigma = motion.density[axes], motion.sigma[axes]
    rms = float(np.sqrt(np.mean(density**2)))
    seen = bool(motion.flat[axes].all())
    return SensorNoise(
        white=rms if seen else None,
        white_sigma=float(np.sqrt(np.sum((density * sigma) ** 2))) / (3.0 * rms) if seen else None,
        walk=None,
        walk_sigma=None,
        white_upper=float((density + 1.645 * sigma).max()),
        walk_upper=float("inf"),
        with_vibration=_vibrating(motion, axes),
    )


def _grid_events(grid: Grid) -> list[Event]:
    samples = sum(len(stretch) for stretch in grid.stretches)
    if grid.filled <= _MAX_FILLED_SHARE * samples:
        return []
    text = (
        f"{grid.filled} of {samples} IMU samples are missing here and there and were interpolated; white noise reads "
        f"up to {50.0 * grid.filled / samples:.0f} % low - check the recorder's load"
    )
    return [Event(code="noise-losses", message=text, count=grid.filled)]


def _moving_event(grid: Grid) -> Event:
    text = (
        f"nothing in these {grid.duration:.0f} s rests for 5 s: white noise is read from the spectrum above the "
        f"motion, random walks are not seen - record an hour with the IMU on a table for all of it"
    )
    return Event(code="noise-moving", message=text, severity="info")


def _rest_events(rest: RestNoise) -> list[Event]:
    events = []
    axes = [f"{sensor} {axis}" for sensor in _SENSORS for axis in "xyz"]
    dead = [name for name, channel in zip(axes, rest.channels, strict=True) if not channel.model]
    if dead:
        text = f"{', '.join(dead)}: the readings never change; the sensor is dead, clipped or coarser than its noise"
        events.append(Event(code="noise-constant", message=text))
    lines = sorted({line for channel in rest.channels for line in channel.lines})
    if lines:
        shown = ", ".join(f"{line:.4g}" for line in lines[:6]) + (" ..." if len(lines) > 6 else "")
        text = f"narrow peaks at {shown} Hz were left out: a fan or hum, not noise of the sensor"
        events.append(Event(code="noise-lines", message=text, severity="info"))
    low = 0.3 / rest.curve.period  # clearly below half the rate
    cut = [f"{name} above {c.top:.3g} Hz" for name, c in zip(axes, rest.channels, strict=True) if c.top < low]
    if cut:
        text = f"the spectrum bends, by the sensor's own filter or by vibration, and was left out: {', '.join(cut)}"
        events.append(Event(code="noise-bend", message=text, severity="info"))
    worst = max(range(6), key=lambda k: rest.channels[k].misfit)
    if rest.channels[worst].misfit > _MAX_MISFIT:
        text = (
            f"{axes[worst]}: an octave of the spectrum is {100.0 * rest.channels[worst].misfit:.0f} % off the fitted "
            f"terms; something else is in it, such as a draught, footsteps or the sensor's own filter - see the plot"
        )
        events.append(Event(code="noise-misfit", message=text))
    return events


def _motion_events(motion: WhiteFloor, *, alone: bool) -> list[Event]:
    events = []
    for k, sensor in enumerate(_SENSORS):
        axes = slice(3 * k, 3 * k + 3)
        if alone and not motion.flat[axes].all():
            text = (
                f"{sensor}: the spectrum has no flat part above the motion; its lowest level is an upper bound only - "
                f"record a minute at rest"
            )
            events.append(Event(code="noise-no-floor", message=text))
        ratio = float(np.sqrt(np.mean(motion.loud[axes] ** 2) / max(float(np.mean(motion.density[axes] ** 2)), 1e-300)))
        if ratio > _LOUD_FACTOR and motion.flat[axes].all():
            text = (
                f"{sensor}: over the whole recording vibration raises the noise {ratio:.1f} times; the configuration "
                f"gets that level, {_vibrating(motion, axes):.2g} - damp the mounting"
            )
            events.append(Event(code="noise-vibration", message=text))
    return events
