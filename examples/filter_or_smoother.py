"""A filter and a smoother are the same until a loop closes: python examples/filter_or_smoother.py."""

import numpy as np

from heliograph.graph import ISAM2, Between, Diagonal, FactorGraph, Isotropic, LinearMotion, Prior, Values
from heliograph.lie import SE2

F = np.array([[1.0, 0.1], [0.0, 1.0]])  # position and velocity, a tenth of a second later
Q, R, P0 = np.diag([0.01, 0.1]) ** 2, 0.5, np.eye(2)  # covariance of the motion, sigma of a position, start


def kalman(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the estimates at each time (N, 2) from what was known then, and from what was known at the end."""
    x, P, filtered = np.zeros(2), P0, []
    for k, position in enumerate(z):
        x, P = (F @ x, F @ P @ F.T + Q) if k else (x, P)
        gain = P[:, 0] / (P[0, 0] + R**2)
        x, P = x + gain * (position - x[0]), P - np.outer(gain, P[0])
        filtered.append((x, P))
    smoothed = [filtered[-1][0]]
    for x, P in filtered[-2::-1]:  # Rauch, Tung, Striebel
        smoothed.insert(0, x + P @ F.T @ np.linalg.solve(F @ P @ F.T + Q, smoothed[0] - F @ x))
    return np.array([x for x, _ in filtered]), np.array(smoothed)


def incremental(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the same two from a factor graph that grows by one variable a time."""
    smoother, then, graph = ISAM2(), [], FactorGraph()
    graph.add(Prior(0, np.zeros(2), Isotropic(1.0)))
    for k, position in enumerate(z):
        values = Values()
        values.insert(k, np.zeros(2))
        if k:
            graph.add(LinearMotion(k - 1, k, F, np.zeros(2), Diagonal([0.01, 0.1])))
        graph.add(Prior(k, [position, 0.0], Diagonal([R, 1e9])))  # the velocity is not measured
        smoother.update(graph, values, iterate=1e-12)
        then.append(smoother.estimate(k))
        graph = FactorGraph()
    return np.array(then), np.asarray(smoother.estimate(np.arange(len(z))))


def circle(n: int = 40) -> tuple[SE2, SE2]:
    """Return the poses of a walk round a circle before and after its loop is closed: (n + 1) each."""
    smoother, graph, values, loop, k = ISAM2(), FactorGraph(), Values(), FactorGraph(), np.arange(n + 1)
    values.insert(k, SE2.exp(k[:, None] * [2.1 * np.pi / n, 1.0, 0.0]))  # turns a little too far
    graph.add(Between(k[:-1], k[1:], values.at(1), Diagonal([0.02, 0.05, 0.05])))
    graph.fix(0)
    smoother.update(graph, values)
    loop.add(Between(n, 0, SE2.identity(), Diagonal([0.005, 0.01, 0.01])))
    before = smoother.estimate(k)
    smoother.update(loop, iterate=1e-9)
    return before, smoother.estimate(k)


if __name__ == "__main__":
    z = np.random.default_rng(1).normal(np.linspace(0.0, 5.0, 51), R)
    for name, ours, theirs in zip(("then", "at the end"), incremental(z), kalman(z), strict=True):
        print(f"what was known {name}: graph and Kalman differ by {np.abs(ours - theirs).max():.1e}")
    moved = np.linalg.norm(np.subtract(*(poses.translation for poses in circle())), axis=1)
    print(f"the loop moves poses 1 to {len(moved) - 1} by {moved[1:].min():.5f} to {moved.max():.3f} m")
