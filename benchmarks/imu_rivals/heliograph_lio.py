"""Heliograph on a task of `lio`: ``python heliograph_lio.py TASK.npz``."""

import sys
import time
from itertools import pairwise

import numpy as np
from lio_account import report

from benchmarks.imu_drive import CONFIG
from heliograph.data import ImuBatch, ImuNoise
from heliograph.factors import CombinedImu, LeverArmPosition, Velocity
from heliograph.graph import ISAM2, Between, Cauchy, Diagonal, FactorGraph, Prior, Values
from heliograph.imu import preintegrate
from heliograph.lie import SE3, ExtendedPose

task = dict(np.load(sys.argv[1]))
imu = ImuBatch(stamps_ns=task["imu_stamps"], gyro=task["imu_gyro"], accel=task["imu_accel"], received_ns=0)
noise = ImuNoise(**dict(zip(("gyro", "accel", "gyro_walk", "accel_walk"), task["noise"].tolist(), strict=True)))
stamps, down, start = task["stamps"], task["gravity"], task["start"]
motions = [preintegrate(imu, a, b, noise=noise, config=CONFIG) for a, b in pairwise(stamps)]
step, fix, robust = Diagonal(task["step_sigma"]), Diagonal(task["fix_sigma"]), Cauchy(1.0)
steps = [SE3(Z) for Z in task["steps"]]
loops = {int(k): (int(i), SE3(Z)) for (i, k), Z in zip(task["loops"], task["closed"], strict=True)}
fixes = dict(zip(task["fixed"].tolist(), task["fixes"], strict=True))
BIAS, smoother, updates, covariances = 10**6, ISAM2(), [], []
began = time.process_time()
for k in range(len(stamps)):
    graph, values = FactorGraph(), Values()
    if k == 0:
        X, bias, sigma = ExtendedPose(start), np.zeros(6), task["start_sigma"]
        graph.add(Prior(0, SE3(start[:4, :4]), Diagonal(sigma[:6])))
        graph.add(Velocity(0, start[:3, 4], Diagonal(sigma[6:])))
        graph.add(Prior(BIAS, bias, Diagonal(task["bias_sigma"])))
    else:
        bias = smoother.estimate(BIAS + k - 1)
        X = motions[k - 1].predict(smoother.estimate(k - 1), bias[:3], bias[3:], down)[0]
        graph.add(CombinedImu(k - 1, BIAS + k - 1, k, BIAS + k, motions[k - 1], gravity=down))
        if steps:
            graph.add(Between(k - 1, k, steps[k - 1], step))
        if k in loops:
            graph.add(Between(loops[k][0], k, loops[k][1], step, kernel=robust))
    if k in fixes:
        graph.add(LeverArmPosition(k, fixes[k], fix, lever_arm=task["arm"]))
    values.insert(k, X)
    values.insert(BIAS + k, bias)
    at = time.process_time()
    smoother.update(graph, values)
    updates.append(time.process_time() - at)
total = time.process_time() - began
for k in range(len(stamps) - 20, len(stamps)):
    at = time.process_time()
    smoother.covariance(k)
    covariances.append(time.process_time() - at)
error = smoother.estimate(np.arange(len(stamps))).position - task["truth"]
report(total, updates, covariances, error)
