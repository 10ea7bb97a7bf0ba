"""What is wrong with a recording's inertial data and can be mended: from what the LiDAR alone saw, or not at all.

A wrong repair is worse than none. So the checks must exclude that the data are right, one repair must be left, and with
it the same checks must find nothing more: else the recording stays as it is, and the run says what the checks say.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import replace

import numpy as np

from heliograph.arrays import Array
from heliograph.calibration.lidar_imu import Calibration, calibrate
from heliograph.checks.agreement import check_clock_offset, check_prediction
from heliograph.checks.arrangement import ARRANGEMENTS, accel_arrangement, gyro_arrangement, is_mirrored, name_of
from heliograph.checks.axes import check_accel_axes, check_gyro_axes, check_mounting
from heliograph.checks.evidence import GRAVITY, Evidence, gather
from heliograph.checks.fit import cross, nearest_orthogonal
from heliograph.checks.lever import check_lever_arm
from heliograph.checks.records import CheckedMotion, ImuRecord
from heliograph.checks.signals import check_channels
from heliograph.checks.units import check_accel_unit, check_gyro_unit
from heliograph.config import RunConfig
from heliograph.data import Event, ImuBatch, ImuClock, Message, Rig, SensorRepair, Source
from heliograph.errors import HeliographError
from heliograph.examination import lidar_motion
from heliograph.lie import so3
from heliograph.repair.cause import clock_step, likely_cause
from heliograph.repair.point_times import reversed_point_times
from heliograph.repair.source import RepairedSource

__all__ = ["find_repairs", "sensor_repairs"]

_SECONDS = 25.0  # of the recording that are looked at [s]
_CALIBRATED_SECONDS = 40.0
_NO_GRAVITY = 2.0  # mean length of the specific force below which gravity was taken out [m/s^2]
_UNIT_TOLERANCE = 0.08  # relative error of a scale that is still a unit's, and no fault of another kind
_MIN_OFFSET, _OFFSET_SIGMAS = 0.03, 10.0  # of a clock offset that is mended [s]; less is the calibration's business
_MAX_ROTATION_SIGMA, _MAX_OFFSET_SIGMA = np.radians(1.0), 0.005  # of what a calibration may put in place [rad], [s]
_TURNS_SIGMA = 0.5  # of a mounting's rotation by the turns alone [rad]
_ACCEL_FACTORS = {"g": GRAVITY, "mg": 1e-3 * GRAVITY, "cm/s^2": 1e-2, "mm/s^2": 1e-3}
_GYRO_FACTORS = {
    "deg/s": np.pi / 180.0,
    "mrad/s": 1e-3,
    "mdeg/s": np.pi / 180e3,
    "turns a second": 2.0 * np.pi,
    # What the reader has converted by its numbers alone, and wrongly.
    "rad/s, not deg/s": 180.0 / np.pi,
    "mrad/s, not deg/s": 0.18 / np.pi,
}

Step = Callable[[Evidence], "SensorRepair | None"]


def find_repairs(
    source: Source, config: RunConfig, *, threads: int = 1, sure: bool = False
) -> tuple[tuple[SensorRepair, ...], str]:
    """Return what mends a recording's inertial data, in the order of application; nothing where nothing is sure.

    Parameters
    ----------
    source : Source
        Repeatable; its first part is read up to five times.
    config : RunConfig
    threads : int
    sure : bool
        That the clocks differ is known already; then a small offset is mended as well.

    Returns
    -------
    repairs : tuple of SensorRepair
    cause : str
        Where there are none: what most likely is wrong, and what helps; empty where nothing tells.
    """
    if not source.repeatable or not source.sensors >= {"lidar", "imu"}:
        return (), ""
    tee = _Tee(source)
    motion, _ = lidar_motion(tee, config, threads=threads, seconds=_SECONDS)
    whole = ImuBatch.joined(tee.batches)
    if len(whole) < 2 or motion is None:
        return (), ""
    evidence = _evidence(whole, motion, config)
    if not sure and (step := clock_step(evidence)):  # one offset would be wrong on either side of it
        return (), f"the IMU contradicts the LiDAR: {step}"
    repairs = _found(source, whole, motion, config, threads=threads, sure=sure)
    if repairs:
        return repairs, ""
    if cause := likely_cause(evidence):
        return (), cause
    turned = reversed_point_times(source, config, threads=threads)
    return ((), "") if turned is None else ((turned,), "")


def _found(
    source: Source, whole: ImuBatch, motion: CheckedMotion, config: RunConfig, *, threads: int, sure: bool
) -> tuple[SensorRepair, ...]:
    if (lost := _useless(_evidence(whole, motion, config))) is not None:
        return (lost,) if config.sensors == "auto" else ()
    found, wrong = sensor_repairs(whole, motion, config, sure=sure)
    if wrong or any(not repair.clock.exact for repair in found):
        start = _by_turns(_evidence(_mended(whole, found), motion, config)) if wrong else None
        measured = _measured(RepairedSource(source, found), config, threads, start)
        if measured is None:
            return () if wrong else _proven(found, whole, motion, config)
        found.append(measured)
    return _proven(found, whole, motion, config)


def sensor_repairs(
    imu: ImuBatch, motion: CheckedMotion, config: RunConfig, *, sure: bool = False
) -> tuple[list[SensorRepair], bool]:
    """Return what mends units, axes and a coarse clock offset, and whether the mounting as given cannot be."""
    found: list[SensorRepair] = []
    evidence = _evidence(imu, motion, config)
    if evidence.turns is None:
        return [], False
    for step in (_accel_unit, _gyro_unit, _offset_step(sure), _gyro_axes, _accel_axes):
        if (repair := step(evidence)) is not None:
            found.append(repair)
            evidence = _evidence(_mended(imu, found), motion, config)
    return found, _wrong_mounting(evidence)


class _Tee:
    """A source; what it yields of the IMU is kept."""

    repeatable = False
    events: Sequence[Event] = ()

    def __init__(self, source: Source) -> None:
        self._source = source
        self.rig, self.sensors = source.rig, source.sensors
        self.batches: list[ImuBatch] = []

    def stream(self) -> Iterator[Message]:
        for message in self._source.stream():
            if isinstance(message, ImuBatch):
                self.batches.append(message)
            yield message

    def close(self) -> None:
        """Leave the source open: it is somebody else's."""


