"""Poses of another system against the clouds: the clouds must move as the poses say."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from heliograph.arrays import Array
from heliograph.config import LoopConfig
from heliograph.data import Keyframe
from heliograph.lie import se3
from heliograph.registration import align
from heliograph.slam.loops import diagonal, gate_of, loop_align_config
from heliograph.snapshots import Snapshot, require

__all__ = ["GivenPoses"]

_COUNTS = ("steps", "registered", "contradicted")
_EVERY = 4  # steps from one that is registered to the next, after the first ones: an account needs no more
_PROBABILITY = 0.999
_CONTRADICTED = 1.0 / 3.0  # share of the registered steps from which the poses are not believed
_LEAST = 5  # registered steps that a judgement needs


class NumberedKeyframes(Protocol):
    """Keyframes by their numbers, such as a store of them."""

    def __getitem__(self, index: int, /) -> Keyframe:
        """Return one."""
        ...


class GivenPoses:
    """Registers every fourth step of given poses, keyframe to keyframe, and counts those that the clouds contradict.

    A step is contradicted where its registration ends elsewhere than the drift that the poses are credited with allows
    (`SlamConfig.pose_position_sigma`, `SlamConfig.pose_rotation_sigma_deg`). One that finds no pose says nothing.

    Parameters
    ----------
    config : LoopConfig
        How clouds are registered, and what a registration is credited with.
    """

    def __init__(self, config: LoopConfig) -> None:
        self._settings = loop_align_config(config)
        self._floor = diagonal(config.slack_deg, config.slack)
        self._before: Keyframe | None = None
        self.steps = self.registered = self.contradicted = 0

    def add(self, keyframe: Keyframe) -> None:
        """Take the next keyframe."""
        before, self._before = self._before, keyframe
        if before is None or (self.steps >= _LEAST and keyframe.index % _EVERY):
            return
        step = np.ascontiguousarray(se3.inverse(before.T_odom_imu) @ keyframe.T_odom_imu)
        self.steps += 1
        found = align(before.points_imu, keyframe.points_imu, start=step, config=self._settings)
        if found.status != "converged" or found.T_target_source is None or found.covariance is None:
            return
        self.registered += 1
        self.contradicted += _off(
            step, found.T_target_source, keyframe.step_covariance + found.covariance + self._floor
        )

    def snapshot(self) -> Snapshot:
        """Return the counts and the number of the last keyframe."""
        before = None if self._before is None else self._before.index
        return {"before": before, **{name: int(getattr(self, name)) for name in _COUNTS}}

    def restored(self, snapshot: Snapshot, keyframes: NumberedKeyframes) -> None:
        """Take up the state of another one, whose keyframes are these."""
        require(self, snapshot, {"before": (int, None), **dict.fromkeys(_COUNTS, int)})
        before = snapshot["before"]
        self._before = None if before is None else keyframes[before]
        self.steps, self.registered, self.contradicted = (snapshot[name] for name in _COUNTS)

    @property
    def doubts(self) -> tuple[str, ...]:
        """Why the poses are not to be trusted, one sentence, or nothing."""
        if self.registered < _LEAST:
            return (
                f"the clouds could not be compared with the poses of the file: of {self.steps} steps that were "
                f"registered {self.registered} found a pose",
            )
        if self.contradicted > _CONTRADICTED * self.registered:
            return (
                f"the clouds contradict the poses of the file in {self.contradicted} of {self.registered} steps: check "
                "that both are of one recording, their stamps, and whether the poses are the IMU's",
            )
        return ()


def _off(T: Array, found: Array, covariance: Array) -> bool:
    d = se3.local(T, found)
    return bool(d @ np.linalg.solve(covariance, d) > gate_of(_PROBABILITY))
