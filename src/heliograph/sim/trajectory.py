"""Smooth motion with exact derivatives: a spline over the ground, a speed profile along it, and a gait on top."""

from __future__ import annotations

from dataclasses import dataclass
from math import comb, factorial

import numpy as np

from heliograph.arrays import Array, freeze
from heliograph.errors import DataError
from heliograph.lie import so3

__all__ = ["Course", "Gait", "SimulatedMotion", "SpeedProfile", "UniformSpline", "WalkedPath"]


_DEGREE = 5
_STEP_COEFFICIENTS = np.array(
    [0.0, 0.0, 0.0, 0.0, 35.0, -84.0, 70.0, -20.0]
)  # rises from 0 to 1 with three vanishing derivatives


def _polynomial(coefficients: Array, x: Array, derivative: int) -> Array:
    """Evaluate the ``derivative``-th derivative of ascending polynomials, one a column of ``coefficients``."""
    for _ in range(derivative):
        coefficients = (coefficients[1:].T * np.arange(1, len(coefficients))).T
    return np.asarray(np.polynomial.polynomial.polyval(x, coefficients))


def _basis() -> Array:
    """Ascending coefficients of the uniform quintic B-spline's six pieces, one row a control point."""
    rows = np.zeros((_DEGREE + 1, _DEGREE + 1))
    for j in range(_DEGREE + 1):
        for k in range(_DEGREE + 1 - j):
            shifted = np.polynomial.polynomial.polypow([_DEGREE - j - k, 1.0], _DEGREE)
            rows[j] += (-1) ** k * comb(_DEGREE + 1, k) * shifted
    return rows / factorial(_DEGREE)


class UniformSpline:
    """Quintic B-spline with unit knot spacing: four continuous derivatives, none of them approximate.

    Parameters
    ----------
    controls : (N + 5, D) float64
        Control points; the spline covers ``u`` in [0, N].

    Notes
    -----
    C. de Boor, A Practical Guide to Splines (1978), chapter IX, for the cardinal B-spline.
    """

    _pieces = _basis()

    def __init__(self, controls: Array) -> None:
        if controls.ndim != 2 or len(controls) <= _DEGREE:
            raise DataError(f"a quintic spline needs at least 6 control points, got shape {controls.shape}")
        self._controls = controls
        self.length = len(controls) - _DEGREE

    def __call__(self, u: Array, derivative: int = 0) -> Array:
        """Return the ``derivative``-th derivative by ``u`` at each of ``u``, shape (M, D)."""
        segment = np.clip(np.floor(u).astype(np.int64), 0, self.length - 1)
        weights = _polynomial(self._pieces.T, u - segment, derivative).T
        window = self._controls[segment[:, None] + np.arange(_DEGREE + 1)]
        return np.asarray(np.einsum("mj,mjd->md", weights, window))


@dataclass(frozen=True, slots=True, kw_only=True)
class SpeedProfile:
    """Rest, smooth start, cruise, smooth stop: distance and its derivatives over time.

    Parameters
    ----------
    rest : float
        Standing time before the start [s].
    ramp : float
        Duration of the start and of the stop [s].
    speed : float
        Cruising speed [m/s].
    distance : float
        Way from start to stop [m].
    """

    rest: float
    ramp: float
    speed: float
    distance: float

    def __post_init__(self) -> None:
        if self.distance < self.speed * self.ramp:
            raise DataError(
                f"a way of {self.distance:.2f} m is too short for ramps of {self.ramp} s at {self.speed} m/s"
            )

    @property
    def stop(self) -> float:
        """Time at which the motion has ended [s]."""
        return self.rest + self.ramp + self.distance / self.speed

    def fraction(self, t: Array, derivative: int = 0) -> Array:
        """Speed as a fraction of the cruising speed, or its derivative by time; -1 gives its integral."""
        x_start = np.clip((t - self.rest) / self.ramp, 0.0, 1.0)
        x_stop = np.clip((t - self.stop + self.ramp) / self.ramp, 0.0, 1.0)
        if derivative >= 0:
            scale = self.ramp**-derivative
            return (
                _polynomial(_STEP_COEFFICIENTS, x_start, derivative)
                - _polynomial(_STEP_COEFFICIENTS, x_stop, derivative)
            ) * scale
        integral = np.concatenate([[0.0], _STEP_COEFFICIENTS / np.arange(1, len(_STEP_COEFFICIENTS) + 1)])
        late = np.clip(t - self.rest - self.ramp, 0.0, self.stop - self.rest - self.ramp)
        return self.ramp * (_polynomial(integral, x_start, 0) - _polynomial(integral, x_stop, 0)) + late


