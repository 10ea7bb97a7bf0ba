"""What every textbook says of factor graphs: numbers by hand, filters as chains, loops that close without a kink."""

import numpy as np
import pytest

from heliograph.graph import (
    Between,
    Diagonal,
    Factor,
    FactorGraph,
    Information,
    Isotropic,
    LinearMotion,
    Marginals,
    Prior,
    Values,
    solve,
)
from heliograph.graph import Covariance as Cov
from heliograph.graph.problem.problem import Problem
from heliograph.lie import SE2


class _RangeTo(Factor):
    """Distances from the position of a state to known beacons."""

    variables = (4,)
    rows = 3

    @staticmethod
    def residual(x, beacons, z):
        return np.linalg.norm(x[:, None, :2] - beacons, axis=2) - z

    @staticmethod
    def jacobians(x, beacons, z):  # noqa: ARG004
        away = x[:, None, :2] - beacons
        J = np.zeros((len(x), 3, 4))
        J[:, :, :2] = away / np.linalg.norm(away, axis=2, keepdims=True)
        return (J,)


def _minimum(graph, values):
    """Return the minimum to rounding: full steps beyond where the cost can tell a difference."""
    problem = Problem(graph, solve(graph, values).values)
    problem.analyze()
    for _ in range(20):
        problem.linearize()
        problem.factorize(0.0, 0.0)
        problem.linear_step(0.0, 0.0)
        problem.try_step()
        problem.accept()
    return problem.values()


def _line():
    """Return a graph of two places on a line: a prior and a step of 10 m."""
    graph, values = FactorGraph(), Values()
    values.insert([0, 1], [[0.0], [10.0]])
    graph.add(Prior(0, [0.0], Isotropic(1.0)))
    graph.add(Between(0, 1, [10.0], Isotropic(1.0)))
    return graph, values


def test_two_places_on_a_line_share_the_error_by_its_variance():
    graph, values = _line()
    graph.add(Prior(1, [11.0], Isotropic(2.0)))
    solution = solve(graph, values)
    # By hand: the sum of squares x0^2 + (x1 - x0 - 10)^2 + (x1 - 11)^2 / 4 is least at 1/6 and 31/3.
    np.testing.assert_allclose(solution.values.at([0, 1])[:, 0], [1.0 / 6.0, 31.0 / 3.0], atol=1e-12)
    assert solution.values.at(0)[0] == pytest.approx(0.167, abs=5e-4)
    assert solution.values.at(1)[0] == pytest.approx(10.33, abs=5e-3)
    assert solution.chi2 == pytest.approx(1.0 / 6.0, abs=1e-12)  # 1^2 / (1 + 1 + 4)
    covariance = np.linalg.inv([[2.0, -1.0], [-1.0, 1.25]])
    np.testing.assert_allclose(Marginals(graph, solution.values).joint([0, 1]), covariance, atol=1e-12)


def test_smoothing_revises_the_past_and_filtering_does_not():
    graph, values = _line()
    before = solve(graph, values).values.at(0)[0]
    graph.add(Prior(1, [11.0], Isotropic(2.0)))
    smoothed = solve(graph, values).values.at([0, 1])[:, 0]
    # The filter has left place 0 behind at 0 and corrects place 1 alone, to the same number.
    filtered = 10.0 + 2.0 / (2.0 + 4.0) * (11.0 - 10.0)
    assert before == pytest.approx(0.0, abs=1e-12)
    assert smoothed[0] == pytest.approx(1.0 / 6.0, abs=1e-12)
    assert smoothed[1] == pytest.approx(filtered, abs=1e-12)


class _Filter:
    """A Kalman filter, as in any textbook."""

    def __init__(self, x, P):
        self.x, self.P = x, P

    def predict(self, F, u, Q):
        self.x, self.P = F @ self.x + u, F @ self.P @ F.T + Q

    def update(self, z, h, H_of, R):
        """Iterated: Gauss-Newton on the new state with the prediction as prior; linear measurements need one pass."""
        x = self.x
        for _ in range(50):
            H = H_of(x)
            K = self.P @ H.T @ np.linalg.inv(H @ self.P @ H.T + R)
            x = self.x + K @ (z - h(x) - H @ (self.x - x))
        self.x, self.P = x, (np.eye(len(x)) - K @ H_of(x)) @ self.P


