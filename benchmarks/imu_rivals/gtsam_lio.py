"""GTSAM on a task of `lio`: ``python gtsam_lio.py TASK.npz``; iSAM2 as in its own examples, threshold 0.1."""

import sys
import time
from importlib.metadata import version
from itertools import pairwise

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, V, X
from lio_account import report

task, none = dict(np.load(sys.argv[1])), gtsam.imuBias.ConstantBias()
start, first = task["start"], task["first"]
params = gtsam.PreintegrationCombinedParams(task["gravity"])
params.setBiasOmegaCovariance(task["noise"][2] ** 2 * np.eye(3))
params.setBiasAccCovariance(task["noise"][3] ** 2 * np.eye(3))
params.setIntegrationCovariance(1e-12 * np.eye(3))
motions = []
for a, b in pairwise(first):
    motions.append(gtsam.PreintegratedCombinedMeasurements(params, none))
    for i in range(a, b):
        params.setGyroscopeCovariance(task["gyro_var"][i] * np.eye(3))
        params.setAccelerometerCovariance(task["accel_var"][i] * np.eye(3))
        motions[-1].integrateMeasurement(task["accel"][i], task["gyro"][i], task["dt"][i])
sigmas = gtsam.noiseModel.Diagonal.Sigmas
step, fix = sigmas(task["step_sigma"]), sigmas(task["fix_sigma"])
robust = gtsam.noiseModel.Robust.Create(gtsam.noiseModel.mEstimator.Cauchy.Create(1.0), step)
steps, fixes = [gtsam.Pose3(Z) for Z in task["steps"]], dict(zip(task["fixed"].tolist(), task["fixes"], strict=True))
loops = {int(k): (int(i), gtsam.Pose3(Z)) for (i, k), Z in zip(task["loops"], task["closed"], strict=True)}
settings = gtsam.ISAM2Params()
settings.relinearizeSkip = 1
settings.setRelinearizeThreshold(0.1)
smoother, updates, began = gtsam.ISAM2(settings), [], time.process_time()
for k in range(len(first)):
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    if k == 0:
        T, v, bias, sigma = gtsam.Pose3(start[:4, :4]), start[:3, 4], none, task["start_sigma"]
        graph.add(gtsam.PriorFactorPose3(X(0), T, sigmas(sigma[:6])))
        graph.add(gtsam.PriorFactorVector(V(0), v, sigmas(sigma[6:])))
        graph.add(gtsam.PriorFactorConstantBias(B(0), none, sigmas(np.roll(task["bias_sigma"], 3))))
    else:
        bias, m = smoother.calculateEstimateConstantBias(B(k - 1)), motions[k - 1]
        before = smoother.calculateEstimatePose3(X(k - 1)), smoother.calculateEstimateVector(V(k - 1))
        state = m.predict(gtsam.NavState(*before), bias)
        T, v = state.pose(), state.velocity()
        graph.add(gtsam.CombinedImuFactor(X(k - 1), V(k - 1), X(k), V(k), B(k - 1), B(k), m))
        graph.push_back(gtsam.BetweenFactorPose3(X(k - 1), X(k), steps[k - 1], step)) if steps else None
        graph.push_back(gtsam.BetweenFactorPose3(X(loops[k][0]), X(k), loops[k][1], robust)) if k in loops else None
    graph.push_back(gtsam.GPSFactorArm(X(k), fixes[k], task["arm"], fix)) if k in fixes else None
    values.insert(X(k), T), values.insert(V(k), v), values.insert(B(k), bias)
    at = time.process_time()
    smoother.update(graph, values)
    updates.append(time.process_time() - at)
total, covariances = time.process_time() - began, []
for k in range(len(first) - 20, len(first)):
    at = time.process_time()
    smoother.marginalCovariance(X(k))
    covariances.append(time.process_time() - at)
error = np.array([smoother.calculateEstimatePose3(X(k)).translation() for k in range(len(first))]) - task["truth"]
report(total, updates, covariances, error, version=version("gtsam"))
