"""GTSAM's preintegration from Python: ``python gtsam_preintegrate.py SAMPLES.npz RUNS``; microseconds a sample.

Its wheel has no call for a batch: samples are handed over one by one, here from ready-made rows.
"""

from __future__ import annotations

import json
import statistics
import sys
import time
from importlib.metadata import version
from typing import Any

import gtsam
import numpy as np

data, runs = dict(np.load(sys.argv[1])), int(sys.argv[2])
gyro, accel, dt = list(data["gyro"]), list(data["accel"]), float(data["dt"])


def configured(cls: Any) -> Any:  # noqa: ANN401
    params = cls.MakeSharedU(9.81)
    params.setGyroscopeCovariance(float(data["gyro_noise"]) ** 2 * np.eye(3))
    params.setAccelerometerCovariance(float(data["accel_noise"]) ** 2 * np.eye(3))
    params.setIntegrationCovariance(1e-10 * np.eye(3))
    return params


def timed(kind: Any, params: Any) -> float:  # noqa: ANN401
    times = []
    for _ in range(runs):
        motion = kind(params, gtsam.imuBias.ConstantBias())
        integrate = motion.integrateMeasurement
        began = time.perf_counter()
        for rate, force in zip(gyro, accel, strict=True):
            integrate(force, rate, dt)
        times.append(1e6 * (time.perf_counter() - began) / len(gyro))
    return statistics.median(times)


account = {
    "version": version("gtsam"),
    "plain_us": timed(gtsam.PreintegratedImuMeasurements, configured(gtsam.PreintegrationParams)),
    "combined_us": timed(gtsam.PreintegratedCombinedMeasurements, configured(gtsam.PreintegrationCombinedParams)),
}
print(json.dumps(account))
