"""How the LiDAR sits on the IMU, found from their motion where no source tells.

Both see the same turns: a rotation vector of the imu frame is the mounting's rotation of the lidar frame's (hand-eye
calibration, R. Tsai, R. Lenz, 1989, for rotations alone). The LiDAR's turns come from its own odometry, the IMU's from
integrating the gyroscope. The lever arm shows in how the two accelerate while turning; from that rough rotation on it
is a calibration's business, which solves for motion, mounting, clock, gravity and biases at once. Where that does not
settle the filter estimates the mounting as a state, beginning from zero with a wide uncertainty.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import Array, freeze
from heliograph.calibration.lidar_imu import Calibration, calibrate
from heliograph.config import RunConfig
from heliograph.data import Event, GnssFix, ImuBatch, Rig, Scan
from heliograph.data.error_layout import LEVER_ARM, MOUNTING_ROTATION
from heliograph.errors import HeliographError
from heliograph.lie import so3
from heliograph.odometry import FilterOdometry
from heliograph.odometry.follow import follow_lidar, thrifty

__all__ = ["MountingAlignment", "align_mounting", "align_rotations"]

Message = Scan | ImuBatch | GnssFix

_WINDOW = 5  # scans over which turns are compared
_LOOK_EVERY = 20  # scans after which it is asked whether the turns suffice
_TURN_SIGMA = 0.004  # of one such comparison: the LiDAR's odometry and the gyroscope's drift together [rad]
_SUFFICIENT_SIGMA = 0.005  # the rotation is known well enough when its weakest axis is [rad]
_MAX_SECONDS = 60.0  # of the recording looked at [s]
_CALIBRATED_SECONDS, _CALIBRATED_POINTS = 30.0, 6000  # of them that a calibration gets [s], and of a scan
_LARGEST_SIGMA = np.radians(1.0)  # of a calibrated rotation's weakest axis [rad]
# Each pass begins with a better guess, so that its map is bent less by the error still to be found; it ends when a pass
# changes little.
_MAX_PASSES = 5
_SETTLED_ROTATION, _SETTLED_LEVER = 5e-4, 0.005  # [rad], [m]
# A pass that runs farther from the rough guess than this many of its sigmas has lost its footing.
_IMPLAUSIBLE_SIGMAS = 4.0
_THINNING_STEP = 3  # every third point is used: the mounting shows in the motion, not in the map's detail
_LEVER_SIGMA = 0.3  # of a lever arm that no source gives [m]
_ROTATION_FLOOR, _LEVER_FLOOR = 1e-3, 0.02  # of the sigmas that the filter ends with [rad], [m]
_CALIBRATED_FLOOR = (5e-4, 0.005)  # of those that a calibration ends with [rad], [m]
_CLOCK_SIGMAS, _LEAST_OFFSET = 5.0, 0.003  # of a clock offset that is told [s]


@dataclass(frozen=True, slots=True, kw_only=True)
class MountingAlignment:
    """What was found.

    Parameters
    ----------
    rig : Rig
        With the sigmas that remain; the run takes it as given.
    sigma_rotation : (3,) float64
        Sigma of the rotation alone about the lidar axes, from turns [rad].
    duration : float
        Data used [s].
    events : tuple of Event
        One warning with numbers and remedy.
    """

    rig: Rig
    sigma_rotation: Array
    duration: float
    events: tuple[Event, ...]

    def __post_init__(self) -> None:
        freeze(self)


def align_mounting(
    open_stream: Callable[[], Iterable[Message]], config: RunConfig, *, threads: int = 1
) -> MountingAlignment:
    """Find ``T_imu_lidar`` from the first minute of a recording, or less where turns about two axes come sooner.

    Parameters
    ----------
    open_stream : callable
        Returns the recording's messages from the start, each time it is called; three to six times here.
    config : RunConfig
    threads : int

    Returns
    -------
    MountingAlignment
        A calibration's, or where that does not settle the rotation from turns and the lever arm from the filter. An
        axis about which nothing turned keeps its wide sigma.
    """
    turns_lidar, turns_imu, spans, until_ns, begin_ns = _turns(open_stream(), config, threads)
    duration = (until_ns - begin_ns) * 1e-9
    if len(turns_lidar) < 3:
        return _unknown(duration, "too few scans could be matched")
    R, covariance = align_rotations(turns_lidar, turns_imu, spans)
    sigma = np.sqrt(np.linalg.eigvalsh(covariance))
    if sigma[0] > 0.5:
        return _unknown(duration, "the recording hardly turns")
    T = np.eye(4)
    T[:3, :3] = R
    rough = Rig(
        T_imu_lidar=T,
        source="aligned from turns",
        known=False,
        sigma_rotation=float(np.clip(sigma[-1], 0.01, 0.5)),
        sigma_translation=_LEVER_SIGMA,
    )
    found, sure = _calibrated(open_stream(), rough, config, threads)
    if found is not None and sure:
        event = _found(found.rig, found.duration, _clock_in_words(found))
        return MountingAlignment(rig=found.rig, sigma_rotation=sigma, duration=found.duration, events=(event,))
    rig = _settled(open_stream, rough, config, threads, begin_ns + int(_MAX_SECONDS * 1e9))
    if found is not None:  # two ways that disagree are no surer than by as much as they do
        turn, shift = _difference(rig, found.rig)
        rig = replace(
            rig, sigma_rotation=max(rig.sigma_rotation, turn), sigma_translation=max(rig.sigma_translation, shift)
        )
    return MountingAlignment(rig=rig, sigma_rotation=sigma, duration=duration, events=(_found(rig, duration),))


def _calibrated(
    stream: Iterable[Message], rough: Rig, config: RunConfig, threads: int
) -> tuple[Calibration | None, bool]:
    """Let a calibration find the mounting; return it, and whether it settled near the turns' rotation and knows better.

    Its rig comes with the sigmas that the run is told, and with the clock that the samples have already.
    """
    calibration = config.calibration
    least = replace(
        calibration,
        longest=min(calibration.longest, _CALIBRATED_SECONDS),
        points=min(calibration.points, _CALIBRATED_POINTS),
    )
    config = replace(config, calibration=least)
    try:
        found = calibrate(stream, rough, config, threads=threads)
    except HeliographError:
        return None, False
    finally:
        if isinstance(stream, Generator):
            stream.close()
    sigma = np.array([axis.sigma for axis in found.axes])
    turn, _ = _difference(rough, found.rig)
    near = turn <= _IMPLAUSIBLE_SIGMAS * rough.sigma_rotation
    rig = replace(
        rough,
        T_imu_lidar=found.rig.T_imu_lidar,
        source="calibrated from the recording",
        known=True,
        sigma_rotation=float(max(sigma[:3].max(), _CALIBRATED_FLOOR[0])),
        sigma_translation=float(max(sigma[3:6].max(), _CALIBRATED_FLOOR[1])),
    )
    return replace(found, rig=rig), bool(found.converged and near and sigma[:3].max() <= _LARGEST_SIGMA)


def _settled(
    open_stream: Callable[[], Iterable[Message]], rough: Rig, config: RunConfig, threads: int, until_ns: int
) -> Rig:
    """Repeat the filter's estimate from where the last one ended, until a pass changes little.

    What comes out is then taken as given by the run: where the motion tells too little the rough guess is kept, with
    its wide sigmas, because a filter that goes on searching for a mounting without evidence ends far away.
    """
    rig = rough
    for _ in range(_MAX_PASSES):
        before = rig
        rig = _refined(open_stream(), replace(rough, T_imu_lidar=before.T_imu_lidar), config, threads, until_ns)
        turn, shift = _difference(rough, rig)
        if turn > _IMPLAUSIBLE_SIGMAS * rough.sigma_rotation or shift > _IMPLAUSIBLE_SIGMAS * rough.sigma_translation:
            return replace(rough, known=True)
        turn, shift = _difference(before, rig)
        if turn < _SETTLED_ROTATION and shift < _SETTLED_LEVER:
            break
    return replace(rig, known=True)


def _difference(a: Rig, b: Rig) -> tuple[float, float]:
    """Return the angle [rad] and the distance [m] between two mountings."""
    turn = so3.log(a.T_imu_lidar[:3, :3].T @ b.T_imu_lidar[:3, :3])
    return float(np.linalg.norm(turn)), float(np.linalg.norm(a.T_imu_lidar[:3, 3] - b.T_imu_lidar[:3, 3]))


def align_rotations(turns_lidar: Array, turns_imu: Array, spans: Array) -> tuple[Array, Array]:
    """Return the rotation that maps turns of the lidar frame onto those of the imu frame, and its covariance.

    Solves ``min sum |phi_imu - R phi_lidar - b span|^2`` over R and the gyroscope's bias b, alternating the closed form
    for R (G. Wahba, 1965, by SVD) with the mean for b.

    Parameters
    ----------
    turns_lidar, turns_imu : (N, 3) float64
        Rotation vectors over the same windows, each in its own frame [rad].
    spans : (N,) float64
        Length of each window [s].

    Returns
    -------
    R_imu_lidar : (3, 3) float64
    covariance : (3, 3) float64
        Covariance of its error about the lidar axes [rad^2]; large along an axis about which nothing else turned.
    """
    bias, R = np.zeros(3), np.eye(3)
    for _ in range(20):
        free = turns_imu - spans[:, None] * bias
        U, _, Vt = np.linalg.svd(free.T @ turns_lidar)
        R = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
        bias = ((turns_imu - turns_lidar @ R.T) * spans[:, None]).sum(axis=0) / (spans**2).sum()
    # d(R phi) = -R [phi] d: each turn tells nothing about the rotation around itself.
    H = so3.hat(turns_lidar)
    residual = turns_imu - spans[:, None] * bias - turns_lidar @ R.T
    spread = max(_TURN_SIGMA, float(np.sqrt(np.mean(residual**2))))
    # Windows overlap, so only every _WINDOW-th is independent.
    information = np.einsum("kij,kil->jl", H, H) / (_WINDOW * spread**2)
    return R, np.linalg.inv(information + np.eye(3) / np.pi**2)


def _turns(stream: Iterable[Message], config: RunConfig, threads: int) -> tuple[Array, Array, Array, int, int]:
    """Run the LiDAR alone and integrate the gyroscope beside it until the turns suffice."""
    ends: list[int] = []
    rotations: list[Array] = []
    imu: list[ImuBatch] = []

    def scans() -> Iterator[Scan]:
        for message in stream:
            if isinstance(message, ImuBatch):
                imu.append(message)
            elif isinstance(message, Scan):
                yield message.thinned(_THINNING_STEP)

    for result in follow_lidar(scans(), config, threads=threads):
        if not result.matched:
            continue
        ends.append(result.end_ns)
        rotations.append(result.T_odom_imu[:3, :3])
        if len(ends) % _LOOK_EVERY == 0 and _suffice(ends, rotations):
            break
    if len(ends) <= _WINDOW or not imu:
        return np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0), ends[-1] if ends else 0, ends[0] if ends else 0
    integrated = _integrated_gyro(imu, np.array(ends))
    stack = np.stack(rotations)
    lidar = so3.log(np.swapaxes(stack[:-_WINDOW], -1, -2) @ stack[_WINDOW:])
    gyro = so3.log(np.swapaxes(integrated[:-_WINDOW], -1, -2) @ integrated[_WINDOW:])
    spans = (np.array(ends[_WINDOW:]) - np.array(ends[:-_WINDOW])) * 1e-9
    return lidar, gyro, spans, ends[-1], ends[0]


def _suffice(ends: list[int], rotations: list[Array]) -> bool:
    if (ends[-1] - ends[0]) * 1e-9 > _MAX_SECONDS:
        return True
    stack = np.stack(rotations)
    turns = so3.log(np.swapaxes(stack[:-_WINDOW], -1, -2) @ stack[_WINDOW:])
    H = so3.hat(turns)
    information = np.einsum("kij,kil->jl", H, H) / (_WINDOW * _TURN_SIGMA**2)
    return float(np.linalg.eigvalsh(information)[0]) > 1.0 / _SUFFICIENT_SIGMA**2


def _integrated_gyro(batches: list[ImuBatch], at_ns: NDArray[np.int64]) -> Array:
    """Return the gyroscope's own orientation at the stamps, from an arbitrary first one, (N, 3, 3)."""
    whole = ImuBatch.joined(batches)
    stamps, rates = whole.stamps_ns, whole.gyro
    inside = np.unique(np.concatenate([stamps, at_ns]))
    rate = np.stack([np.interp(inside - stamps[0], stamps - stamps[0], rates[:, i]) for i in range(3)], axis=1)
    steps = so3.exp(0.5 * (rate[1:] + rate[:-1]) * (np.diff(inside) * 1e-9)[:, None])
    R = [np.eye(3)]
    for step in steps:
        R.append(R[-1] @ step)
    return np.stack(R)[np.searchsorted(inside, at_ns)]


