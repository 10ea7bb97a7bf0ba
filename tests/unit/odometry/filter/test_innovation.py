"""The IMU's word on a registration: no alarm where both are right, one where a match moves the pose too far."""

from dataclasses import replace

import numpy as np
import pytest
from test_update import TIGHT, Measured, linear_measurement, textbook

from heliograph.config import RunConfig
from heliograph.data import Scan
from heliograph.odometry import make_odometry
from heliograph.odometry.filter.innovation import InnovationTest
from heliograph.odometry.filter.update import iterated_update, weighed_less
from heliograph.sim import SCENARIOS, simulate
from states import random_state

SMALL = SCENARIOS["room"].thinned(beams=16, columns=256, duration=4.5).varied(walk={"rest": 1.5, "ramp": 1.0})


def test_corrections_of_chance_are_no_alarm():
    test, rng = InnovationTest(), np.random.default_rng(0)
    for nis in rng.chisquare(6, 20_000):
        assert test.excess(nis) <= 1.0
        test.add(nis)


def test_one_correction_beyond_chance_is_one_and_makes_no_other_suspect():
    test = InnovationTest()
    for nis in [6.0] * 30:
        test.add(nis)
    assert test.excess(430.0) == pytest.approx(9.9, abs=0.1)
    test.add(430.0)
    for _ in range(30):
        assert test.excess(6.0) < 1.0
        test.add(6.0)


def test_corrections_that_are_each_likely_are_suspect_together():
    test, excess = InnovationTest(), []
    for _ in range(25):
        excess.append(test.excess(14.0))
        test.add(14.0)
    assert max(excess[:19]) < 1.0 < min(excess[19:])


def test_update_that_weighs_less_is_the_one_of_a_noisier_measurement(rng):
    prior = random_state(rng)
    linearize = linear_measurement(rng, prior, 9, range(3, 15))
    fit = iterated_update(prior, linearize, **TIGHT)
    at = linearize(fit.linearized_at, 0)
    noisier = Measured(at.H, at.r, 5.0 * at.R, at.columns)
    less = weighed_less(fit, prior, noisier, None)
    first = linearize(prior, 0)
    mean, covariance = textbook(prior, Measured(first.H, first.r, 5.0 * first.R, first.columns))
    np.testing.assert_allclose(less.state.p_odom - prior.p_odom, mean[3:6], atol=1e-8)
    np.testing.assert_allclose(less.state.v_odom - prior.v_odom, mean[6:9], atol=1e-8)
    np.testing.assert_allclose(less.state.covariance[3:9, 3:9], covariance[3:9, 3:9], atol=1e-8)
    assert less.nis == fit.nis


def suspects(records):
    """Indices of the scans that bear the event, and the errors of all positions [m]."""
    simulation = simulate(SMALL, 2)
    odometry = make_odometry(RunConfig(), simulation.rig, frozenset({"lidar", "imu"}), 1)
    results = [r for record in records(simulation) for r in odometry.add(record)] + odometry.finish()
    truth = simulation.truth.pose(np.array([r.end_ns for r in results]))
    expected = results[0].T_odom_imu @ np.linalg.inv(truth[0]) @ truth
    error = np.linalg.norm([r.T_odom_imu[:3, 3] - T[:3, 3] for r, T in zip(results, expected, strict=True)], axis=1)
    marked = [r.index for r in results if any(e.code == "match-against-imu" for e in r.events)]
    return marked, error


def test_scan_that_jumps_is_told_and_weighs_less_and_a_healthy_one_is_not():
    def jumping(simulation):
        scans = 0
        for record in simulation:
            if isinstance(record, Scan):
                scans += 1
                if scans == 31:  # as if all of a sudden its planes were those of a place that looks alike
                    record = replace(record, points=record.points + np.float32([0.07, 0.0, 0.0]))
            yield record

    healthy, _ = suspects(iter)
    assert healthy == []
    marked, error = suspects(jumping)
    assert marked == [30]
    assert error.max() < 0.01  # the points say 0.07 m