@dataclass(frozen=True, slots=True, kw_only=True)
class Gait:
    """Periodic motion of a walker about the smooth path; all of it fades in and out with the speed.

    Parameters
    ----------
    frequency : float
        Steps a second [Hz]; bounce and pitch follow it, lateral motion, roll and yaw have half of it.
    bounce, lateral : float
        Vertical and sideways amplitude [m].
    roll_deg, pitch_deg, yaw_deg : float
        Amplitudes of the sway [deg].
    """

    frequency: float = 1.8
    bounce: float = 0.02
    lateral: float = 0.015
    roll_deg: float = 2.0
    pitch_deg: float = 1.5
    yaw_deg: float = 2.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Course:
    """Where to walk: a polyline with rounded corners.

    Parameters
    ----------
    waypoints : (K, 3) float64
        Corners [m]; a closed course returns from the last to the first, and the first must lie inside a straight.
    corner : float
        Radius of the corners [m].
    closed : bool
        Whether the course is a loop.
    """

    waypoints: Array
    corner: float
    closed: bool = True

    def __post_init__(self) -> None:
        freeze(self)

    def sample(self, spacing: float) -> tuple[Array, float]:
        """Return points and unwrapped headings (M, 4) at equal distances near ``spacing``, and that distance."""
        dense, heading = self._round_corners()
        s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(dense[:, :2], axis=0), axis=1))])
        count = max(round(float(s[-1]) / spacing), _DEGREE + 1)
        where = np.linspace(0.0, s[-1], count + 1)
        columns = [np.interp(where, s, dense[:, i]) for i in range(3)]
        return np.stack([*columns, np.interp(where, s, heading)], axis=1), float(s[-1] / count)

    def _round_corners(self) -> tuple[Array, Array]:
        """Polyline with arcs in place of its corners, and the unwrapped heading at each of its points."""
        points = np.vstack([self.waypoints, self.waypoints[:1]]) if self.closed else self.waypoints
        legs = np.diff(points, axis=0)
        angles = np.unwrap(np.arctan2(legs[:, 1], legs[:, 0]))
        path, heading = [points[0]], [angles[0]]
        for before, after, vertex, leg in zip(angles, angles[1:], points[1:], legs, strict=False):
            turn = after - before
            cut = self.corner * np.tan(abs(turn) / 2.0)
            entry = vertex - cut * leg / np.linalg.norm(leg[:2])
            for k in np.linspace(0.0, 1.0, 17) if abs(turn) > 1e-9 else [0.0]:
                side = np.sign(turn) * self.corner
                angle = before + k * turn
                arc = side * np.array([np.sin(angle) - np.sin(before), np.cos(before) - np.cos(angle), 0.0])
                path.append(entry + arc)
                heading.append(angle)
        return np.vstack([*path, points[-1:]]), np.array([*heading, angles[-1]])


@dataclass(frozen=True, slots=True, kw_only=True)
class SimulatedMotion:
    """State of a moving frame at M instants.

    Parameters
    ----------
    R_world_body : (M, 3, 3) float64
        Orientation.
    p_world, v_world, a_world : (M, 3) float64
        Position [m], velocity [m/s], acceleration [m/s^2].
    omega_body : (M, 3) float64
        Angular rate in the body's own axes [rad/s].
    """

    R_world_body: Array
    p_world: Array
    v_world: Array
    a_world: Array
    omega_body: Array

    def __post_init__(self) -> None:
        freeze(self)

    @property
    def T_world_body(self) -> Array:
        """Poses as (M, 4, 4) matrices."""
        T = np.zeros((len(self.p_world), 4, 4))
        T[:, :3, :3] = self.R_world_body
        T[:, :3, 3] = self.p_world
        T[:, 3, 3] = 1.0
        return T