def _evidence(imu: ImuBatch, motion: CheckedMotion | None, config: RunConfig) -> Evidence:
    forward = np.concatenate([[True], np.diff(imu.stamps_ns) > 0])
    record = ImuRecord(
        stamps_ns=imu.stamps_ns[forward],
        received_ns=imu.stamps_ns[forward],
        gyro=imu.gyro[forward],
        accel=imu.accel[forward],
    )
    return gather(record, motion, "" if motion is not None else "the LiDAR cannot be followed", config=config.check)


def _mended(imu: ImuBatch, repairs: Sequence[SensorRepair]) -> ImuBatch:
    for repair in repairs:
        imu = replace(
            imu,
            gyro=imu.gyro @ repair.gyro.T,
            accel=imu.accel @ repair.accel.T,
            stamps_ns=imu.stamps_ns if repair.clock.exact else repair.clock.lidar_time(imu.stamps_ns),
        )
    return imu


def _useless(evidence: Evidence) -> SensorRepair | None:
    """Leave the IMU out where a channel of it is dead, or gravity was taken out."""
    finding = check_channels(evidence)
    if finding.verdict != "fail":
        return _without_gravity(evidence)
    sentence = f"{finding.evidence}; the run goes on with the LiDAR alone, and up is not known - {finding.remedy}"
    return SensorRepair(code="imu-channels", sentence=sentence, without_imu=True)


def _without_gravity(evidence: Evidence) -> SensorRepair | None:
    """Leave the IMU out where the accelerometer shows no gravity: what is left of it tells no level and little else."""
    finding = check_accel_unit(evidence)
    if finding.verdict != "fail" or "gravity is missing" not in finding.evidence:
        return None
    sentence = f"{finding.evidence}; the run goes on with the LiDAR alone, and up is not known - {finding.remedy}"
    return SensorRepair(code="accel-gravity", sentence=sentence, without_imu=True)


def _accel_unit(evidence: Evidence) -> SensorRepair | None:
    finding = check_accel_unit(evidence)
    if finding.verdict != "fail":
        return None
    raw = next(number.value for number in finding.numbers if number.name == "mean force as recorded")
    unit, factor = _unit_of(GRAVITY / raw if raw else 0.0, _ACCEL_FACTORS)
    if not unit:
        return None
    sentence = f"the accelerometer counts in {unit}: {finding.evidence}; it is multiplied by {factor:.6g}"
    return SensorRepair(code="accel-unit", sentence=sentence, accel=factor * np.eye(3))


