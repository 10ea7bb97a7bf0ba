"""The information-form update against the textbook's gain and a batch least-squares solution."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from heliograph.odometry.filter.error_state import local, reset_jacobian, retract
from heliograph.odometry.filter.update import iterated_update
from heliograph.testing import numeric_jacobian
from states import random_covariance, random_state

TIGHT = {"max_iterations": 50, "tolerance_rotation": 1e-9, "tolerance_position": 1e-9}


@dataclass(frozen=True)
class Measured:
    """A measurement with its Jacobian, in the form that the update wants."""

    H: np.ndarray
    r: np.ndarray
    R: np.ndarray
    columns: np.ndarray

    @property
    def information(self):
        return self.H.T @ np.linalg.solve(self.R, self.H)

    @property
    def gradient(self):
        return self.H.T @ np.linalg.solve(self.R, self.r)


def linear_measurement(rng, prior, rows, columns):
    """Of position, velocity and biases only: there the state is a vector space and the problem linear."""
    columns = np.asarray(columns)
    H, noise = rng.normal(size=(rows, len(columns))), random_covariance(rng, rows, 0.3)

    def stacked(state):
        return np.concatenate([np.zeros(3), state.p_odom, state.v_odom, state.gyro_bias, state.accel_bias])

    z = H @ stacked(prior)[columns] + 0.3 * rng.normal(size=rows)

    def linearize(state, _):
        return Measured(H, H @ stacked(state)[columns] - z, noise, columns)

    return linearize


def textbook(prior, measured):
    """K = P H^T (H P H^T + R)^-1, posterior mean and covariance."""
    P = prior.covariance
    H = np.zeros((len(measured.r), len(P)))
    H[:, measured.columns] = measured.H
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + measured.R)
    return -K @ measured.r, (np.eye(len(P)) - K @ H) @ P


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("dim", [17, 23])
@pytest.mark.parametrize("rows", [1, 5, 40])
def test_update_equals_the_textbook_gain_on_a_linear_problem(seed, dim, rows):
    rng = np.random.default_rng(seed)
    prior = random_state(rng, dim=dim)
    # Uncorrelated with the curved errors, so that the correction stays in the vector space.
    covariance = prior.covariance.copy()
    flat = np.arange(3, 15)
    covariance[:] = 0.0
    covariance[np.ix_(flat, flat)] = prior.covariance[np.ix_(flat, flat)]
    prior = replace(prior, covariance=covariance)
    linearize = linear_measurement(rng, prior, rows, [3, 4, 5, 7, 9, 13])
    result = iterated_update(prior, linearize, **TIGHT)
    step, P = textbook(prior, linearize(prior, 0))
    np.testing.assert_allclose(local(prior, result.state), step, atol=1e-9)
    np.testing.assert_allclose(result.state.covariance, P, atol=1e-11)
    assert result.converged
    assert result.iterations <= 3


def landmarks(rng, count=12):
    """Landmarks seen in the body frame: strongly nonlinear in the rotation; also their range rates."""
    places, sigma = rng.uniform(-8.0, 8.0, (count, 3)), 0.3

    def predict(state):
        seen = (places - state.p_odom) @ state.R_odom_imu
        return np.concatenate(
            [seen.ravel(), seen @ (state.R_odom_imu.T @ state.v_odom), state.g_odom @ state.R_odom_imu]
        )

    return predict, sigma


def nonlinear_problem(rng, dim, spread):
    prior = replace(random_state(rng, dim=dim), covariance=random_covariance(rng, dim, spread))
    predict, sigma = landmarks(rng)
    truth = retract(prior, np.linalg.cholesky(prior.covariance) @ rng.normal(size=dim))
    z = predict(truth)
    z = z + sigma * rng.normal(size=len(z))
    R = sigma**2 * np.eye(len(z))

    def linearize(state, _):
        H = numeric_jacobian(lambda e: predict(retract(state, e)), np.zeros(dim), step=1e-4)
        return Measured(H, predict(state) - z, R, np.arange(dim))

    return prior, predict, z, sigma, linearize


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("dim", [17, 23])
def test_one_iteration_equals_the_textbook_gain_on_a_nonlinear_problem(seed, dim):
    prior, *_, linearize = nonlinear_problem(np.random.default_rng(seed), dim, 0.05)
    result = iterated_update(prior, linearize, max_iterations=1, tolerance_rotation=0.0, tolerance_position=0.0)
    step, P = textbook(prior, linearize(prior, 0))
    np.testing.assert_allclose(local(prior, result.state), step, atol=1e-8)
    J = reset_jacobian(prior, step)
    np.testing.assert_allclose(result.state.covariance, J @ P @ J.T, atol=1e-9)
    assert not result.converged


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("dim", [17, 23])
def test_converged_update_is_the_minimum_of_prior_and_measurement(seed, dim):
    """Against a batch optimiser that knows nothing of Kalman filters, from large prior errors."""
    from scipy.optimize import least_squares

    prior, predict, z, sigma, linearize = nonlinear_problem(np.random.default_rng(10 + seed), dim, 0.12)
    root = np.linalg.inv(np.linalg.cholesky(prior.covariance))

    def residuals(delta):
        return np.concatenate([root @ delta, (predict(retract(prior, delta)) - z) / sigma])

    batch = least_squares(residuals, np.zeros(dim), xtol=1e-14, ftol=1e-14, gtol=1e-14, method="lm")
    result = iterated_update(prior, linearize, **TIGHT)
    found = local(prior, result.state)
    assert result.converged
    assert np.linalg.norm(found[:3]) > 0.1
    np.testing.assert_allclose(found, batch.x, atol=1e-5)
    # Its covariance is the inverse Hessian there (Gauss-Newton), seen from the posterior.
    J = reset_jacobian(prior, found)
    H = numeric_jacobian(residuals, found, step=1e-4)
    np.testing.assert_allclose(result.state.covariance, J @ np.linalg.inv(H.T @ H) @ J.T, atol=1e-6)


def test_singular_prior_keeps_what_it_knows_exactly(rng):
    prior = random_state(rng)
    covariance = prior.covariance.copy()
    covariance[3:6], covariance[:, 3:6] = 0.0, 0.0
    prior = replace(prior, covariance=covariance)
    result = iterated_update(prior, linear_measurement(rng, prior, 20, [3, 4, 5, 6, 7, 8]), **TIGHT)
    np.testing.assert_array_equal(result.state.p_odom, prior.p_odom)
    assert np.abs(result.state.covariance[3:6]).max() < 1e-16
    assert np.linalg.norm(result.state.v_odom - prior.v_odom) > 0.01
    assert np.isfinite(result.nis)


def test_no_information_changes_nothing(rng):
    prior = random_state(rng)
    nothing = Measured(np.zeros((1, 6)), np.zeros(1), np.eye(1), np.arange(6))
    result = iterated_update(prior, lambda *_: nothing, **TIGHT)
    np.testing.assert_allclose(local(prior, result.state), 0.0, atol=1e-15)
    np.testing.assert_allclose(result.state.covariance, prior.covariance, atol=1e-15)


def test_posterior_is_symmetric_and_never_wider_than_the_prior(rng):
    prior = random_state(rng)
    result = iterated_update(prior, linear_measurement(rng, prior, 8, [3, 4, 5, 10]), **TIGHT)
    P = result.state.covariance
    np.testing.assert_array_equal(P, P.T)
    assert np.linalg.eigvalsh(P).min() > 0.0
    assert np.trace(P) < np.trace(prior.covariance)


def test_update_waits_for_the_measurement_to_settle(rng):
    prior = random_state(rng)
    measurement = linear_measurement(rng, prior, 8, [3, 4, 5])
    loose = {"max_iterations": 9, "tolerance_rotation": 1.0, "tolerance_position": 100.0}
    assert iterated_update(prior, measurement, **loose).iterations == 1
    assert iterated_update(prior, measurement, **loose, settled=lambda k: k >= 4).iterations == 5
    never = iterated_update(prior, measurement, **loose, settled=lambda _: False)
    assert (never.iterations, never.converged) == (9, False)


def test_nis_averages_to_the_number_of_poses_directions():
    """The correction of an honest filter, in units of its predicted spread, has mean 6."""
    rng, found = np.random.default_rng(5), []
    for _ in range(400):
        covariance = random_covariance(rng, 17, 0.02)
        prior = replace(random_state(rng), covariance=covariance)
        truth = retract(prior, np.linalg.cholesky(covariance) @ rng.normal(size=17))
        sigma, columns = 0.02, np.arange(6)

        noise = sigma * rng.normal(size=6)

        def linearize(state, _, truth=truth, noise=noise):
            return Measured(np.eye(6), local(truth, state)[:6] + noise, sigma**2 * np.eye(6), columns)  # noqa: B023

        found.append(iterated_update(prior, linearize, **TIGHT).nis)
    assert np.mean(found) == pytest.approx(6.0, abs=4.0 * np.sqrt(12.0 / 400))
