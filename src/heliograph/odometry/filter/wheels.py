"""Speeds of wheels or legs in the filter: believed once they have agreed with LiDAR and IMU, and gated one by one.

Two questions are asked of each speed. Does the prediction know the velocity well enough to tell a wrong one? If not, as
after a while on the IMU alone, nothing could refuse it, and it is not used. And does it lie where the prediction allows
(the innovation in units of its variance, chi-square of one degree of freedom)? If not, the wheels slip. Before any
speed is used ten in motion must have agreed; where most of the last forty contradict, they must begin again: a wrong
sign, another unit, a wheel that is stuck never count.

A slip that grows slowly passes each test, and takes velocity and accelerometer bias with it. What it leaves are
innovations with a mean: that of two seconds is held against what such means have been. Wheels that fail so count again
only where the LiDAR sees.

Wheels that stand are no proof of rest: on a belt, a ferry or ice the body moves with them still. However long they say
zero, the velocity is known by them to `_CREEP` and no better.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import Array, Mask, Stamps, freeze
from heliograph.chi_square import chi_square_quantile
from heliograph.config import WheelConfig
from heliograph.data import Event, NavState, WheelSpeeds
from heliograph.data.error_layout import FULL_DIM, NAV_DIM, WHEEL_SCALE, WHEELED_DIM
from heliograph.imu import ImuPath
from heliograph.lie import so3
from heliograph.odometry.filter.speed_window import SpeedWindow
from heliograph.odometry.filter.update import FilterUpdate, iterated_update
from heliograph.snapshots import Stateful

__all__ = ["SpeedMeasurement", "SpeedTrust", "SpeedUpdates", "with_wheel_scale"]

_WHITE = 0.1  # seconds over which the error of a speed is one
_TELLS = 0.2  # sigma of a predicted speed that can tell a wrong one [m/s]
_MOVING = 0.3  # speed from which sign and unit show [m/s]
_EARNED, _FORGIVEN = 10, 1  # tests in motion that must have agreed before a speed counts, and of them that need not
_REMEMBERED = 40  # tests by which the wheels themselves are doubted where most of them contradict
_BLOCK, _SETTLING, _LEARNT = 20, 2, 5  # tests of a mean; means left out at first; means before one is judged
_MEAN_GAIN, _MEAN_SIGMAS, _MEAN_FLOOR = 0.1, 5.0, 0.002  # of the square of means; of a mean that fails; [m/s]
_SIDEWAYS_GAIN, _SIDEWAYS_TESTS = 0.05, 40  # of the mean square speed across, and tests before it is believed
_STANDING, _CREEP = 0.05, 0.02  # measured speed below which wheels stand; what the body may do then, one-sigma [m/s]
_ITERATIONS = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class SpeedTrust:
    """What the speeds so far have shown of their worth.

    Parameters
    ----------
    recent : tuple of bool
        Whether the last tests in motion agreed.
    believed : bool
        Whether speeds are used.
    block : tuple of float
        Innovations along the way since the last mean [m/s].
    usual : float
        Mean square of the means [m^2/s^2].
    means : int
        How many there were.
    barred : bool
        Whether a mean has failed: speeds count again only where the LiDAR sees.
    slipping : bool
        Whether the last test contradicted.
    tests, slips, used : int
        Sweeps whose speed could be told, those of them that contradicted, and those that were used.
    untold : int
        Sweeps with speeds whose prediction could not tell a wrong one.
    sideways : (3,) float64
        Mean square of the speed along the vehicle's axes where the prediction knows it [m^2/s^2].
    crossed : int
        Tests in it.
    way, foreseen : float
        Sums of measured and foreseen lengths in motion, for what is said of a contradiction [m].
    used_ns : int
        Speeds up to then have been heard [ns].
    """

    recent: tuple[bool, ...] = ()
    believed: bool = False
    block: tuple[float, ...] = ()
    usual: float = 0.0
    means: int = 0
    barred: bool = False
    slipping: bool = False
    tests: int = 0
    slips: int = 0
    used: int = 0
    untold: int = 0
    sideways: Array
    crossed: int = 0
    way: float = 0.0
    foreseen: float = 0.0
    used_ns: int = 0

    def __post_init__(self) -> None:
        freeze(self)

    def tested(self, off: float, *, agrees: bool, moving: bool, sees: bool) -> SpeedTrust:
        """Return the trust after a speed along the way that could be told, and its innovation [m/s]."""
        recent, believed = self.recent, self.believed
        if moving:
            recent = (*recent, agrees)[-_REMEMBERED:]
            last = recent[-_EARNED:]
            if not believed:
                believed = len(last) == _EARNED and last.count(False) <= _FORGIVEN and agrees
                believed = believed and (sees or not self.barred)
            elif len(recent) == _REMEMBERED and 2 * recent.count(False) > _REMEMBERED:
                believed, recent = False, ()
        after = replace(
            self, recent=recent, believed=believed, slipping=not agrees, barred=self.barred and not believed,
            tests=self.tests + 1, slips=self.slips + (not agrees),
        )  # fmt: skip
        return after._averaged(off) if believed and agrees and moving else after

    def _averaged(self, off: float) -> SpeedTrust:
        """Return the trust after an innovation [m/s] of speeds that count, which must have no mean over two seconds."""
        block = (*self.block, off)
        if len(block) < _BLOCK:
            return replace(self, block=block)
        mean, judged = float(np.mean(block)), self.means - _SETTLING
        if judged >= _LEARNT and abs(mean) > _MEAN_SIGMAS * max(math.sqrt(self.usual), _MEAN_FLOOR):
            return replace(self, block=(), recent=(), believed=False, barred=True)
        usual = self.usual
        if judged >= 0:
            usual += max(_MEAN_GAIN, 1.0 / (judged + 1)) * (mean**2 - usual)
        return replace(self, block=(), usual=usual, means=self.means + 1)

    def across(self, speed: Array) -> SpeedTrust:
        """Return the trust after a speed (3,) of the point that the prediction knows, vehicle axes [m/s]."""
        gain = max(_SIDEWAYS_GAIN, 1.0 / (self.crossed + 1))
        return replace(self, sideways=self.sideways + gain * (speed**2 - self.sideways), crossed=self.crossed + 1)


@dataclass(frozen=True, slots=True, kw_only=True)
class SpeedMeasurement:
    """What the axes of a speed that are believed say of the whole error state."""

    columns: NDArray[np.intp]
    information: Array
    gradient: Array

    def __post_init__(self) -> None:
        freeze(self)


class SpeedUpdates(Stateful):
    """Holds a run's speeds and updates predicted states with them; without any it does nothing.

    Parameters
    ----------
    config : WheelConfig
    """

    _STATE: ClassVar = {"trust": SpeedTrust, "_events": [Event]}

    def __init__(self, config: WheelConfig) -> None:
        self.trust = SpeedTrust(sideways=np.zeros(3))
        """What the speeds have shown so far."""
        self._config = config
        self._gate = chi_square_quantile(config.slip_probability, 1)
        self._stamps: Stamps = np.zeros(0, dtype=np.int64)
        self._v: Array = np.zeros((0, 3))
        self._measured: Mask = np.zeros(3, dtype=bool)
        self._sigma: Array = np.zeros(3)
        self._turn = so3.from_rpy(0.0, 0.0, math.radians(config.yaw_deg))
        self._arm = np.array(config.lever_arm)
        self._events: list[Event] = []

    def __len__(self) -> int:
        return len(self._stamps)

    def observe(self, speeds: WheelSpeeds) -> None:
        """Take speeds that follow those before."""
        if speeds.T_imu_vehicle is not None and not (self._config.yaw_deg or any(self._config.lever_arm)):
            self._turn, self._arm = speeds.T_imu_vehicle[:3, :3], speeds.T_imu_vehicle[:3, 3]
        v = np.where(np.isfinite(speeds.v_body), speeds.v_body, 0.0)
        self._stamps = np.concatenate([self._stamps, speeds.stamps_ns])
        self._v = np.concatenate([self._v, v @ self._turn.T])
        self._measured = np.asarray(np.isfinite(speeds.v_body).any(axis=0), dtype=bool)
        self._sigma = np.asarray(speeds.sigma)

    def updated(
        self, prior: NavState, path: ImuPath, considered: Array | None, *, sees: bool
    ) -> FilterUpdate[SpeedMeasurement] | None:
        """Return a prediction updated with the speeds of its way; None where they are not believed, or say nothing.

        Parameters
        ----------
        prior : NavState
            Predicted along ``path``, with the error of the scale.
        path : ImuPath
        considered : (K, K) float64 or None
            As in `iterated_update`.
        sees : bool
            Whether the scan before saw all directions.
        """
        if not len(self) or len(prior.covariance) != WHEELED_DIM or int(path.stamps_ns[0]) < self.trust.used_ns:
            return None
        window = SpeedWindow.of(self._stamps, self._v, path, prior, self._turn, self._arm)
        if window is None:
            return None
        axes = self._judged(window, prior, sees=sees)
        self.trust = replace(self.trust, used_ns=int(path.stamps_ns[-1]))
        if not len(axes):
            return None
        self.trust = replace(self.trust, used=self.trust.used + 1)
        weights = self._weights(window, prior)[axes]

        def measure(state: NavState, _: int) -> SpeedMeasurement:
            J, r = window.jacobian(state)[axes], window.residual(state)[axes]
            return SpeedMeasurement(
                columns=np.arange(J.shape[1]),
                information=(J.T * weights) @ J,
                gradient=(J.T * weights) @ r,
            )

        return iterated_update(
            prior, measure, max_iterations=_ITERATIONS, tolerance_rotation=1e-4, tolerance_position=1e-3,
            considered=considered,
        )  # fmt: skip

    def taken_events(self) -> tuple[Event, ...]:
        """Return what has happened since it was asked last."""
        events, self._events = tuple(self._events), []
        return events

    def conclusion(self, state: NavState) -> tuple[Event, ...]:
        """Return what is to be said of all speeds at the end, which is at a state."""
        trust = self.trust
        if trust.used:
            sigma = math.sqrt(max(float(state.covariance[WHEEL_SCALE, WHEEL_SCALE]), 0.0))
            text = (
                f"wheels: speeds of {trust.used} sweeps count in the odometry, those of {trust.slips} contradict it; "
                f"scale {state.wheel_scale:.4f} +- {sigma:.4f}"
            )
            return (Event(code="wheel-speeds", message=text, count=trust.used, severity="info"),)
        if trust.tests < _REMEMBERED or 2 * trust.slips <= trust.tests:
            return ()
        ratio = trust.foreseen / trust.way if trust.way else 0.0
        text = (
            f"wheels: {trust.slips} of {trust.tests} speeds contradict LiDAR and IMU; the odometry used none. The "
            f"way is {ratio:.2f} times what the wheels say: check sign, unit and wheels.yaw_deg"
        )
        return (Event(code="wheel-contradiction", message=text, count=trust.slips),)

    def _variance(self, seconds: float) -> Array:
        """Return the variance (3,) of a mean speed over so long, vehicle axes."""
        speed = np.maximum(self._sigma, self._config.speed_sigma)  # what a driver says of itself only makes it worse
        across = np.maximum(self._config.lateral_sigma, 2.0 * np.sqrt(self.trust.sideways))
        sigma = np.where(self._measured, speed, across)
        return np.asarray(sigma**2 * min(_WHITE, seconds) / seconds)

    def _weights(self, window: SpeedWindow, prior: NavState) -> Array:
        """Return the information (3,) of a speed, vehicle axes; that of standing wheels leaves `_CREEP` open."""
        weights = 1.0 / self._variance(window.seconds)
        if float(np.linalg.norm(window.measured)) >= _STANDING:
            return np.asarray(weights)
        J = window.jacobian(prior)
        known = 1.0 / np.maximum(np.einsum("ij,jk,ik->i", J, prior.covariance, J), 1e-12)
        return np.asarray(np.minimum(weights, np.maximum(_CREEP**-2 - known, 0.0)))

    def _judged(self, window: SpeedWindow, prior: NavState, *, sees: bool) -> NDArray[np.intp]:
        """Return which of the vehicle's axes are to be used, (M,) int, and take in what the others show."""
        J, r, foreseen = window.jacobian(prior), window.residual(prior), window.foreseen(prior)
        known = J.copy()
        known[:, WHEEL_SCALE] = 0.0
        told = np.einsum("ij,jk,ik->i", known, prior.covariance, known) <= _TELLS**2
        allowed = np.einsum("ij,jk,ik->i", J, prior.covariance, J) + self._variance(window.seconds)
        agrees = r * r <= self._gate * allowed
        along = int(np.argmax(self._measured))
        said = float((window.R_imu_vehicle.T @ window.measured)[along])
        moving = max(abs(said), abs(float(foreseen[along]))) > _MOVING
        if not told[along]:
            self.trust = replace(self.trust, untold=self.trust.untold + 1)
            return np.zeros(0, dtype=np.intp)
        before = self.trust
        if moving:
            sign = math.copysign(1.0, said)
            self.trust = replace(
                before, way=before.way + abs(said) * window.seconds,
                foreseen=before.foreseen + sign * float(foreseen[along]) * window.seconds,
            )  # fmt: skip
        self.trust = self.trust.tested(float(r[along]), agrees=bool(agrees[along]), moving=moving, sees=sees)
        if told.all():
            self.trust = self.trust.across(foreseen)
        self._told(before, prior, r[along])
        if not self.trust.believed or not agrees[along]:
            return np.zeros(0, dtype=np.intp)
        bounded = np.sqrt(self.trust.sideways) <= self._config.lateral_sigma
        holds = self._measured | (bounded & (self.trust.crossed >= _SIDEWAYS_TESTS))
        return np.flatnonzero(told & agrees & holds)

    def _told(self, before: SpeedTrust, prior: NavState, off: float) -> None:
        """Say where a spell of slip begins, and where the wheels are believed no more."""
        if before.believed and self.trust.slipping and not before.slipping:
            text = (
                f"wheels: a speed lies {abs(off):.2f} m/s from what LiDAR and IMU foresee: slip; it is left out, "
                "and those after it until they agree again"
            )
            self._events.append(Event(code="wheel-slip", message=text, stamp_ns=prior.stamp_ns))
        if before.believed and not self.trust.believed:
            text = "wheels: most of the last speeds contradict LiDAR and IMU; none counts until they agree again"
            if self.trust.barred:
                text = (
                    "wheels: their speeds drift away from what LiDAR and IMU foresee, as when slip sets in slowly; "
                    "none counts until the LiDAR sees all directions"
                )
            self._events.append(Event(code="wheel-doubt", message=text, stamp_ns=prior.stamp_ns))


def with_wheel_scale(state: NavState, config: WheelConfig) -> NavState:
    """Return a start with the error of the wheels' scale; mounting and clock that had none are known exactly."""
    size = len(state.covariance)
    if size not in (NAV_DIM, FULL_DIM):
        return state
    covariance = np.zeros((WHEELED_DIM, WHEELED_DIM))
    covariance[:size, :size] = state.covariance
    covariance[WHEEL_SCALE, WHEEL_SCALE] = config.scale_sigma**2
    return replace(state, covariance=covariance, wheel_scale=1.0)
