"""Wheels and legs in the graph: the way between two keyframes with a scale that is estimated, and slip that is told."""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np

from heliograph.arrays import Array, Mask, Stamps
from heliograph.chi_square import chi_square_quantile
from heliograph.config import RunConfig
from heliograph.data import Event, ImuNoise, Keyframe, WheelAccount, WheelSpeeds
from heliograph.factors import ScaledMotion
from heliograph.graph import ISAM2, Covariance, FactorGraph, Isotropic, Prior, Symbol, Values
from heliograph.imu import preintegrate
from heliograph.lie import se3, so3
from heliograph.slam.inertial_factors import seen_covariance
from heliograph.snapshots import Stateful

__all__ = ["WheelFactors"]

X, B, K = Symbol("X"), Symbol("B"), Symbol("K")
_WHITE = 0.1  # seconds over which the error of a speed is one
_LONGEST_NS = 300_000_000  # between two speeds; across a longer gap nothing is said
_OFF = 0.5  # share of steps that contradict the IMU from which the wheels themselves are in doubt
_LEAST_STEPS = 20


class WheelFactors(Stateful):
    """Holds a run's speeds and says what they tell of each step; without any it says nothing.

    Parameters
    ----------
    config : RunConfig
    """

    _STATE: ClassVar = {
        "steps": int,
        "slips": int,
        "_slipped_ns": [int],
        "_ratios": [float],
        "_told": {int: bool},
    }

    def __init__(self, config: RunConfig) -> None:
        self._config, self._imu = config.wheels, config.imu
        self._noise = ImuNoise(
            gyro=config.imu.gyro_noise, accel=config.imu.accel_noise,
            gyro_walk=config.imu.gyro_walk, accel_walk=config.imu.accel_walk,
        )  # fmt: skip
        self._gravity = np.array([0.0, 0.0, -config.imu.gravity])
        self._stamps: Stamps = np.zeros(0, dtype=np.int64)
        self._v: Array = np.zeros((0, 3))
        self._measured: Mask = np.zeros(3, dtype=bool)
        self._arm = np.array(config.wheels.lever_arm)
        self._turn = so3.from_rpy(0.0, 0.0, math.radians(config.wheels.yaw_deg))
        self._sigma: Array = np.zeros(3)
        self._gate = chi_square_quantile(config.wheels.slip_probability, 1)
        self.steps = self.slips = 0
        self._slipped_ns: list[int] = []
        self._ratios: list[float] = []
        self._told: dict[int, bool] = {}  # keyframe -> whether the step to it was the first that the wheels told of

    @property
    def in_use(self) -> bool:
        """Whether the graph holds a step by wheels."""
        return self.steps > self.slips

    def observe(self, speeds: WheelSpeeds) -> None:
        """Take speeds that follow those before."""
        if speeds.T_imu_vehicle is not None and not (self._config.yaw_deg or any(self._config.lever_arm)):
            self._turn, self._arm = speeds.T_imu_vehicle[:3, :3], speeds.T_imu_vehicle[:3, 3]
        v = np.where(np.isfinite(speeds.v_body), speeds.v_body, 0.0) @ self._turn.T
        self._sigma = np.asarray(speeds.sigma)
        self._stamps = np.concatenate([self._stamps, speeds.stamps_ns])
        self._v = np.concatenate([self._v, v])
        self._measured = np.asarray(np.isfinite(speeds.v_body).any(axis=0), dtype=bool)

    def step(self, before: Keyframe, keyframe: Keyframe, smoother: ISAM2) -> tuple[FactorGraph, Values]:
        """Return what the speeds tell of the step to a keyframe, and the scale where it is new.

        Parameters
        ----------
        before, keyframe : Keyframe
            The second one is not in the smoother yet.
        smoother : ISAM2
        """
        graph, values = FactorGraph(), Values()
        way = self._way(before, keyframe)
        if way is None or not len(keyframe.imu):
            return graph, values
        first = not self._told
        scale = 1.0 if first else float(np.asarray(smoother.estimate(K(0)))[0])
        noise = self._covariance(keyframe.stamp_ns - before.stamp_ns)
        self.steps += 1
        if self._slips(way, scale, noise, before, keyframe, smoother, first=first):
            self.slips += 1
            self._slipped_ns.append(keyframe.stamp_ns)
            return graph, values
        self._told[keyframe.index] = first
        return self.said(before, keyframe)

    def said(self, before: Keyframe, keyframe: Keyframe) -> tuple[FactorGraph, Values]:
        """Return what `step` told of a step, once more; nothing where it told nothing."""
        graph, values = FactorGraph(), Values()
        first = self._told.get(keyframe.index)
        way = None if first is None else self._way(before, keyframe)
        if way is None:
            return graph, values
        noise = self._covariance(keyframe.stamp_ns - before.stamp_ns)
        if first:
            values.insert(K(0), np.ones(1))
            graph.add(Prior(K(0), np.ones(1), Isotropic(self._config.scale_sigma)))
        graph.add(ScaledMotion(X(before.index), X(keyframe.index), K(0), way, Covariance(noise), lever_arm=self._arm))
        return graph, values

    def account(self, smoother: ISAM2) -> WheelAccount | None:
        """Return what became of the speeds; None where there were none."""
        if not len(self._stamps):
            return None
        scale, sigma = float("nan"), float("nan")
        if self.in_use:
            scale = float(np.asarray(smoother.estimate(K(0)))[0])
            sigma = math.sqrt(float(smoother.covariance(K(0))[0, 0]))
        return WheelAccount(
            speeds=len(self._stamps), steps=self.steps, slips=self.slips, scale=scale, scale_sigma=sigma
        )

    def events(self) -> tuple[Event, ...]:
        """Return what a user should know."""
        if len(self._stamps) and not self.steps:
            message = f"wheels: none of {len(self._stamps)} speeds lies within the run: check wheels.clock_offset"
            return (Event(code="wheel-clock", message=message, count=len(self._stamps)),)
        if self.steps >= _LEAST_STEPS and self.slips > _OFF * self.steps:
            ratio = float(np.median(self._ratios))
            message = (
                f"wheels: {self.slips} of {self.steps} steps contradict the IMU; the way is {ratio:.2f} times what the "
                "wheels say: check sign, unit and wheels.yaw_deg"
            )
            return (Event(code="wheel-contradiction", message=message, count=self.slips),)
        if self.slips:
            message = f"wheels: slip in {self.slips} of {self.steps} steps; they are left out"
            return (Event(code="wheel-slip", message=message, stamp_ns=self._slipped_ns[0], count=self.slips),)
        return ()

    def _way(self, before: Keyframe, keyframe: Keyframe) -> Array | None:
        """Return the way (3,) between two keyframes by the speeds, in the imu frame of the first; None: not covered."""
        first = int(np.searchsorted(self._stamps, before.stamp_ns, side="right"))
        last = int(np.searchsorted(self._stamps, keyframe.stamp_ns, side="left"))
        if first == 0 or last >= len(self._stamps):
            return None
        inside = slice(first - 1, last + 1)
        stamps, v = self._stamps[inside], self._v[inside]
        if int(np.diff(stamps).max(initial=0)) > _LONGEST_NS:
            return None
        times = np.unique(np.concatenate([[before.stamp_ns], stamps[1:-1], [keyframe.stamp_ns]]))
        speed = np.stack([np.interp(times, stamps, column) for column in v.T], axis=-1)
        share = (times - before.stamp_ns) / (keyframe.stamp_ns - before.stamp_ns)
        turn = so3.log(before.T_odom_imu[:3, :3].T @ keyframe.T_odom_imu[:3, :3])
        along = np.einsum("nij,nj->ni", so3.exp(share[:, None] * turn), speed)
        seconds = 1e-9 * np.diff(times)[:, None]
        return np.asarray((0.5 * seconds * (along[1:] + along[:-1])).sum(axis=0))

    def _covariance(self, duration_ns: int) -> Array:
        """Return the covariance (3, 3) of a way, imu axes."""
        seconds = 1e-9 * duration_ns
        speed = np.maximum(self._sigma, self._config.speed_sigma)  # what a driver says of itself only makes it worse
        sigma = np.where(self._measured, speed, self._config.lateral_sigma) * math.sqrt(seconds * min(_WHITE, seconds))
        return np.asarray(self._turn @ np.diag(sigma**2) @ self._turn.T)

    def _slips(
        self,
        way: Array,
        scale: float,
        noise: Array,
        before: Keyframe,
        keyframe: Keyframe,
        smoother: ISAM2,
        *,
        first: bool,
    ) -> bool:
        """Whether the way contradicts what state and IMU foresee, or what the LiDAR saw, along the way itself."""
        i = int(X(before.index))
        state, biases = smoother.estimate(i), np.asarray(smoother.estimate(B(before.index)))
        motion = preintegrate(
            keyframe.imu, before.stamp_ns, keyframe.stamp_ns, noise=self._noise, config=self._imu,
            gyro_bias=biases[:3], accel_bias=biases[3:],
        )  # fmt: skip
        ahead = motion.predict(state, biases[:3], biases[3:], self._gravity)
        R = state.rotation
        foreseen = R.T @ (np.asarray(ahead.position).reshape(3) - np.asarray(state.position).reshape(3))
        foreseen = foreseen + (R.T @ np.asarray(ahead.rotation).reshape(3, 3) - np.eye(3)) @ self._arm
        length = float(np.linalg.norm(way))
        if length < 1e-3:
            return bool(np.linalg.norm(foreseen) > 0.2)
        along, seconds = way / length, float(motion.duration_s[0])
        P = smoother.covariance(i)
        unsure = float(along @ (P[6:9, 6:9] * seconds**2 + motion.covariance[0, 3:6, 3:6] + noise) @ along)
        relative = self._config.scale_sigma if first else math.sqrt(float(smoother.covariance(K(0))[0, 0]))
        unsure += (relative * length) ** 2
        off = float(along @ foreseen) - scale * length
        seen = se3.inverse(before.T_odom_imu) @ keyframe.T_odom_imu
        stepped = seen[:3, 3] + (seen[:3, :3] - np.eye(3)) @ self._arm
        unseen = float(
            along @ (seen[:3, :3] @ seen_covariance(before, keyframe)[3:, 3:] @ seen[:3, :3].T + noise) @ along
        )
        apart = float(along @ stepped) - scale * length
        self._ratios.append(float(along @ stepped) / length)
        return off * off > self._gate * unsure or apart * apart > self._gate * (unseen + (relative * length) ** 2)