def _refined(stream: Iterable[Message], rough: Rig, config: RunConfig, threads: int, until_ns: int) -> Rig:
    """Let the filter estimate the whole mounting over the same data."""
    config = thrifty(config, config.cloud.target_points // 2)
    odometry = FilterOdometry(config, rough, sensors=frozenset({"lidar", "imu"}), threads=threads)
    for message in _until(stream, until_ns):
        odometry.add(message.thinned(_THINNING_STEP) if isinstance(message, Scan) else message)
    odometry.finish()
    if odometry.core is None:
        return rough
    state = odometry.core.state
    sigma = np.sqrt(np.diag(state.covariance))
    # The floors stand for what the filter does not model: the mount's own sway, time offsets, the map's errors.
    return replace(
        rough,
        T_imu_lidar=state.T_imu_lidar,
        source="aligned from the data",
        sigma_rotation=float(max(sigma[MOUNTING_ROTATION].max(), _ROTATION_FLOOR)),
        sigma_translation=float(max(sigma[LEVER_ARM].max(), _LEVER_FLOOR)),
    )


def _until(stream: Iterable[Message], until_ns: int) -> Iterator[Message]:
    for message in stream:
        if isinstance(message, Scan) and message.end_ns > until_ns:
            return
        yield message


def _found(rig: Rig, duration: float, clock: str = "") -> Event:
    angle = np.degrees(float(np.linalg.norm(so3.log(rig.T_imu_lidar[:3, :3]))))
    x, y, z = rig.T_imu_lidar[:3, 3]
    text = (
        f"no transform links LiDAR and IMU: it was aligned from {duration:.0f} s of motion - rotation {angle:.1f} deg "
        f"(+- {np.degrees(rig.sigma_rotation):.2f}), lever arm ({x:.3f}, {y:.3f}, {z:.3f}) m "
        f"(+- {rig.sigma_translation:.3f}){clock}; give the true one with --extrinsic FILE or a /tf_static, "
        "or this one again with this run's run.json as FILE"
    )
    return Event(code="mounting-aligned", message=text)


def _unknown(duration: float, why: str) -> MountingAlignment:
    text = (
        f"no transform links LiDAR and IMU, and {why} in the first {duration:.0f} s, so it cannot be aligned; both are "
        f"taken to be parallel with wide uncertainty - give the transform with --extrinsic FILE or a /tf_static"
    )
    rig = Rig(T_imu_lidar=np.eye(4), source="unknown", known=False, sigma_rotation=0.5, sigma_translation=_LEVER_SIGMA)
    return MountingAlignment(
        rig=rig,
        sigma_rotation=np.full(3, np.pi),
        duration=duration,
        events=(Event(code="mounting-unknown", message=text),),
    )


def _clock_in_words(found: Calibration) -> str:
    """Return what is said of the clock that was found beside; empty where the samples' own is as good."""
    offset, sigma = found.axes[6].value, found.axes[6].sigma
    if abs(offset) < max(_CLOCK_SIGMAS * sigma, _LEAST_OFFSET):
        return ""
    return (
        f", and the IMU's clock {1e3 * abs(offset):.1f} +- {1e3 * sigma:.1f} ms {'late' if offset > 0.0 else 'early'}, "
        "which is left as it is: `heliograph calibrate` writes a file with both"
    )
