"""Covariances of steps: they add up to what they were taken from, and agree with sampled chains."""

import numpy as np

from heliograph.lie import se3, so3
from heliograph.slam.covariances import OdometryChain, graph_covariance, step_covariance

LEAST = np.full(6, 1e-9)


def random_covariance(rng, scale):
    A = rng.normal(size=(6, 6))
    return scale**2 * (A @ A.T + np.eye(6))


def test_graph_covariance_is_that_of_the_right_perturbation():
    rng = np.random.default_rng(1)
    T = se3.exp(rng.normal(size=6))
    P = random_covariance(rng, 1e-4)
    d = rng.multivariate_normal(np.zeros(6), P, size=200_000)
    R = T[:3, :3] @ so3.exp(d[:, :3])
    p = T[:3, 3] + d[:, 3:]
    xi = se3.local(np.broadcast_to(T, (len(d), 4, 4)), se3.from_rotation_translation(R, p))
    np.testing.assert_allclose(np.cov(xi.T), graph_covariance(P, T), rtol=0.03, atol=0.02 * np.abs(P).max())


def test_step_covariance_is_what_the_poses_gained():
    rng = np.random.default_rng(2)
    before, Z = se3.exp(rng.normal(size=6)), se3.exp(rng.normal(size=6))
    P, Q = random_covariance(rng, 1e-3), random_covariance(rng, 1e-3)
    carry = se3.adjoint(se3.inverse(Z))
    after = carry @ P @ carry.T + Q
    np.testing.assert_allclose(step_covariance(before, before @ Z, P, after, LEAST), Q, atol=1e-15)


def test_step_covariance_that_shrinks_is_the_least():
    T = np.eye(4)
    least = np.array([1e-4] * 3 + [1e-3] * 3)
    got = step_covariance(T, T, np.eye(6), 0.5 * np.eye(6), least)
    np.testing.assert_allclose(got, np.diag(least**2), atol=1e-15)


def test_chain_gives_the_covariance_of_sampled_chains():
    rng = np.random.default_rng(3)
    steps = [se3.exp(np.array([0.0, 0.0, 0.3, 1.0, 0.1, 0.0])) for _ in range(6)]
    Q = np.diag([1e-3] * 3 + [1e-2] * 3) ** 2
    chain, T = OdometryChain(), np.eye(4)
    chain.append(0, T, np.zeros((6, 6)))
    for step in steps:
        T = T @ step
        chain.append(len(chain), T, Q)
    samples = np.broadcast_to(np.eye(4), (100_000, 4, 4))
    for step in steps[2:]:
        samples = samples @ step @ se3.exp(rng.multivariate_normal(np.zeros(6), Q, size=len(samples)))
    mean, covariance = chain.relative(2, 6)
    xi = se3.local(np.broadcast_to(mean, samples.shape), samples)
    np.testing.assert_allclose(np.cov(xi.T), covariance, rtol=0.05, atol=0.03 * np.abs(covariance).max())


def test_chain_is_certain_of_a_keyframe_against_itself():
    chain = OdometryChain()
    chain.append(0, np.eye(4), np.zeros((6, 6)))
    chain.append(1, np.eye(4), np.eye(6))
    mean, covariance = chain.relative(1, 1)
    np.testing.assert_array_equal(mean, np.eye(4))
    np.testing.assert_array_equal(covariance, np.zeros((6, 6)))