class WalkedPath:
    """A course walked with a speed profile and a gait; every derivative is analytic.

    Parameters
    ----------
    course : Course
        Where to walk.
    gait : Gait
        How the body moves about the path.
    rest, ramp, speed : float
        See `SpeedProfile`.
    """

    def __init__(self, course: Course, gait: Gait, *, rest: float, ramp: float, speed: float) -> None:
        samples, self._spacing = course.sample(1.0)
        # The spline starts at the first sample exactly: the two control points before it continue the straight.
        if course.closed:
            turn = samples[-1] - samples[0]
            loop = samples[:-1]
            controls = np.vstack([loop[-2:] - turn, loop, loop[:3] + turn])
        else:
            first, last = samples[1] - samples[0], samples[-1] - samples[-2]
            controls = np.vstack([samples[0] - 2 * first, samples[0] - first, samples, samples[-1] + last])
            controls = np.vstack([controls, samples[-1] + 2 * last])
        self._spline = UniformSpline(controls)
        self._gait = gait
        self.profile = SpeedProfile(rest=rest, ramp=ramp, speed=speed, distance=self._spline.length * self._spacing)

    def __call__(self, t: Array) -> SimulatedMotion:
        """Return the motion of the body at times ``t`` [s], shape (M,), from the beginning of the rest."""
        rate = self.profile.speed / self._spacing
        envelope = [self.profile.fraction(t, k) for k in range(3)]
        u, du, ddu = (rate * f[:, None] for f in (self.profile.fraction(t, -1), *envelope[:2]))
        q0, q1, q2 = (self._spline(u[:, 0], k) for k in range(3))
        q, dq, ddq = q0, q1 * du, q2 * du**2 + q1 * ddu
        gait, full, half = self._gait, self._gait.frequency, self._gait.frequency / 2.0
        bounce, roll, pitch, yaw, lateral = (
            _oscillation(t, envelope, amplitude, frequency, phase)
            for amplitude, frequency, phase in (
                (gait.bounce, full, 0.0),
                (np.radians(gait.roll_deg), half, 0.7),
                (np.radians(gait.pitch_deg), full, 1.9),
                (np.radians(gait.yaw_deg), half, 2.6),
                (gait.lateral, half, 0.3),
            )
        )
        side, d_side, dd_side = _sideways(q[:, 3], dq[:, 3], ddq[:, 3])
        p, v, a = q[:, :3].copy(), dq[:, :3].copy(), ddq[:, :3].copy()
        for total, vertical in zip((p, v, a), bounce, strict=True):
            total[:, 2] += vertical
        b, db, ddb = (value[:, None] for value in lateral)
        p += b * side
        v += db * side + b * d_side
        a += ddb * side + 2.0 * db * d_side + b * dd_side
        angles = np.stack([roll[0], pitch[0], q[:, 3] + yaw[0]], axis=1)
        rates = np.stack([roll[1], pitch[1], dq[:, 3] + yaw[1]], axis=1)
        R, omega = so3.from_rpy(*angles.T), _body_rate(angles, rates)
        return SimulatedMotion(R_world_body=R, p_world=p, v_world=v, a_world=a, omega_body=omega)


def _sideways(yaw: Array, d_yaw: Array, dd_yaw: Array) -> tuple[Array, Array, Array]:
    """Return the unit vector to the left of the path and its first two derivatives by time."""
    zero = np.zeros_like(yaw)
    ahead = np.stack([np.cos(yaw), np.sin(yaw), zero], axis=1)
    left = np.stack([-np.sin(yaw), np.cos(yaw), zero], axis=1)
    d_yaw, dd_yaw = d_yaw[:, None], dd_yaw[:, None]
    return left, -d_yaw * ahead, -dd_yaw * ahead - d_yaw**2 * left


def _oscillation(
    t: Array, envelope: list[Array], amplitude: float, frequency: float, phase: float
) -> tuple[Array, Array, Array]:
    """Return a sinusoid under an envelope, and its first two derivatives by time; ``envelope`` comes with its own."""
    e, de, dde = envelope
    w = 2.0 * np.pi * frequency
    s, c = np.sin(w * t + phase), np.cos(w * t + phase)
    return (
        amplitude * e * s,
        amplitude * (de * s + e * w * c),
        amplitude * (dde * s + 2.0 * de * w * c - e * w**2 * s),
    )


def _body_rate(angles: Array, rates: Array) -> Array:
    """Body rate of ``R = Rz(yaw) Ry(pitch) Rx(roll)`` from the angles' own rates."""
    roll, pitch = angles[:, 0], angles[:, 1]
    d_roll, d_pitch, d_yaw = rates.T
    return np.stack(
        [
            d_roll - d_yaw * np.sin(pitch),
            d_pitch * np.cos(roll) + d_yaw * np.sin(roll) * np.cos(pitch),
            -d_pitch * np.sin(roll) + d_yaw * np.cos(roll) * np.cos(pitch),
        ],
        axis=1,
    )
