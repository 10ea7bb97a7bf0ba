"""g2o's own wheel, g2opy: method gn, lm or dl, with the Eigen sparse Cholesky; its residual in space is its own."""

from __future__ import annotations

import sys
import time
from importlib.metadata import version
from typing import Any

import g2opy as g2o
import numpy as np
from files import read, run

GRAPH, METHOD = sys.argv[1], sys.argv[3]
data = read(GRAPH)
GROUP = "SE2" if data.dimension == 2 else "SE3"
ALGORITHM = {"gn": "GaussNewton", "lm": "Levenberg", "dl": "Dogleg"}[METHOD]
NAMES = [line.split()[1] for line in open(GRAPH) if line.startswith("VERTEX")]  # noqa: SIM115, PTH123


def solve() -> tuple[Any, float, int]:
    """Time the iterations, the first of which orders and lays out; loading the file is off the clock."""
    optimizer = g2o.SparseOptimizer()
    linear = getattr(g2o, f"LinearSolverEigen{GROUP}")()
    algorithm = getattr(g2o, f"OptimizationAlgorithm{ALGORITHM}")(getattr(g2o, f"BlockSolver{GROUP}")(linear))
    optimizer.set_algorithm(algorithm)
    optimizer.load(GRAPH)
    optimizer.vertex(int(NAMES[0])).set_fixed(True)
    stop = g2o.SparseOptimizerTerminateAction()
    stop.set_gain_threshold(1e-5) if hasattr(stop, "set_gain_threshold") else setattr(stop, "gain_threshold", 1e-5)
    optimizer.add_post_iteration_action(stop)
    began = time.perf_counter()
    optimizer.initialize_optimization()
    iterations = optimizer.optimize(100)
    seconds = time.perf_counter() - began
    return (optimizer, algorithm, linear, stop), seconds, iterations


def poses(solved: Any) -> np.ndarray:  # noqa: ANN401
    """Return homogeneous matrices."""
    estimates = [solved[0].vertex(int(name)).estimate() for name in NAMES]
    if GROUP == "SE3":
        return np.array([np.asarray(e.matrix()) for e in estimates])
    x, y, theta = np.array([e.vector() if hasattr(e, "vector") else e.to_vector() for e in estimates]).T
    out = np.tile(np.eye(3), (len(x), 1, 1))
    out[:, 0, 0] = out[:, 1, 1] = np.cos(theta)
    out[:, 1, 0], out[:, 0, 2], out[:, 1, 2] = np.sin(theta), x, y
    out[:, 0, 1] = -out[:, 1, 0]
    return out


run(solve, poses, version("g2opy"))
