"""Heliograph: method gn, lm or dogleg, from the values in the file; with `auto` from a better start if it finds one."""

from __future__ import annotations

import resource
import sys
from importlib.metadata import version

import numpy as np
from files import run

from heliograph.graph import Solution, read_pose_graph
from heliograph.graph import solve as minimise
from heliograph.lie import SE2, SE3

BASE_MB = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0  # of Python, NumPy and the module alone
file = read_pose_graph(sys.argv[1])
graph, values = file.graph(), file.values()
initial = "auto" if "auto" in sys.argv[4:] else "given"


def solve() -> tuple[Solution, float, int]:
    """Take the time of its own account, which leaves out construction, as the clocks of the others do."""
    solution = minimise(graph, values, sys.argv[3], initial=initial, threads=1)
    return solution, solution.seconds["total"], solution.iterations


def poses(solution: Solution) -> np.ndarray:
    """Return homogeneous matrices."""
    return np.asarray(solution.values.block(SE2 if file.dimension == 2 else SE3)[1].matrix)


print(f"base {BASE_MB:.1f} MB", file=sys.stderr)
run(solve, poses, version("heliograph"))
