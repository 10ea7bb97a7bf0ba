"""Heliograph's iSAM2, one pose at a time with all its factors: `skip`, and after `limit` seconds it ends.

Two more numbers, if given, bound an update's work: `max_steps` and `max_relinearized`.
"""

from __future__ import annotations

import gc
import sys
import time
from importlib.metadata import version

import numpy as np
from replays import report_replay

from heliograph.graph import ISAM2, ISAM2Settings, read_pose_graph
from heliograph.graph.incremental.replay import replay, replay_steps

LIMIT = float(sys.argv[4])
file = read_pose_graph(sys.argv[1])
count = len(file.pose_ids)
steps = replay_steps(file.graph(), file.odometry_values())
bounds = dict(zip(("max_steps", "max_relinearized"), map(int, sys.argv[5:]), strict=False))
smoother = ISAM2(ISAM2Settings(relinearize_skip=int(sys.argv[3]), **bounds))
bytes_a_pose = []
if count <= 100_000:
    steps = list(steps)
    gc.collect()
gc.freeze()  # what was read is no garbage to look through


def observer(number: int, _: object) -> bool:
    """Note the memory ten times, and end the run when its time is over."""
    if (number + 1) % max(count // 10, 1) == 0:
        bytes_a_pose.append(round(smoother.bytes / (number + 1), 1))
    return time.perf_counter() - began < LIMIT


began = time.perf_counter()
done = replay(steps, smoother, observer=observer)
poses = np.asarray(smoother.estimate(file.pose_ids).matrix) if len(done.seconds) == count else None
more = {"fault": None, "deciles_bytes_a_pose": bytes_a_pose}
report_replay(done.seconds, done.reeliminated, poses, version("heliograph"), more)