def _moving(rng):
    """Return transition, input and its noise of a body with position and velocity in the plane."""
    dt = 0.5
    F = np.block([[np.eye(2), dt * np.eye(2)], [np.zeros((2, 2)), 0.95 * np.eye(2)]])
    root = 0.1 * rng.normal(size=(4, 4)) + 0.3 * np.eye(4)
    return F, np.array([0.0, 0.0, 0.1, -0.05]), root @ root.T


def _chain(rng, steps):
    """Return graph and values of a chain with a position measured at every place, and the filter run forward."""
    F, u, Q = _moving(rng)
    P0, R = np.diag([1.0, 2.0, 0.5, 0.5]), np.diag([0.2, 0.4])
    H = np.eye(2, 4)
    graph, values = FactorGraph(), Values()
    values.insert(np.arange(steps), rng.normal(size=(steps, 4)))
    graph.add(Prior(0, np.zeros(4), Cov(P0)))
    graph.add(LinearMotion(np.arange(steps - 1), np.arange(1, steps), F, u, Cov(Q)))
    z = rng.normal(size=(steps, 2)) + 0.3 * np.arange(steps)[:, None]
    # A position alone is a prior that knows nothing of the velocity.
    padded = np.concatenate([z, np.zeros((steps, 2))], axis=1)
    graph.add(Prior(np.arange(steps), padded, Information(H.T @ np.linalg.inv(R) @ H)))
    filtered = _Filter(np.zeros(4), P0)
    for k in range(steps):
        if k:
            filtered.predict(F, u, Q)
        filtered.update(z[k], lambda x: H @ x, lambda _: H, R)
    return graph, values, filtered, (F, u, Q)