def _gyro_unit(evidence: Evidence) -> SensorRepair | None:
    finding = check_gyro_unit(evidence)
    if finding.verdict != "fail":
        return None
    raw = next((number.value for number in finding.numbers if number.name == "scale as recorded"), None)
    unit, factor = _unit_of(1.0 / raw if raw else 0.0, _GYRO_FACTORS)
    if not unit:
        return None
    sentence = f"the gyroscope counts in {unit}: {finding.evidence}; it is multiplied by {factor:.6g}"
    return SensorRepair(code="gyro-unit", sentence=sentence, gyro=factor * np.eye(3))


def _unit_of(factor: float, units: dict[str, float]) -> tuple[str, float]:
    """Return the unit nearest to a factor, with those as good as it (mg, cm/s^2), and what to multiply by.

    Such differ by less than sensors' scales do, so whichever is taken does no harm.
    """
    off = {name: abs(float(np.log(value / factor))) for name, value in units.items()} if factor > 0.0 else {}
    near = sorted((name for name in off if off[name] < _UNIT_TOLERANCE), key=lambda name: off[name])
    return (" or ".join(near), units[near[0]]) if near else ("", 1.0)


def _offset_step(sure: bool) -> Step:
    def step(evidence: Evidence) -> SensorRepair | None:
        offset, least = evidence.offset, 0.0 if sure else _MIN_OFFSET
        if offset is None or not offset.determined or not np.isfinite(offset.sigma):
            return None
        if abs(offset.seconds) < max(least, _OFFSET_SIGMAS * offset.sigma):
            return None
        way = "late" if offset.seconds > 0.0 else "early"
        sentence = (
            f"the IMU's clock is {abs(offset.seconds):.3f} s {way} against the LiDAR's (turns of both agree to "
            f"{offset.correlation:.2f} at that offset); its samples are brought back by it"
        )
        return SensorRepair(code="clock-offset", sentence=sentence, clock=ImuClock(offset=offset.seconds))

    return step


def _gyro_axes(evidence: Evidence) -> SensorRepair | None:
    """Turn the gyroscope's axes where it alone is wrong; where both sensors are, the mounting is."""
    gyro, accel = gyro_arrangement(evidence), accel_arrangement(evidence)
    if gyro is None or gyro.as_expected or check_gyro_axes(evidence).verdict != "fail" or np.sum(gyro.possible) != 1:
        return None
    if is_mirrored(gyro, accel):  # the map would come out as a mirror image, and nothing would contradict it
        return None
    if accel is not None and not accel.as_expected and np.any(accel.possible & gyro.possible):
        P = ARRANGEMENTS[int(np.flatnonzero(gyro.possible)[0])]
        if float(np.linalg.det(P)) > 0.0:
            return None
        return _axes_repair("imu-axes", "IMU", P, gyro=True, accel=True)
    return _axes_repair("gyro-axes", "gyroscope", ARRANGEMENTS[int(np.flatnonzero(gyro.possible)[0])], gyro=True)


def _accel_axes(evidence: Evidence) -> SensorRepair | None:
    gyro, accel = gyro_arrangement(evidence), accel_arrangement(evidence)
    if accel is None or accel.as_expected or check_accel_axes(evidence).verdict != "fail":
        return None
    if gyro is None or not gyro.as_expected or np.sum(accel.possible) != 1:
        return None
    P = ARRANGEMENTS[int(np.flatnonzero(accel.possible)[0])]
    return _axes_repair("accel-axes", "accelerometer", P, accel=True)


def _axes_repair(code: str, sensor: str, P: Array, *, gyro: bool = False, accel: bool = False) -> SensorRepair:
    back = np.ascontiguousarray(P.T)
    signs = "its signs are turned" if np.array_equal(P, -np.eye(3)) else "they are put back"
    sentence = f"the {sensor}'s axes are wrong, {name_of(P)}: gravity and the LiDAR's motion exclude all else; {signs}"
    return SensorRepair(
        code=code, sentence=sentence, gyro=back if gyro else np.eye(3), accel=back if accel else np.eye(3)
    )


def _wrong_mounting(evidence: Evidence) -> bool:
    """Whether the mounting as given cannot be: both sensors agree on another one, or it is off by far."""
    if evidence.motion is None or not evidence.motion.rig.known:
        return False
    if check_mounting(evidence).verdict == "fail" or check_lever_arm(evidence).verdict == "fail":
        return True
    gyro, accel = gyro_arrangement(evidence), accel_arrangement(evidence)
    if gyro is None or gyro.as_expected or check_gyro_axes(evidence).verdict != "fail":
        return False
    return accel is None or bool(np.any(accel.possible & gyro.possible))


