"""The law of registrations of two clouds."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from heliograph.lie import se3
from heliograph.registration import AlignResult
from heliograph.testing.local_maps import Walls

__all__ = ["assert_alignment"]

Array = NDArray[np.float64]


def assert_alignment(
    align: Callable[..., AlignResult], rng: np.random.Generator, *, distance: float = 0.02, angle: float = 0.01
) -> None:
    """Assert that a registration finds the pose of two clouds of a corner, moves with their frames, and admits defeat.

    Parameters
    ----------
    align : callable
        Align of a target and a source (N, 3) float32, and ``start``.
    rng : numpy.random.Generator
        Draws clouds and motions.
    distance, angle : float
        Largest error [m], [rad] with 4800 points a wall and 1 cm of noise.
    """
    walls = Walls(rng)
    walls.centre = np.zeros(3)
    clouds = [walls.points(rng, 4800, 0.0) + 0.01 * rng.normal(size=(14400, 3)) for _ in range(2)]
    truth = se3.exp(np.concatenate([rng.uniform(-0.08, 0.08, 3), rng.uniform(-0.25, 0.25, 3)]))
    target = clouds[0].astype(np.float32)
    source = se3.act(se3.inverse(truth), clouds[1]).astype(np.float32)
    moved = se3.exp(rng.normal(size=6))
    elsewhere = se3.act(moved, clouds[0]).astype(np.float32)
    shuffled = np.concatenate([rng.permutation(source), np.full((9, 3), np.nan, dtype=np.float32)])
    cases = (
        ("the pose", align(target, source), truth),
        ("the pose of shuffled points with NaN among them", align(target, shuffled), truth),
        ("the pose the other way round", align(source, target), se3.inverse(truth)),
        ("the pose in a moved frame", align(elsewhere, source, start=moved), moved @ truth),
    )
    for case, result, wanted in cases:
        assert result.T_target_source is not None, f"{case}: {result.status}, {result.reason}"
        error = se3.log(se3.inverse(wanted) @ result.T_target_source)
        assert np.linalg.norm(error[3:]) <= distance, f"{case} is off by {np.linalg.norm(error[3:]):.3f} m"
        assert np.linalg.norm(error[:3]) <= angle, f"{case} is off by {np.linalg.norm(error[:3]):.4f} rad"
        assert result.covariance is not None, f"{case} has no covariance"
        assert np.linalg.eigvalsh(result.covariance).min() > 0.0, f"{case} has a covariance that is not positive"
    away = np.eye(4)
    away[0, 3] = 1e3
    assert align(target, source, start=away).T_target_source is None, "clouds that do not overlap have a pose"
