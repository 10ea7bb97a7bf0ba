"""GTSAM's iSAM2, one pose at a time with all its factors, relinearised every `skip` updates, for `limit` s."""

from __future__ import annotations

import sys
import time
from importlib.metadata import version

import gtsam
import numpy as np
from files import read, rotations
from replays import report_replay

SKIP, LIMIT = int(sys.argv[3]), float(sys.argv[4])
ROTATION_FIRST = np.ix_([3, 4, 5, 0, 1, 2], [3, 4, 5, 0, 1, 2])
data = read(sys.argv[1])
PLANE, count = data.dimension == 2, len(data.vertices)
if PLANE:
    relative = [gtsam.Pose2(*row) for row in data.relative]
else:
    R = rotations(data.relative[:, 3:])
    relative = [gtsam.Pose3(gtsam.Rot3(a), t) for a, t in zip(R, data.relative[:, :3], strict=True)]
    data.information = np.array([omega[ROTATION_FIRST] for omega in data.information])
between = gtsam.BetweenFactorPose2 if PLANE else gtsam.BetweenFactorPose3
graphs = [gtsam.NonlinearFactorGraph() for _ in range(count)]
origin = [-1] * count  # the pose that each starts from: the one before it, else that of its first edge
step = [gtsam.Pose2() if PLANE else gtsam.Pose3()] * count
for i, j, T, omega in zip(data.i.tolist(), data.j.tolist(), relative, data.information, strict=True):
    first, last = min(i, j), max(i, j)
    graphs[last].add(between(i, j, T, gtsam.noiseModel.Gaussian.Information(omega)))
    if origin[last] < 0 or (first == last - 1 and origin[last] != first):
        origin[last], step[last] = first, T if i == first else T.inverse()
prior = gtsam.PriorFactorPose2 if PLANE else gtsam.PriorFactorPose3
graphs[0].add(prior(0, step[0], gtsam.noiseModel.Isotropic.Sigma(3 if PLANE else 6, 1e-3)))

settings = gtsam.ISAM2Params()
settings.relinearizeSkip = SKIP
settings.setRelinearizeThreshold(0.1)
settings.setOptimizationParams(gtsam.ISAM2GaussNewtonParams(1e-3))
smoother = gtsam.ISAM2(settings)
estimate = smoother.calculateEstimatePose2 if PLANE else smoother.calculateEstimatePose3
seconds, reeliminated, fault = [], [], None
for k in range(count):
    began = time.perf_counter()
    start = estimate(origin[k]) if k else None
    took = time.perf_counter() - began
    values = gtsam.Values()
    values.insert(k, start.compose(step[k]) if k else step[0])
    try:
        began = time.perf_counter()
        result = smoother.update(graphs[k], values)
    except RuntimeError as error:
        fault = f"aborts at pose {k}: {str(error).strip().splitlines()[0]}"
        break
    seconds.append(time.perf_counter() - began + took)
    reeliminated.append(result.getVariablesReeliminated())
    if sum(seconds) > LIMIT:
        break
poses = np.array([estimate(k).matrix() for k in range(count)]) if len(seconds) == count else None
report_replay(seconds, reeliminated, poses, version("gtsam"), {"fault": fault})
