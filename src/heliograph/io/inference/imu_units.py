"""The units of an IMU, from its first samples."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph.config import InputConfig
from heliograph.data import Event
from heliograph.io.inference.record import Inference, make_inference
from heliograph.io.raw import RawImu

__all__ = ["GRAVITY", "ImuUnits", "infer_imu_units", "is_usable"]

GRAVITY = 9.80665
ACCEL_UNITS = {"m/s^2": 1.0, "g": GRAVITY}
GYRO_UNITS = {"rad/s": 1.0, "deg/s": float(np.pi / 180)}
G_MAGNITUDES = (0.3, 3.0)  # median length of the specific force where it counts in g
SI_MAGNITUDES = (3.0, 30.0)  # and in m/s^2
MIN_GRAVITY_CORRELATION, MIN_GRAVITY_TURNS = 0.5, 20  # of gravity's turns with the rates, and their number, to judge by
MAX_REST_RATE = 0.15  # beyond any bias in rad/s, a common one in deg/s
MAX_REST_SHAKE = 0.15  # standard deviation of the specific force at rest [m/s^2]
MAX_RATE = 40.0  # rad/s; robots' gyros end at 2000 deg/s, which is 35
MIN_VERTICAL_COSINE = (
    0.95  # cosine between rate and vertical in a level bend; the centrifugal force tilts what is measured of it
)
MAX_JITTER = 0.03  # in the sensor's own unit: the jitter of a gyroscope in deg/s is above, of one in rad/s below
MAX_VALUE = 1e5  # in any unit; beyond it a message is damaged


def is_usable(sample: RawImu) -> bool:
    """Tell whether all six values are numbers that a sensor can give; NaN fails the comparison."""
    return all(-MAX_VALUE < value < MAX_VALUE for value in (*sample.gyro, *sample.accel))


@dataclass(frozen=True, slots=True)
class ImuUnits:
    """Factors to SI with what led to them."""

    accel: float
    gyro: float
    inferences: tuple[Inference, ...]
    events: tuple[Event, ...]


def infer_imu_units(samples: Sequence[RawImu], config: InputConfig) -> ImuUnits:
    """Infer whether specific force is in m/s^2 or g and rate in rad/s or deg/s.

    Parameters
    ----------
    samples : sequence of RawImu
        The first ones, at least one.
    config : InputConfig
        Overrides.
    """
    samples = [sample for sample in samples if is_usable(sample)]
    accel = np.array([s.accel for s in samples], dtype=np.float64).reshape(-1, 3)
    gyro = np.array([s.gyro for s in samples], dtype=np.float64).reshape(-1, 3)
    stamps = np.array([s.stamp_ns for s in samples], dtype=np.int64)
    accel_unit, accel_inference, events = _accel(accel, config.accel_unit)
    gyro_unit, gyro_inference = _gyro(accel * ACCEL_UNITS[accel_unit], gyro, stamps, config.gyro_unit)
    return ImuUnits(ACCEL_UNITS[accel_unit], GYRO_UNITS[gyro_unit], (accel_inference, gyro_inference), tuple(events))


def _accel(accel: NDArray[np.float64], override: str) -> tuple[str, Inference, list[Event]]:
    size = float(np.median(np.linalg.norm(accel, axis=1))) if len(accel) else 0.0
    evidence = f"median magnitude of the first {len(accel)} samples is {size:.4g}"
    name = "accelerometer unit"
    if override:
        return override, make_inference(name, override, evidence, source="override"), []
    if G_MAGNITUDES[0] < size < G_MAGNITUDES[1]:
        message = f"the accelerometer counts in g, not m/s^2: {evidence}; it is multiplied by {GRAVITY}"
        return (
            "g",
            make_inference(name, "g", f"{evidence}: near 1"),
            [Event(code="accel-in-g", message=message, severity="info")],
        )
    if SI_MAGNITUDES[0] <= size < SI_MAGNITUDES[1]:
        return "m/s^2", make_inference(name, "m/s^2", f"{evidence}: near 9.8"), []
    message = f"the accelerometer's unit is doubtful: {evidence}, neither near 9.8 nor near 1; set input.accel_unit"
    return (
        "m/s^2",
        make_inference(name, "m/s^2", evidence, source="default"),
        [Event(code="accel-unit", message=message)],
    )


def _gyro(
    accel: NDArray[np.float64], gyro: NDArray[np.float64], stamps_ns: NDArray[np.int64], override: str
) -> tuple[str, Inference]:
    rates = np.linalg.norm(gyro, axis=1)
    largest = float(rates.max()) if len(rates) else 0.0
    name = "gyroscope unit"
    if override:
        text = f"largest rate {largest:.4g}"
        return override, make_inference(name, override, text, source="override")
    if largest > MAX_RATE:
        return "deg/s", make_inference(name, "deg/s", f"largest rate {largest:.4g}: beyond any gyroscope in rad/s (35)")
    slope, correlation, count = _gravity_turn(accel, gyro, stamps_ns)
    if correlation > MIN_GRAVITY_CORRELATION and count >= MIN_GRAVITY_TURNS:
        unit = "rad/s" if slope > np.sqrt(np.pi / 180) else "deg/s"
        text = (
            f"the direction of gravity turns {slope:.3g} times as fast as the rates say (1: rad/s, "
            f"0.0175: deg/s), r {correlation:.2f}"
        )
        return unit, make_inference(name, unit, text)
    resting, turning = _rest_rate(accel, gyro)
    if resting is not None and resting > MAX_REST_RATE and not turning:
        text = (
            f"it reads {resting:.3g} at rest: as rad/s a bias of {np.rad2deg(resting):.0f} deg/s, as deg/s a common one"
        )
        return "deg/s", make_inference(name, "deg/s", text)
    turned = f"gravity turns too little to tell (r {correlation:.2f})" if count else "gravity turns too little to tell"
    text = f"largest rate {largest:.4g}, {turned}: the ROS unit"
    if resting is not None:
        found = "calmly about the vertical, as a vehicle in a bend" if turning else "at rest, a common bias in rad/s"
        text = f"it reads {resting:.3g} {found}; {text}"
    return "rad/s", make_inference(name, "rad/s", text, source="default" if resting is None else "data")


def _gravity_turn(
    accel: NDArray[np.float64], gyro: NDArray[np.float64], stamps_ns: NDArray[np.int64], window_s: float = 0.25
) -> tuple[float, float, int]:
    """Compare how the measured vertical turns with what the gyroscope says.

    A vector fixed in the world moves in the body by ``d g / dt = -omega x g``. Both sides are averaged over windows,
    so that vibration cancels; returns the slope of the left over the right, their correlation and the number of
    windows.
    """
    if len(stamps_ns) < 40:
        return 0.0, 0.0, 0
    duration = (stamps_ns[-1] - stamps_ns[0]) / 1e9
    size = max(2, round(window_s * len(stamps_ns) / duration)) if duration > 0 else 2
    count = len(stamps_ns) // size
    if count < 4 or duration <= 0:
        return 0.0, 0.0, 0
    mean_accel = accel[: count * size].reshape(count, size, 3).mean(axis=1)
    mean_gyro = gyro[: count * size].reshape(count, size, 3).mean(axis=1)
    times = (stamps_ns[: count * size] - stamps_ns[0]).reshape(count, size).mean(axis=1) / 1e9
    norms = np.linalg.norm(mean_accel, axis=1, keepdims=True)
    up = mean_accel / np.maximum(norms, 1e-9)
    step = np.diff(times)[:, None]
    measured = np.diff(up, axis=0) / step
    middle_gyro, middle_up = (mean_gyro[1:] + mean_gyro[:-1]) / 2, (up[1:] + up[:-1]) / 2
    predicted = -np.cross(middle_gyro, middle_up)
    energy = float((predicted**2).sum())
    if energy <= 0 or float(np.sqrt((measured**2).sum(axis=1).mean())) < 0.01:
        return 0.0, 0.0, 0
    dot = float((measured * predicted).sum())
    return dot / energy, dot / np.sqrt(energy * float((measured**2).sum())), measured.size


def _rest_rate(accel: NDArray[np.float64], gyro: NDArray[np.float64], size: int = 40) -> tuple[float | None, bool]:
    """Return the mean rate of the stillest stretch, None where there is none, and whether it may be a steady turn.

    A vehicle in a bend shakes as little as one at rest. Its rate is along the vertical, which a bias is by chance only,
    and quieter than a gyroscope that counts in deg/s is at rest.
    """
    best: tuple[float, float, bool] | None = None
    for at in range(0, len(accel) - size + 1, size):
        rates, force = gyro[at : at + size], accel[at : at + size]
        shake = float(np.linalg.norm(force.std(axis=0)))
        if shake < MAX_REST_SHAKE and (best is None or shake < best[0]):
            rate, up = rates.mean(axis=0), force.mean(axis=0)
            length = float(np.linalg.norm(rate))
            upright = abs(float(rate @ up)) > MIN_VERTICAL_COSINE * length * float(np.linalg.norm(up))
            jitter = float(np.diff(rates, axis=0).std(axis=0).max()) / np.sqrt(2.0)
            best = (shake, length, upright and jitter < MAX_JITTER)
    return (None, False) if best is None else best[1:]
