"""Poses of another system: those of the clouds are believed, those of another time or place are not."""

from dataclasses import replace

import numpy as np
import pytest
from tests.slam_worlds import drifting_walk

from heliograph.config import LoopConfig
from heliograph.lie import se3
from heliograph.slam.given_poses import GivenPoses


@pytest.fixture(scope="module")
def walk():
    return drifting_walk(laps=0.45)


def judged(keyframes):
    given = GivenPoses(LoopConfig())
    for keyframe in keyframes:
        given.add(keyframe)
    return given


def with_poses(keyframes, T):
    return [replace(k, T_odom_imu=np.ascontiguousarray(pose)) for k, pose in zip(keyframes, T, strict=False)]


def test_poses_of_the_clouds_are_believed(walk):
    given = judged(walk.keyframes)
    assert given.doubts == () and given.registered >= 5 and given.contradicted <= 1


def test_poses_of_another_time_are_not(walk):
    """The same way four keyframes later: the course bends, and the steps with it."""
    later = [keyframe.T_odom_imu for keyframe in walk.keyframes[4:]]
    turned = [T @ se3.exp(np.array([0.0, 0.0, 0.15 * k, 0.0, 0.0, 0.0])) for k, T in enumerate(later)]
    for poses in (turned, later[::-1]):
        (doubt,) = judged(with_poses(walk.keyframes, poses)).doubts
        assert "contradict" in doubt and "steps" in doubt


def test_too_few_steps_are_said(walk):
    (doubt,) = judged(walk.keyframes[:3]).doubts
    assert "could not be compared" in doubt and "2 steps" in doubt
