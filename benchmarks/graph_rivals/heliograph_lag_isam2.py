"""Heliograph's fixed-lag smoother over a drive: `lag` poses are kept; loops to what has left are passed over."""

from __future__ import annotations

import resource
import sys
import time
from importlib.metadata import version

import numpy as np
from files import read
from replays import report_replay

from heliograph.graph import Between, FactorGraph, Information, Values
from heliograph.graph.incremental.fixed_lag import FixedLagSmoother
from heliograph.lie import SE2, so2

LAG = int(sys.argv[3])
data = read(sys.argv[1])
count = len(data.vertices)
relative = SE2.from_rotation_translation(so2.exp(data.relative[:, 2:]), data.relative[:, :2])
noise = Information(np.roll(data.information[0], (1, 1), axis=(0, 1)))  # the file has the rotation last
order = np.argsort(np.maximum(data.i, data.j), kind="stable")
ends = np.searchsorted(np.maximum(data.i, data.j)[order], np.arange(count + 1))
smoother = FixedLagSmoother(LAG)
seconds, reeliminated, held, peak = [], [], [], []
for k in range(count):
    graph, values = FactorGraph(), Values()
    near = [e for e in order[ends[k] : ends[k + 1]].tolist() if abs(data.i[e] - data.j[e]) < LAG]
    for e in near:
        graph.add(Between(data.i[e], data.j[e], relative[e], noise))
    began = time.perf_counter()
    start = smoother.estimate(k - 1) if k else None
    took = time.perf_counter() - began
    values.insert(k, SE2.identity() if start is None else start @ relative[near[0]])
    if k == 0:
        graph.fix(0)
    began = time.perf_counter()
    result = smoother.update(graph, values, {k: float(k)})
    seconds.append(time.perf_counter() - began + took)
    reeliminated.append(result.reeliminated)
    if (k + 1) % max(count // 10, 1) == 0:
        held.append(round(smoother.bytes / min(LAG, k + 1), 1))
        peak.append(round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0, 1))
more = {"fault": None, "deciles_bytes_a_pose": held, "deciles_peak_mb": peak}
report_replay(seconds, reeliminated, None, version("heliograph"), more)
