"""Factor graphs from the textbook to a factor of one's own: python examples/factor_graph.py."""

import numpy as np

from heliograph.arrays import Array
from heliograph.graph import Between, Diagonal, Factor, FactorGraph, Isotropic, Marginals, Prior, Values, solve
from heliograph.lie import SE2


def two_places() -> None:
    """Share a metre that does not fit among a prior, a step of 10 m and a place measured at 11 m."""
    graph, values = FactorGraph(), Values()
    values.insert([0, 1], [[0.0], [10.0]])
    graph.add(Prior(0, [0.0], Isotropic(1.0)))
    graph.add(Between(0, 1, [10.0], Isotropic(1.0)))
    graph.add(Prior(1, [11.0], Isotropic(2.0)))
    solution = solve(graph, values)
    for key, sigma in enumerate(np.sqrt(Marginals(graph, solution.values).covariance([0, 1])[:, 0, 0])):
        print(f"x{key} = {solution.values.at(key)[0]:.3f} +- {sigma:.3f} m")


class Beacon(Factor):
    """The distance from a pose to a known beacon; its derivatives are found by themselves."""

    variables = (SE2,)
    rows = 1

    @staticmethod
    def residual(T_world_i: Array, beacon_world: Array, distance: Array) -> Array:
        return np.linalg.norm(T_world_i[:, :2, 2] - beacon_world, axis=1, keepdims=True) - distance[:, None]


def closed_loop(n: int = 100, drift: float = 2.0) -> None:
    """Walk a circle with a drift of 2 m: once the end is known to be the start, every pose gives in a little."""
    turn = 2.0 * np.pi / n
    truth = SE2.exp(np.arange(n + 1)[:, None] * np.array([turn, 1.0, 0.0]))
    drifted = truth.matrix.copy()
    drifted[:, 0, 2] += drift * np.arange(n + 1) / n
    odometry = SE2(drifted)
    graph, values = FactorGraph(), Values()
    values.insert(np.arange(n + 1), odometry)
    step = odometry[:-1].inverse() @ odometry[1:]
    graph.add(Between(np.arange(n), np.arange(n) + 1, step, Diagonal([1e-4, 0.05, 0.05])))
    graph.fix(0)
    graph.add(Between(n, 0, SE2.identity(), Diagonal([1e-4, 0.001, 0.001])))
    beacon, seen = np.tile([0.0, 40.0], (5, 1)), np.arange(0, n + 1, 25)
    distance = np.linalg.norm(truth.matrix[seen, :2, 2] - beacon, axis=1)
    graph.add(Beacon(seen, data=(beacon, distance), noise=Isotropic(0.5)))
    solution = solve(graph, values)
    moved = np.diff((solution.values.block(SE2)[1].matrix - drifted)[:, :2, 2], axis=0)
    print(f"chi2 {solution.initial_chi2:.4g} -> {solution.chi2:.4g} in {solution.iterations} steps ({solution.start})")
    print(f"every pose gives in by {np.linalg.norm(moved, axis=1).mean():.3f} m of the {drift:.1f} m")


if __name__ == "__main__":
    two_places()
    closed_loop()
