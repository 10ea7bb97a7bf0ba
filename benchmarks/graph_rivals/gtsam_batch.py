"""GTSAM: method gn or lm, linear solver MULTIFRONTAL_CHOLESKY or SEQUENTIAL_CHOLESKY, ordering COLAMD or METIS."""

from __future__ import annotations

import sys
import time
from importlib.metadata import version
from typing import Any

import gtsam
import numpy as np
from files import read, rotations, run

GRAPH, METHOD, LINEAR, ORDERING = sys.argv[1], *sys.argv[3:6]
ROTATION_FIRST = np.ix_([3, 4, 5, 0, 1, 2], [3, 4, 5, 0, 1, 2])
data = read(GRAPH)
PLANE = data.dimension == 2
Pose = gtsam.Pose2 if PLANE else gtsam.Pose3


def make(rows: np.ndarray) -> list[Any]:
    """Return poses of rows as the file has them."""
    if PLANE:
        return [gtsam.Pose2(*row) for row in rows]
    return [gtsam.Pose3(gtsam.Rot3(R), t) for R, t in zip(rotations(rows[:, 3:]), rows[:, :3], strict=True)]


graph, start = gtsam.NonlinearFactorGraph(), gtsam.Values()
for k, pose in enumerate(make(data.vertices)):
    start.insert(k, pose)
between = gtsam.BetweenFactorPose2 if PLANE else gtsam.BetweenFactorPose3
for i, j, pose, omega in zip(data.i, data.j, make(data.relative), data.information, strict=True):
    noise = gtsam.noiseModel.Gaussian.Information(omega if PLANE else omega[ROTATION_FIRST])
    graph.add(between(int(i), int(j), pose, noise))
# The gauge: a prior at the start of pose 0, which is zero at the optimum.
prior = gtsam.PriorFactorPose2 if PLANE else gtsam.PriorFactorPose3
graph.add(prior(0, make(data.vertices[:1])[0], gtsam.noiseModel.Isotropic.Sigma(3 if PLANE else 6, 1e-3)))


def solve() -> tuple[Any, float, int]:
    """Time the optimiser's constructor, which orders and lays out, and its iterations."""
    names = {"gn": "GaussNewton", "lm": "LevenbergMarquardt"}
    settings = getattr(gtsam, f"{names[METHOD]}Params")()
    settings.setLinearSolverType(LINEAR)
    settings.setOrderingType(ORDERING)
    settings.setMaxIterations(100)
    settings.setRelativeErrorTol(1e-5)
    settings.setAbsoluteErrorTol(0.0)
    began = time.perf_counter()
    optimizer = getattr(gtsam, f"{names[METHOD]}Optimizer")(graph, start, settings)
    result = optimizer.optimize()
    return result, time.perf_counter() - began, optimizer.iterations()


at = "atPose2" if PLANE else "atPose3"
run(solve, lambda v: np.array([getattr(v, at)(k).matrix() for k in range(len(data.vertices))]), version("gtsam"))