def test_kalman_filter_is_the_newest_state_of_the_chain(rng):
    graph, values, filtered, _ = _chain(rng, 40)
    solution = solve(graph, values, method="gn")
    np.testing.assert_allclose(solution.values.at(39), filtered.x, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(Marginals(graph, solution.values).covariance([39])[0], filtered.P, rtol=0.0, atol=1e-9)


def test_smoothed_chain_is_surer_of_its_past_than_the_filter_was(rng):
    graph, values, *_ = _chain(rng, 20)
    whole = Marginals(graph, solve(graph, values).values).covariance([10])[0]
    rng_again = np.random.default_rng(20260101)
    _, _, filtered, _ = _chain(rng_again, 11)
    assert (np.linalg.eigvalsh(filtered.P - whole) > -1e-12).all()
    assert np.trace(whole) < 0.9 * np.trace(filtered.P)


def test_iterated_filter_is_the_newest_state_of_the_chain(rng):
    graph, values, filtered, (F, u, Q) = _chain(rng, 25)
    values.insert(25, [8.0, 8.0, 0.0, 0.0])
    graph.add(LinearMotion(24, 25, F, u, Cov(Q)))
    filtered.predict(F, u, Q)
    # The newest place is seen by ranges to three beacons close by, where they are far from linear.
    beacons = filtered.x[:2] + np.array([[0.8, 0.1], [-0.3, 0.7], [0.2, -0.9]])
    z, sigma = np.array([1.0, 0.6, 0.9]), 0.15
    graph.add(_RangeTo(25, data=(beacons, z), noise=Isotropic(sigma)))

    def h(x):
        return np.linalg.norm(x[:2] - beacons, axis=1)

    def H_of(x):
        return np.concatenate([(x[:2] - beacons) / h(x)[:, None], np.zeros((3, 2))], axis=1)

    linear = _Filter(filtered.x, filtered.P)
    filtered.update(z, h, H_of, sigma**2 * np.eye(3))
    first = linear.P @ H_of(linear.x).T
    once = linear.x + first @ np.linalg.solve(H_of(linear.x) @ first + sigma**2 * np.eye(3), z - h(linear.x))
    found = _minimum(graph, values)
    np.testing.assert_allclose(found.at(25), filtered.x, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(Marginals(graph, found).covariance([25])[0], filtered.P, rtol=0.0, atol=1e-9)
    assert np.linalg.norm(once - filtered.x) > 1e-3  # it did take iterations


def test_iterated_filter_run_forward_is_a_chain_of_small_graphs(rng):
    F, u, Q = _moving(rng)
    beacons = np.array([[3.0, 0.0], [0.0, 4.0], [-2.0, -3.0]])
    filtered = _Filter(np.array([0.5, 0.2, 1.0, 0.3]), np.diag([0.5, 0.5, 0.2, 0.2]))
    mean, covariance = filtered.x, filtered.P
    truth = filtered.x + rng.normal(size=4) * 0.4
    for _ in range(12):
        truth = F @ truth + u
        z = np.linalg.norm(truth[:2] - beacons, axis=1) + 0.05 * rng.normal(size=3)
        filtered.predict(F, u, Q)
        filtered.update(
            z,
            lambda x: np.linalg.norm(x[:2] - beacons, axis=1),
            lambda x: np.concatenate(
                [(x[:2] - beacons) / np.linalg.norm(x[:2] - beacons, axis=1)[:, None], np.zeros((3, 2))], axis=1
            ),
            0.05**2 * np.eye(3),
        )
        graph, values = FactorGraph(), Values()
        values.insert([0, 1], np.stack([mean, F @ mean + u]))
        graph.add(Prior(0, mean, Cov(covariance)))
        graph.add(LinearMotion(0, 1, F, u, Cov(Q)))
        graph.add(_RangeTo(1, data=(beacons, z), noise=Isotropic(0.05)))
        found = _minimum(graph, values)
        mean = found.at(1)
        covariance = Marginals(graph, found).covariance([1])[0]
    np.testing.assert_allclose(mean, filtered.x, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(covariance, filtered.P, rtol=0.0, atol=1e-9)


def test_loop_closure_spreads_drift_evenly_and_without_a_kink():
    n, drift = 100, 2.0
    angle = 2.0 * np.pi * np.arange(n + 1) / n
    truth = SE2.exp(np.stack([angle, 0.0 * angle, 0.0 * angle], axis=1)).matrix.copy()
    truth[:, :2, 2] = 16.0 * np.stack([np.sin(angle), 1.0 - np.cos(angle)], axis=1)
    # Every step is off by 2 cm to the east of the world, so the end misses the start by 2 m.
    drifted = truth.copy()
    drifted[:, 0, 2] += drift * np.arange(n + 1) / n
    T_odom = SE2(drifted)
    assert np.linalg.norm(drifted[n, :2, 2] - drifted[0, :2, 2]) == pytest.approx(drift, abs=1e-9)
    graph, values = FactorGraph(), Values()
    values.insert(np.arange(n + 1), T_odom)
    steps = T_odom[:-1].inverse() @ T_odom[1:]
    graph.add(Between(np.arange(n), np.arange(1, n + 1), steps, Diagonal([1e-4, 0.05, 0.05])))
    graph.add(Between(n, 0, SE2.identity(), Diagonal([1e-4, 0.001, 0.001])))
    graph.fix(0)
    poses = solve(graph, values).values.block(SE2)[1].matrix
    moved = np.diff(poses[:, :2, 2] - drifted[:, :2, 2], axis=0)
    np.testing.assert_allclose(np.linalg.norm(moved, axis=1), drift / n, rtol=0.05)
    assert np.linalg.norm(poses[n, :2, 2] - poses[0, :2, 2]) < 0.01
    assert np.abs(np.diff(moved, axis=0)).max() < 0.05 * drift / n  # no kink between neighbours
    # Before the loop closed the same graph left the drift where it was.
    open_graph = FactorGraph()
    open_graph.add(Between(np.arange(n), np.arange(1, n + 1), steps, Diagonal([1e-4, 0.05, 0.05])))
    open_graph.fix(0)
    unchanged = solve(open_graph, values).values.block(SE2)[1].matrix
    np.testing.assert_allclose(unchanged, drifted, atol=1e-12)
