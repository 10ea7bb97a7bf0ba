"""What was said of each step between keyframes: said again from the store when asked for, not held."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import chain, pairwise
from typing import ClassVar

import numpy as np

from heliograph.arrays import Array
from heliograph.config import RunConfig
from heliograph.data import Keyframe
from heliograph.graph import FactorGraph
from heliograph.graph.model.records import FactorRecord
from heliograph.slam.inertial_factors import InertialFactors
from heliograph.slam.past_steps import PastSteps
from heliograph.slam.pose_factors import PoseFactors
from heliograph.slam.wheels import WheelFactors
from heliograph.snapshots import Stateful, array

__all__ = ["StepLog", "factors_for"]


def factors_for(first: Keyframe, config: RunConfig) -> InertialFactors | PoseFactors:
    """Return what is said of the steps of a run that begins with a keyframe: with an IMU, or without."""
    inertial = len(first.imu) > 0 and bool(np.linalg.norm(first.g_odom) > 0.0)
    return InertialFactors(config.slam, config.imu) if inertial else PoseFactors()


class StepLog(Stateful):
    """The factors of a run's steps, in their order.

    Nearly all of them follow from the keyframes, which are on disk: nothing of those is kept in memory. What else one
    leans on is kept: where the map had a keyframe whose velocity nothing measures.

    Parameters
    ----------
    config : RunConfig
    wheels : WheelFactors
        Knows which steps its speeds speak of.
    """

    _STATE: ClassVar = {"_leaning": {int: array(np.float64, 4, 4)}}

    def __init__(self, config: RunConfig, wheels: WheelFactors) -> None:
        self._config, self._wheels = config, wheels
        self._leaning: dict[int, Array] = {}  # keyframe -> pose in the map of the one before it, as the step had it

    def note(self, keyframe: Keyframe, T_map_before: Array) -> None:
        """Take note of a step that was made with the keyframe before at a pose (4, 4)."""
        if len(keyframe.imu) == 0:
            self._leaning[keyframe.index] = np.array(T_map_before)

    def graph(self, keyframes: Iterable[Keyframe], past: PastSteps | None = None) -> FactorGraph:
        """Return the factors of all steps between keyframes, which are read one after the other.

        Parameters
        ----------
        keyframes : iterable of Keyframe
        past : PastSteps, optional
            The first steps, which were summarised.
        """
        whole = FactorGraph()
        for added in self._said(iter(keyframes), past):
            for group in added.groups():
                whole.adopt(group)
            whole.fix(added.fixed)
        return whole

    def _said(self, keyframes: Iterator[Keyframe], past: PastSteps | None) -> Iterator[FactorGraph]:
        first = next(keyframes, None)
        if first is None:
            return
        factors = factors_for(first, self._config)
        yield without_bias(factors.first(first)[0]) if past is not None and len(past) else factors.first(first)[0]
        for before, keyframe in pairwise(chain([first], keyframes)):
            if past is not None and before.index < len(past):
                yield _graph_of(past.step(before.index), past.speed(before.index))
                if keyframe.index == len(past):
                    yield _graph_of(past.biases())
                yield self._wheels.said(before, keyframe)[0]
                continue
            T_map_before = self._leaning.get(keyframe.index, before.T_odom_imu)
            yield factors.step(before, keyframe, T_map_before)[0]
            yield self._wheels.said(before, keyframe)[0]


def without_bias(first: FactorGraph) -> FactorGraph:
    """Return what is said of a first keyframe but for its biases, which have left: the last of its factors."""
    graph = FactorGraph()
    for added in first.groups()[:-1]:
        graph.adopt(added)
    return graph


def _graph_of(*records: FactorRecord) -> FactorGraph:
    graph = FactorGraph()
    for record in records:
        graph.add(record)
    return graph
