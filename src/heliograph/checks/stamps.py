"""Whether the IMU's samples are whole, in order, evenly spaced, and stamped by a clock that neither jumps nor runs off.

What the reader repairs on its way (it drops samples whose stamp does not advance) is reported here all the same: other
programs will stumble over it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from heliograph.checks.clock import CLOCK_STEP, clock_drift, clock_steps
from heliograph.checks.evidence import Evidence
from heliograph.checks.records import Finding, Number
from heliograph.checks.windows import MAX_VALUE, period_s

__all__ = ["check_clock", "check_gaps", "check_jitter", "check_order", "check_rate", "check_values"]

_MIN_SAMPLES = 10  # samples below which nothing can be said
_MAX_LISTED = 5  # stamps that a finding lists
_GAP_PERIODS, _MISSED_PERIODS = 4.0, 1.5
_REWIND_FAIL, _VALUES_FAIL = 0.01, 0.01  # shares
_MIN_DURATION_S = 10.0  # recordings that show no drift [s]
_MIN_DRIFT_S = 0.005  # over a recording that is worth a remark [s]


def check_values(evidence: Evidence) -> Finding:
    """Count the samples that hold no usable number."""
    code, title = "imu-values", "values"
    values = np.concatenate([evidence.imu.gyro, evidence.imu.accel], axis=1)
    bad = np.flatnonzero(~np.all(np.abs(values) < MAX_VALUE, axis=1))
    share = len(bad) / max(1, len(values))
    numbers = (Number(name="unusable samples", value=share, limit=0.0),)
    if len(values) == 0:
        return Finding(code=code, title=title, verdict="unknown", evidence="there are no samples")
    if len(bad) == 0:
        return Finding(
            code=code, title=title, verdict="ok", evidence=f"all {len(values)} samples are numbers", numbers=numbers
        )
    return Finding(
        code=code,
        title=title,
        verdict="fail" if share > _VALUES_FAIL else "warn",
        evidence=f"{len(bad)} of {len(values)} samples hold NaN, infinity or absurd values; the reader drops them",
        remedy="look at the driver and the cable: a driver must not publish a sample that it could not read",
        numbers=numbers,
        stamps_ns=_some(evidence.imu.stamps_ns[bad]),
    )


def check_clock(evidence: Evidence) -> Finding:
    """Compare the header stamps with the times of reception: steps and drift of the sensor's clock.

    Transport only delays, so within a second the quickest message stands for the clock: the minimum of reception minus
    stamp. A step that lasts is the clock's, one that passes is a late message. The drift is the median slope between
    the minima (P. Sen, Estimates of the regression coefficient based on Kendall's tau, 1968).
    """
    code, title, imu = "imu-clock", "clock", evidence.imu
    if imu.stamp != "header":
        return Finding(
            code=code,
            title=title,
            verdict="warn",
            evidence="the header stamps do not advance, so the times of reception are used, which jitter",
            remedy="let the driver fill header.stamp with the time of measurement",
        )
    if len(imu) < _MIN_SAMPLES:
        return Finding(code=code, title=title, verdict="unknown", evidence=f"{len(imu)} samples are too few to tell")
    steps, sizes = clock_steps(imu)
    if len(steps):
        largest = float(sizes[np.abs(sizes).argmax()])
        return Finding(
            code=code,
            title=title,
            verdict="fail",
            evidence=(
                f"the header stamps jump {times(len(steps))} against the times of reception, the farthest by "
                f"{largest:+.3f} s"
            ),
            remedy=(
                "synchronise before recording, not during it (NTP or PTP must slew, not step), or stamp with the "
                "sensor's own counter; split this recording at the jump with --start and --duration"
            ),
            numbers=(Number(name="largest step", value=largest, unit="s", limit=CLOCK_STEP),),
            stamps_ns=_some(imu.stamps_ns[steps]),
        )
    ppm, sigma, span = clock_drift(imu)
    numbers = (Number(name="drift", value=ppm, unit="ppm", limit=evidence.config.max_drift_ppm),)
    if (
        span >= _MIN_DURATION_S
        and abs(ppm) > max(evidence.config.max_drift_ppm, 5 * sigma)
        and abs(ppm) * 1e-6 * span > _MIN_DRIFT_S
    ):
        return Finding(
            code=code,
            title=title,
            verdict="warn",
            evidence=f"the IMU's clock runs {ppm:+.0f} ppm against the recorder's, {ppm * 1e-3 * span:+.1f} ms in all",
            remedy="synchronise the sensors (PTP, PPS); `heliograph calibrate` estimates offset and drift to the LiDAR",
            numbers=numbers,
        )
    if span < _MIN_DURATION_S:
        text = f"header stamps and times of reception run alike; {span:.1f} s are too short for a drift"
        return Finding(code=code, title=title, verdict="ok", evidence=text)
    text = f"header stamps and times of reception run alike, {ppm:+.0f} ppm over {span:.0f} s"
    return Finding(code=code, title=title, verdict="ok", evidence=text, numbers=numbers)


def check_order(evidence: Evidence) -> Finding:
    """Count repeated and reversed stamps."""
    code, title, imu = "imu-order", "order of stamps", evidence.imu
    if imu.stamp != "header" or len(imu) < 2:
        return Finding(code=code, title=title, verdict="unknown", evidence="there are no header stamps to order")
    highest = np.maximum.accumulate(imu.stamps_ns)[:-1]
    repeated = np.flatnonzero(imu.stamps_ns[1:] == highest) + 1
    reversed_ = np.flatnonzero(imu.stamps_ns[1:] < highest) + 1
    numbers = (
        Number(name="reversed", value=len(reversed_) / len(imu), limit=0.0),
        Number(name="repeated", value=len(repeated) / len(imu), limit=0.0),
    )
    if not len(repeated) and not len(reversed_):
        return Finding(code=code, title=title, verdict="ok", evidence="every stamp advances", numbers=numbers)
    text = f"{len(repeated)} samples repeat an earlier stamp and {len(reversed_)} run back, of {len(imu)}"
    remedy = (
        "look for two publishers or two recorders on the topic"
        if len(repeated) >= len(reversed_)
        else "look for a stepped clock, or for samples sent in bundles with stamps of arrival"
    )
    return Finding(
        code=code,
        title=title,
        verdict="fail" if len(reversed_) > _REWIND_FAIL * len(imu) else "warn",
        evidence=f"{text}; the reader drops them",
        remedy=remedy,
        numbers=numbers,
        stamps_ns=_some(imu.stamps_ns[np.sort(np.concatenate([repeated, reversed_]))]),
    )


def check_gaps(evidence: Evidence) -> Finding:
    """Find pauses, and count the samples missing in them and elsewhere."""
    code, title, stamps = "imu-gaps", "gaps", evidence.batch.stamps_ns
    if len(stamps) < _MIN_SAMPLES:
        return Finding(code=code, title=title, verdict="unknown", evidence=f"{len(stamps)} samples are too few to tell")
    steps = np.diff(stamps) * 1e-9
    period = period_s(evidence.batch)
    long = steps > _MISSED_PERIODS * period
    if evidence.imu.stamp == "header":  # a step of the clock loses no sample; `check_clock` tells it
        stepped = clock_steps(evidence.imu)[0]
        long &= ~np.isin(stamps[1:], evidence.imu.stamps_ns[stepped])
    missing = float(np.round(steps[long] / period - 1.0).sum())
    share = missing / (len(stamps) + missing)
    gaps = np.flatnonzero(long & (steps > _GAP_PERIODS * period))
    longest = float(steps[gaps].max()) if len(gaps) else 0.0
    numbers = (
        Number(name="longest gap", value=longest, unit="s", limit=_GAP_PERIODS * period),
        Number(name="missing samples", value=share, limit=evidence.config.warn_missing),
    )
    if not len(gaps) and share <= evidence.config.warn_missing:
        text = f"no step is longer than {_GAP_PERIODS:g} periods, {missing:.0f} samples are missing"
        return Finding(code=code, title=title, verdict="ok", evidence=text, numbers=numbers)
    severe = longest > evidence.config.max_gap or share > evidence.config.max_missing
    pauses = f"{len(gaps)} gaps, the longest {longest:.3f} s; " if len(gaps) > 1 else ""
    pauses = pauses or (f"a gap of {longest:.3f} s; " if len(gaps) else "")
    return Finding(
        code=code,
        title=title,
        verdict="fail" if severe else "warn",
        evidence=f"{pauses}{missing:.0f} of {len(stamps) + missing:.0f} samples are missing",
        remedy="relieve the recorder (disk, CPU, queue size of the IMU's subscription) or the sensor's bus",
        numbers=numbers,
        stamps_ns=_some(stamps[gaps if len(gaps) else np.flatnonzero(long)]),
    )


def check_jitter(evidence: Evidence) -> Finding:
    """Measure how unevenly the stamps are spaced: half the distance from the 5th to the 95th percentile."""
    code, title, stamps = "imu-jitter", "spacing of stamps", evidence.batch.stamps_ns
    if len(stamps) < _MIN_SAMPLES:
        return Finding(code=code, title=title, verdict="unknown", evidence=f"{len(stamps)} samples are too few to tell")
    steps = np.diff(stamps) * 1e-9
    period = period_s(evidence.batch)
    low, high = np.quantile(steps[steps < _MISSED_PERIODS * period * 2], [0.05, 0.95])
    spread = float(high - low) / 2.0 / period
    numbers = (Number(name="spread", value=spread, unit="periods", limit=evidence.config.max_jitter),)
    text = f"steps lie between {1e3 * low:.2f} and {1e3 * high:.2f} ms (5 to 95 %) around {1e3 * period:.2f} ms"
    if spread <= evidence.config.max_jitter:
        return Finding(code=code, title=title, verdict="ok", evidence=text, numbers=numbers)
    return Finding(
        code=code,
        title=title,
        verdict="warn",
        evidence=text,
        remedy="stamp with the sensor's own counter instead of the time of arrival, or smooth the stamps in the driver",
        numbers=numbers,
    )


def check_rate(evidence: Evidence) -> Finding:
    """Judge the rate of the samples."""
    code, title, stamps = "imu-rate", "rate", evidence.batch.stamps_ns
    if len(stamps) < _MIN_SAMPLES:
        return Finding(code=code, title=title, verdict="unknown", evidence=f"{len(stamps)} samples are too few to tell")
    rate = 1.0 / period_s(evidence.batch)
    numbers = (Number(name="rate", value=rate, unit="Hz", limit=evidence.config.good_rate),)
    text = f"{rate:.1f} samples a second over {(stamps[-1] - stamps[0]) * 1e-9:.1f} s"
    if rate >= evidence.config.good_rate:
        return Finding(code=code, title=title, verdict="ok", evidence=text, numbers=numbers)
    return Finding(
        code=code,
        title=title,
        verdict="fail" if rate < evidence.config.min_rate else "warn",
        evidence=f"{text}: between two samples the motion is a guess",
        remedy="raise the IMU's output rate to 100 Hz or more (200 Hz for hand-held and legged motion)",
        numbers=numbers,
    )


def _some(stamps_ns: NDArray[np.int64]) -> tuple[int, ...]:
    return tuple(int(stamp) for stamp in stamps_ns[:_MAX_LISTED])


def times(count: int) -> str:
    """Return "once" or "3 times"."""
    return "once" if count == 1 else f"{count} times"
