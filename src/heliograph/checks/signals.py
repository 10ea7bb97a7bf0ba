"""Whether the IMU's channels tell the motion: stuck, coarse or repeated values, clipping, vibration."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import Array
from heliograph.checks.evidence import Evidence
from heliograph.checks.records import Finding, Number
from heliograph.checks.windows import period_s

__all__ = ["check_channels", "check_saturation", "check_vibration"]


_MIN_SAMPLES = 50
_STUCK_SHARE = 0.5  # of the samples that stand still while other channels move
_REPEATED_SHARE = 0.1  # of the samples that repeat all six values of the one before
_MAX_RESOLUTION = {
    "gyroscope": 0.01,
    "accelerometer": 0.1,
}  # resolution above which it shows in the result [rad/s], [m/s^2]
_UNITS = {"gyroscope": "rad/s", "accelerometer": "m/s^2"}
_MIN_CLIPPED, _PILE_FACTOR = 4, 5.0  # samples at the very end of the range, and how many times as many as just below it
_EQUAL_FACTOR = 4.0  # times as often as any other value far out; the crest of a sine on a coarse grid has 2.4 times
_RANGE_TOLERANCE = 0.03  # by which the ends of a range may differ
_VIBRATION_HZ = 15.0  # above what bodies do [Hz]
_BLOWS, _LINE_SHARE = 8.0, 0.5  # kurtosis above, and share of the peak below which it is footfalls and no motor
_SEGMENT_SAMPLES = 512  # samples of one spectrum
_NYQUIST_SHARE = 0.85
_AXES = "xyz"


def check_channels(evidence: Evidence) -> Finding:
    """Look for channels that do not follow the motion: stuck, repeated or coarse values."""
    code, title, batch = "imu-channels", "channels", evidence.batch
    if len(batch) < _MIN_SAMPLES:
        return Finding(code=code, title=title, verdict="unknown", evidence=f"{len(batch)} samples are too few to tell")
    channels = {"gyroscope": batch.gyro, "accelerometer": batch.accel}
    same = np.concatenate([np.diff(values, axis=0) == 0.0 for values in channels.values()], axis=1)
    repeated = float(np.all(same, axis=1).mean())
    alone = (same & ~np.all(same, axis=1)[:, None]).mean(axis=0)  # stands still while something else moves
    step = {name: _resolution(values) for name, values in channels.items()}
    stuck = [f"{name} {axis}" for name in channels for axis in _AXES]
    stuck = [
        name for name, share, values in zip(stuck, alone, _columns(channels), strict=True) if _is_stuck(share, values)
    ]
    numbers = (
        Number(name="stuck channels", value=float(len(stuck)), limit=0.0),
        Number(name="repeated samples", value=repeated, limit=_REPEATED_SHARE),
        *(
            Number(name=f"{name} step", value=step[name], unit=_UNITS[name], limit=_MAX_RESOLUTION[name])
            for name in channels
        ),
    )
    if stuck:
        verdict, text = "fail", f"{', '.join(stuck)} {'does' if len(stuck) == 1 else 'do'} not change with the motion"
        remedy = "look at the driver's parsing and at the sensor: an axis without signal makes every estimate wrong"
    elif repeated > _REPEATED_SHARE:
        verdict, text = "warn", f"{100 * repeated:.0f} % of the samples repeat all six values of the one before"
        remedy = "record at the sensor's true rate: the driver publishes more often than the sensor measures"
    elif coarse := [name for name in channels if step[name] > _MAX_RESOLUTION[name]]:
        sizes = " and ".join(f"{name} in steps of {step[name]:.3g} {_UNITS[name]}" for name in coarse)
        verdict, text = "warn", f"values are coarse: {sizes}"
        remedy = "choose a smaller measuring range, or keep the driver from rounding"
    else:
        verdict, text, remedy = "ok", "all six channels follow the motion in fine steps", ""
    return Finding(code=code, title=title, verdict=verdict, evidence=text, remedy=remedy, numbers=numbers)


def check_saturation(evidence: Evidence) -> Finding:
    """Look for samples piled up at the very end of a channel's range.

    A signal that passes its largest value smoothly has few samples there and more below; one that is cut off has many
    equal ones at the end and few just below it. That holds whatever the range is, and in every unit.
    """
    code, title, batch = "imu-saturation", "saturation", evidence.batch
    if len(batch) < _MIN_SAMPLES:
        return Finding(code=code, title=title, verdict="unknown", evidence=f"{len(batch)} samples are too few to tell")
    found: list[tuple[str, float, NDArray[np.intp]]] = []
    for name, values in (("gyroscope", batch.gyro), ("accelerometer", batch.accel)):
        for axis in range(3):
            for sign in (1.0, -1.0):
                clipped = _find_clipped(sign * values[:, axis])
                if len(clipped):
                    found.append((f"{name} {_AXES[axis]}", float(values[clipped[0], axis]), clipped))
    count = len(np.unique(np.concatenate([at for *_, at in found]))) if found else 0
    numbers = (Number(name="clipped samples", value=count / len(batch), limit=0.0),)
    if not found:
        return Finding(
            code=code,
            title=title,
            verdict="ok",
            evidence="no channel piles up at the end of its range",
            numbers=numbers,
        )
    where = "; ".join(_where(name, found) for name in ("gyroscope", "accelerometer") if _where(name, found))
    first = np.sort(np.concatenate([at for *_, at in found]))[:5]
    return Finding(
        code=code,
        title=title,
        verdict="fail" if count > 0.01 * len(batch) else "warn",
        evidence=f"{count} samples are cut off: {where}",
        remedy="choose a larger measuring range, or damp the mount: what is cut off is lost to every estimator",
        numbers=numbers,
        stamps_ns=tuple(int(stamp) for stamp in batch.stamps_ns[first]),
    )


def check_vibration(evidence: Evidence) -> Finding:
    """Measure what shakes above the frequencies of bodies, and whether more may be folded in from above Nyquist."""
    code, title, batch = "imu-vibration", "vibration", evidence.batch
    period = period_s(batch)
    if len(batch) < _MIN_SAMPLES or period <= 0.0:
        return Finding(code=code, title=title, verdict="unknown", evidence=f"{len(batch)} samples are too few to tell")
    nyquist = 0.5 / period
    if nyquist < 1.5 * _VIBRATION_HZ:
        text = f"at {1 / period:.0f} Hz nothing above {nyquist:.0f} Hz shows, it folds into the motion"
        return Finding(code=code, title=title, verdict="unknown", evidence=text)
    # In a wrong unit everything would shake: lengths are brought to size first.
    channels = {"accelerometer": batch.accel / evidence.accel_scale, "gyroscope": batch.gyro / evidence.gyro_scale}
    spectra = {name: _shake(batch.stamps_ns, values) for name, values in channels.items()}
    if any(spectrum is None for spectrum in spectra.values()):
        return Finding(code=code, title=title, verdict="unknown", evidence="no stretch without gaps is long enough")
    shakes = {name: spectrum for name, spectrum in spectra.items() if spectrum is not None}
    config = evidence.config
    limits = {
        "accelerometer": (config.warn_vibration_accel, config.max_vibration_accel),
        "gyroscope": (config.warn_vibration_gyro, config.max_vibration_gyro),
    }
    levels = {name: _level(shake.rms, limits[name]) for name, shake in shakes.items()}
    name = max(shakes, key=lambda n: shakes[n].rms / limits[n][0])
    shake, level = shakes[name], max(levels.values())
    numbers = tuple(
        number
        for n, s in sorted(shakes.items(), key=lambda item: item[0] != name)
        for number in (
            Number(name=f"{n} RMS", value=s.rms, unit=_UNITS[n], limit=limits[n][0]),
            Number(name=f"{n} peak", value=s.peak_hz, unit="Hz"),
        )
    )
    text = f"above {_VIBRATION_HZ:.0f} Hz the {name} shakes by {shake.rms:.3g} {_UNITS[name]} RMS"
    if level == 0:
        return Finding(code=code, title=title, verdict="ok", evidence=text, numbers=numbers)
    if shake.kurtosis > _BLOWS and shake.share < _LINE_SHARE:
        text += f", in blows with calm between (kurtosis {shake.kurtosis:.0f}), as footfalls or spoilt samples are"
        remedy = "soften feet or mount, and choose a measuring range that the blows do not fill"
        return Finding(
            code=code,
            title=title,
            verdict="fail" if level == 2 else "warn",
            evidence=text,
            remedy=remedy,
            numbers=numbers,
        )
    text += f", {100 * shake.share:.0f} % of it at {shake.peak_hz:.0f} Hz"
    folded = shake.peak_hz > _NYQUIST_SHARE * nyquist or shake.top > 0.5 * shake.rms
    if folded:
        text += f"; much of it is near half the sampling rate ({nyquist:.0f} Hz), so it may be folded from above"
    remedy = "damp the mount or move it off the motor, and switch on the IMU's own low-pass filter"
    remedy += " below half the output rate" if folded else ""
    return Finding(
        code=code,
        title=title,
        verdict="fail" if level == 2 else "warn",
        evidence=text,
        remedy=remedy,
        numbers=numbers,
    )


def _where(sensor: str, found: list[tuple[str, float, NDArray[np.intp]]]) -> str:
    """Return where a sensor was cut off: "gyroscope x at +4.36, z at -4.36 rad/s"; empty where it was not."""
    ends: dict[str, list[str]] = {}
    for name, limit, _ in found:
        if name.startswith(sensor):
            ends.setdefault(name[-1], []).append(f"{limit:+.4g}")
    listing = ", ".join(f"{axis} at {' and '.join(limits)}" for axis, limits in ends.items())
    return f"{sensor} {listing} {_UNITS[sensor]}" if listing else ""


def _columns(channels: dict[str, Array]) -> list[Array]:
    return [values[:, axis] for values in channels.values() for axis in range(3)]


def _is_stuck(share: float, values: Array) -> bool:
    """Tell whether a channel stands still; coarse channels do so too at rest, but take several values in all."""
    return bool(np.ptp(values) == 0.0 or (share > _STUCK_SHARE and len(np.unique(values)) < 4))


def _resolution(values: Array) -> float:
    """Return the largest of the axes' smallest steps between distinct values; 0 where nothing is seen of one."""
    steps = []
    for axis in range(3):
        levels = np.unique(values[:, axis])
        gaps = np.diff(levels)
        # Few levels visited often are a grid; a smooth signal of floats visits each level once.
        if len(levels) > 1 and len(levels) < len(values) / 4:
            steps.append(float(np.quantile(gaps, 0.1)))
    return max(steps, default=0.0)