def _by_turns(evidence: Evidence) -> Array:
    """Return the mounting's rotation that the turns show, and no lever arm: a calibration looks only nearby.

    Where the lever arm alone is wrong, what was given is near enough; what the motion does not tell of it stays.
    """
    T = np.eye(4)
    if evidence.motion is not None and check_mounting(evidence).verdict == "ok":
        return np.array(evidence.motion.rig.T_imu_lidar)
    if evidence.turns is not None:
        T[:3, :3] = nearest_orthogonal(cross(evidence.turns)[0], handed=1.0)
    return T


def _measured(source: Source, config: RunConfig, threads: int, start: Array | None) -> SensorRepair | None:
    """Let a calibration find mounting and clock, from ``start`` (4, 4) where the mounting is wrong as it was given."""
    given, unknown = source.rig, start is not None
    rig = given
    if start is not None:
        rig = Rig(
            T_imu_lidar=start,
            source="distrusted",
            known=False,
            sigma_rotation=_TURNS_SIGMA,
            sigma_translation=config.calibration.prior_lever,
            clock=given.clock,
        )
    config = replace(config, calibration=replace(config.calibration, longest=_CALIBRATED_SECONDS))
    stream = source.stream()
    try:
        with closing(stream):  # type: ignore[type-var]
            found = calibrate(stream, rig, config, threads=threads)
    except HeliographError:
        return None
    sigma = np.array([axis.sigma for axis in found.axes])
    if not found.converged or sigma[6] > _MAX_OFFSET_SIGMA or (unknown and sigma[:3].max() > _MAX_ROTATION_SIGMA):
        return None
    return _calibrated(found, given, sigma, unknown=unknown)


def _calibrated(found: Calibration, given: Rig, sigma: Array, *, unknown: bool) -> SensorRepair:
    # The clock that comes is the whole one; what the reader has applied of it is applied already.
    extra = ImuClock(
        offset=found.rig.clock.offset - float(given.clock.offset_at(np.int64(found.rig.clock.reference_ns))),
        drift=found.rig.clock.drift - given.clock.drift,
        reference_ns=found.rig.clock.reference_ns,
    )
    offset = f"clock offset {1e3 * extra.offset:+.2f} +- {1e3 * sigma[6]:.2f} ms"
    if not unknown:
        return SensorRepair(code="clock-refined", sentence=f"the offset was then measured: {offset}", clock=extra)
    T = found.rig.T_imu_lidar
    off = np.degrees(float(np.linalg.norm(so3.log(given.T_imu_lidar[:3, :3].T @ T[:3, :3]))))
    moved = float(np.linalg.norm(given.T_imu_lidar[:3, 3] - T[:3, 3]))
    sentence = (
        f"the mounting by {given.source} is off by {off:.1f} deg and {moved:.2f} m: IMU and LiDAR move alike only with "
        f"another one, which was calibrated from {found.duration:.0f} s of motion (rotation +- "
        f"{np.degrees(sigma[:3].max()):.2f} deg, lever arm +- {sigma[3:6].max():.3f} m, {offset}); it is used instead, "
        "see run.json"
    )
    rig = Rig(
        T_imu_lidar=T,
        source="calibrated from the recording",
        sigma_rotation=float(max(sigma[:3].max(), 5e-4)),
        sigma_translation=float(max(sigma[3:6].max(), 0.005)),
        clock=given.clock,
    )
    return SensorRepair(code="mounting", sentence=sentence, rig=rig, clock=extra)


def _proven(
    repairs: Sequence[SensorRepair], whole: ImuBatch, motion: CheckedMotion, config: RunConfig
) -> tuple[SensorRepair, ...]:
    """Return the repairs if the checks find nothing wrong any more with them, else none."""
    if not repairs:
        return ()
    rig = next((repair.rig for repair in reversed(repairs) if repair.rig is not None), motion.rig)
    evidence = _evidence(_mended(whole, repairs), replace(motion, rig=rig), config)
    checks = (check_accel_unit, check_gyro_unit, check_clock_offset, check_gyro_axes, check_accel_axes)
    verdicts = [check(evidence).verdict for check in (*checks, check_mounting, check_lever_arm, check_prediction)]
    return () if "fail" in verdicts else tuple(repairs)
