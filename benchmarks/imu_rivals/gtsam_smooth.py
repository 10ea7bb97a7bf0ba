"""GTSAM on the task of `imu_gnss`: ``python gtsam_smooth.py TASK.npz OUT.npz``.

The same readings, fixes, noise and start. Batch: Levenberg-Marquardt; incremental: iSAM2 as in its own examples, one
update a fix, threshold 0.1 at every update.
"""

from __future__ import annotations

import json
import sys
import time
from importlib.metadata import version

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, V, X

task = dict(np.load(sys.argv[1]))
count, start = len(task["fixes"]), task["start"]
params = gtsam.PreintegrationCombinedParams(task["gravity"])
gyro_walk, accel_walk = task["walks"]
params.setBiasAccCovariance(accel_walk**2 * np.eye(3))
params.setBiasOmegaCovariance(gyro_walk**2 * np.eye(3))
params.setIntegrationCovariance(1e-12 * np.eye(3))


def integrated(k: int) -> gtsam.PreintegratedCombinedMeasurements:
    """Preintegrate the steps of one interval; where samples are held their noise is another."""
    motion = gtsam.PreintegratedCombinedMeasurements(params, gtsam.imuBias.ConstantBias())
    for i in range(task["first"][k], task["first"][k + 1]):
        params.setGyroscopeCovariance(task["gyro_var"][i] * np.eye(3))
        params.setAccelerometerCovariance(task["accel_var"][i] * np.eye(3))
        motion.integrateMeasurement(task["accel"][i], task["gyro"][i], task["dt"][i])
    return motion


def sigmas(values: np.ndarray) -> gtsam.noiseModel.Diagonal:
    return gtsam.noiseModel.Diagonal.Sigmas(np.asarray(values))


def piece(k: int) -> gtsam.NonlinearFactorGraph:
    """Return the factors that come with the k-th state."""
    graph = gtsam.NonlinearFactorGraph()
    if k == 0:
        bias_sigma = sigmas(np.roll(task["bias_sigma"], 3))
        graph.add(gtsam.PriorFactorPose3(X(0), pose(0), sigmas(task["start_sigma"][:6])))
        graph.add(gtsam.PriorFactorVector(V(0), start[0, :3, 4], sigmas(task["start_sigma"][6:])))
        graph.add(gtsam.PriorFactorConstantBias(B(0), gtsam.imuBias.ConstantBias(), bias_sigma))
    else:
        graph.add(gtsam.CombinedImuFactor(X(k - 1), V(k - 1), X(k), V(k), B(k - 1), B(k), motions[k - 1]))
    if task["used"][k]:
        graph.add(gtsam.GPSFactor(X(k), task["fixes"][k], sigmas(task["fix_sigma"])))
    return graph


def pose(k: int) -> gtsam.Pose3:
    return gtsam.Pose3(gtsam.Rot3(start[k, :3, :3]), start[k, :3, 3])


def insert(values: gtsam.Values, k: int, T: gtsam.Pose3, v: np.ndarray, bias: gtsam.imuBias.ConstantBias) -> None:
    values.insert(X(k), T)
    values.insert(V(k), v)
    values.insert(B(k), bias)


began = time.perf_counter()
motions = [integrated(k) for k in range(count - 1)]
integrate_s = time.perf_counter() - began
graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
for k in range(count):
    graph.push_back(piece(k))
    insert(values, k, pose(k), start[k, :3, 4], gtsam.imuBias.ConstantBias())
began = time.perf_counter()
optimizer = gtsam.LevenbergMarquardtOptimizer(graph, values)
batch = optimizer.optimize()
batch_s = time.perf_counter() - began

settings = gtsam.ISAM2Params()
settings.relinearizeSkip = 1
settings.setRelinearizeThreshold(0.1)
settings.setFactorization("QR")  # its default, Cholesky, finds the system indeterminate: the biases walk so little
smoother = gtsam.ISAM2(settings)
began = time.perf_counter()
for k in range(count):
    values = gtsam.Values()
    T, v, bias = pose(0), start[0, :3, 4], gtsam.imuBias.ConstantBias()
    if k:
        bias = smoother.calculateEstimateConstantBias(B(k - 1))
        state = gtsam.NavState(smoother.calculateEstimatePose3(X(k - 1)), smoother.calculateEstimateVector(V(k - 1)))
        state = motions[k - 1].predict(state, bias)
        T, v = state.pose(), state.velocity()
    insert(values, k, T, v, bias)
    smoother.update(piece(k), values)
online_s = time.perf_counter() - began
last = smoother.calculateEstimate()
np.savez(
    sys.argv[2],
    batch=[batch.atPose3(X(k)).translation() for k in range(count)],
    incremental=[last.atPose3(X(k)).translation() for k in range(count)],
)
account = {
    "version": version("gtsam"),
    "chi2": 2.0 * graph.error(batch),
    "integrate_s": integrate_s,
    "batch_s": batch_s,
    "incremental_s": online_s,
}
print(json.dumps(account))