def _find_clipped(values: Array) -> NDArray[np.intp]:
    """Return the samples at the largest value, where they are too many to be chance."""
    largest, middle = float(values.max()), float(np.median(values))
    if largest <= max(middle, 0.0):  # a range reaches as far to either side of zero
        return np.zeros(0, np.intp)
    close = 1e-6 * (largest - middle)
    top = np.flatnonzero(values >= largest - close)
    if len(top) < _MIN_CLIPPED or len(np.unique(values)) <= 8:
        return np.zeros(0, np.intp)
    return top if _piles_up(values, top, largest, middle) or _repeats(values, largest, middle) else top[:0]


def _piles_up(values: Array, top: NDArray[np.intp], largest: float, middle: float) -> bool:
    """Whether there are runs at the end of the range, and next to nothing just below it."""
    if not np.any(np.diff(top) == 1):
        return False
    close = 1e-6 * (largest - middle)
    below = values[values < largest - close]
    level = float(below.max()) if len(below) else middle
    width = max(0.01 * (largest - middle), largest - level)
    near = int(np.count_nonzero(below >= largest - close - width))
    far = largest - middle > 4.0 * 1.4826 * float(np.median(np.abs(values - middle)))
    # Noise at rest on a coarse grid also ends in equal values, but not so far out and not with fewer just below.
    return len(top) > _PILE_FACTOR * max(near, 1) and (far or len(top) > 20)


