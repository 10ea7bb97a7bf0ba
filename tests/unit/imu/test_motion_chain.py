"""The chain's elimination against one dense solve with derivatives by differences."""

import numpy as np
import pytest

from heliograph.imu import preintegrate
from heliograph.imu.motion_chain import NODE, SHARED, Chain, relax
from heliograph.lie import s2, so3
from states import GRAVITY, NOISE, START_NS, random_covariance, random_imu, random_rotation

N = 4


@pytest.fixture
def problem(rng):
    """A chain far from its solution, with one instant that has no measured pose."""
    stamps = START_NS + np.arange(N + 1) * 60_000_000
    imu = random_imu(rng, duration=0.06 * N + 0.02)
    down = random_rotation(rng, 0.4) @ [0.0, 0.0, -1.0]
    chain = Chain(
        R=np.stack([random_rotation(rng) for _ in range(N + 1)]),
        p=rng.normal(size=(N + 1, 3)),
        v=rng.normal(size=(N + 1, 3)),
        gyro_bias=0.05 * rng.normal(size=3),
        accel_bias=0.2 * rng.normal(size=3),
        g=GRAVITY * down,
        log_scale=0.1,
    )
    biases = {"gyro_bias": chain.gyro_bias, "accel_bias": chain.accel_bias}
    deltas = preintegrate(imu, stamps[:-1], stamps[1:], noise=NOISE, **biases)
    information = np.stack([np.linalg.inv(random_covariance(rng, 6)) for _ in range(N + 1)])
    information[0] = 0.0
    measured = (
        chain.R @ so3.exp(0.4 * rng.normal(size=(N + 1, 3))),
        chain.p + rng.normal(size=(N + 1, 3)),
        information,
    )
    prior = (rng.normal(size=SHARED), rng.uniform(1.0, 50.0, SHARED))
    return chain, deltas, measured, prior


def residuals(problem, nodes, shared):
    """All whitened residuals after a step, written down plainly; deltas follow the biases to first order."""
    chain, deltas, (R_m, p_m, information), (off, weight) = problem
    moved = chain.moved(nodes, shared)
    delta = deltas.corrected(moved.gyro_bias, moved.accel_bias)
    rows = []
    for k in range(N):
        dt, R0, R1 = deltas.duration_s[k], moved.R[k], moved.R[k + 1]
        turn = so3.log(delta.delta_R[k].T @ R0.T @ R1)
        shrink = np.exp(-moved.log_scale)
        travelled = R0.T @ (moved.p[k + 1] - moved.p[k] - moved.v[k] * dt - 0.5 * moved.g * dt**2)
        gained = R0.T @ (moved.v[k + 1] - moved.v[k] - moved.g * dt)
        E = deltas.delta_R[k]
        error = np.concatenate(
            [turn, E.T @ (travelled - shrink * delta.delta_p[k]), E.T @ (gained - shrink * delta.delta_v[k])]
        )
        rows.append(np.linalg.cholesky(np.linalg.inv(deltas.covariance[k])).T @ error)
    for k in range(1, N + 1):
        error = np.concatenate([so3.log(R_m[k].T @ moved.R[k]), moved.p[k] - p_m[k]])
        rows.append(np.linalg.cholesky(information[k]).T @ error)
    rows.append(np.sqrt(weight) * (off + shared))
    return np.concatenate(rows)


def dense(problem):
    """Residual and Jacobian of the whole problem by central differences."""
    size = NODE * (N + 1) + SHARED

    def at(x):
        return residuals(problem, x[:-SHARED].reshape(N + 1, NODE), x[-SHARED:])

    step = 1e-6
    J = np.stack([(at(step * e) - at(-step * e)) / (2.0 * step) for e in np.eye(size)], axis=1)
    return at(np.zeros(size)), J


def test_elimination_equals_one_dense_solve(problem):
    r, J = dense(problem)
    H = J.T @ J
    step, covariance = -np.linalg.solve(H, J.T @ r), np.linalg.inv(H)
    solution = relax(*problem)
    found = np.concatenate([solution.nodes.ravel(), solution.shared])
    np.testing.assert_allclose(found, step, rtol=1e-4, atol=1e-6 * np.abs(step).max())
    first = np.r_[0:NODE, NODE * (N + 1) : len(step)]
    scale = np.sqrt(np.outer(np.diag(covariance)[first], np.diag(covariance)[first]))
    np.testing.assert_allclose(solution.covariance / scale, covariance[np.ix_(first, first)] / scale, atol=1e-4)
    for k in range(N + 1):
        block = slice(NODE * k + 6, NODE * k + 9)
        np.testing.assert_allclose(solution.velocity_covariance[k], covariance[block, block], rtol=1e-3, atol=1e-9)


def test_cost_is_the_sum_of_squares(problem):
    r, _ = dense(problem)
    assert relax(*problem).cost == pytest.approx(r @ r, rel=1e-9)


def test_information_leaves_the_prior_out(problem):
    chain, deltas, measured, (off, weight) = problem
    with_prior, twice = relax(*problem), relax(chain, deltas, measured, (off, 2.0 * weight))
    np.testing.assert_allclose(with_prior.information, twice.information, rtol=1e-9)
    expected = with_prior.information + np.diag(np.concatenate([np.zeros(NODE), weight]))
    np.testing.assert_allclose(np.linalg.inv(with_prior.covariance), expected, rtol=1e-4, atol=1e-3)


def test_moved_keeps_gravity_on_its_sphere(problem, rng):
    chain = problem[0]
    moved = chain.moved(np.zeros((N + 1, NODE)), rng.normal(size=SHARED))
    assert np.linalg.norm(moved.g) == pytest.approx(GRAVITY)
    assert np.linalg.norm(s2.local(chain.g / GRAVITY, moved.g / GRAVITY)) > 0.1