def _repeats(values: Array, largest: float, middle: float) -> bool:
    """Whether the very largest value, to the bit, comes far more often than any other one far out.

    Blows last for a sample each, and pass through all values on their way up: they pile up nothing in a row.
    """
    if -float(values.min()) > (1.0 + _RANGE_TOLERANCE) * largest:
        return False  # the range reaches farther
    _, counts = np.unique(values[values > 0.5 * (largest + middle)], return_counts=True)
    others = int(counts[:-1].max()) if len(counts) > 1 else 1
    return int(counts[-1]) >= _MIN_CLIPPED and int(counts[-1]) > _EQUAL_FACTOR * others


@dataclass(frozen=True, slots=True)
class _Shake:
    """What is above the frequencies of bodies.

    RMS, peak of its spectrum, the peak's share of the power, RMS near Nyquist; fourth moment by the square of the
    second, which is 1.5 of a sine, 3 of noise, and large of blows with rests between.
    """

    rms: float
    peak_hz: float
    share: float
    top: float
    kurtosis: float


def _shake(stamps_ns: NDArray[np.int64], values: Array) -> _Shake | None:
    """Average the power of Hann-windowed stretches without gaps (P. Welch, The use of fast Fourier transform, 1967)."""
    steps = np.diff(stamps_ns) * 1e-9
    period = float(np.median(steps))
    ends = np.flatnonzero(steps > 1.5 * period) + 1
    stretches = np.split(values, ends)
    size = min(_SEGMENT_SAMPLES, 1 << int(np.log2(max(1, max(len(s) for s in stretches)))))
    if size < 64:
        return None
    window = np.hanning(size)
    total, count = np.zeros(size // 2 + 1), 0
    for stretch in stretches:
        for begin in range(0, len(stretch) - size + 1, size // 2):
            piece = stretch[begin : begin + size]
            power = np.abs(np.fft.rfft(window[:, None] * (piece - piece.mean(axis=0)), axis=0)) ** 2
            total, count = total + power.sum(axis=1), count + 1
    variance = 2.0 * total / (count * size * float((window**2).sum()))  # of each frequency's share of the signal
    hertz = np.fft.rfftfreq(size, period)
    fast = hertz >= _VIBRATION_HZ
    peak = int(np.flatnonzero(fast)[variance[fast].argmax()])
    beside = fast & (np.abs(hertz - hertz[peak]) <= max(1.5, 2.5 * hertz[1]))
    whole = float(variance[fast].sum())
    return _Shake(
        rms=float(np.sqrt(whole)),
        peak_hz=float((variance[beside] * hertz[beside]).sum() / max(float(variance[beside].sum()), 1e-300)),
        share=float(variance[beside].sum()) / max(whole, 1e-300),
        top=float(np.sqrt(variance[hertz > _NYQUIST_SHARE * hertz[-1]].sum())),
        kurtosis=max(_kurtosis(stretch, period) for stretch in stretches if len(stretch) >= size),
    )


def _kurtosis(values: Array, period: float) -> float:
    """Return the largest kurtosis of the axes, of what a running mean over a body's fastest motion leaves."""
    width = max(3, round(1.0 / (_VIBRATION_HZ * period)) | 1)
    sums = np.cumsum(np.concatenate([np.zeros((1, values.shape[1])), values]), axis=0)
    rest = values[width // 2 : len(values) - width // 2] - (sums[width:] - sums[:-width]) / width
    square = np.mean(rest**2, axis=0)
    strong = square > 0.1 * square.max()  # an axis on which nothing happens tells nothing
    return float(np.max(np.mean(rest**4, axis=0)[strong] / square[strong] ** 2)) if square.any() else 0.0


def _level(value: float, limits: tuple[float, float]) -> int:
    """Return 0, 1 or 2 for fine, warn and fail."""
    return sum(value > limit for limit in limits)
