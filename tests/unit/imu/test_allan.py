"""Allan deviations against their definition, closed forms and drawn noise."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heliograph.errors import DataError
from heliograph.imu.allan import allan_curve, degrees_of_freedom
from heliograph.imu.noise_terms import allan_variance
from heliograph.imu.stretches import Grid, ImuStretch
from imu_noise import draw, grid_of
from reference.allan import allan_deviation_slowly

PERIOD = 0.01
COEFFICIENTS = {"quantisation": "quantisation", "white": "white", "flicker": "flicker_b", "walk": "walk"}


def drawn_variances(term, *, n=2000, records=40):
    """Allan variances of 6 channels of unit noise in each record, (6 records, t), and the averaging times."""
    found = []
    for seed in range(records):
        rng = np.random.default_rng(seed)
        curve = allan_curve(grid_of([draw(rng, n, PERIOD, **{COEFFICIENTS[term]: 1.0}) for _ in range(6)], PERIOD))
        found.append(curve.deviation.T**2)
    return np.concatenate(found), curve


def test_allan_deviation_equals_its_definition(rng):
    grid = grid_of(rng.normal(size=(6, 300)) + 9.8, PERIOD)
    curve = allan_curve(grid)
    for k, tau in enumerate(curve.tau):
        m = round(tau / PERIOD)
        slow = [allan_deviation_slowly(channel, m, max(m // 8, 1)) for channel in grid.stretches[0].samples.T]
        np.testing.assert_allclose(curve.deviation[k], slow, rtol=1e-9)
        assert curve.terms[k] == len(range(0, 300 - 2 * m + 1, max(m // 8, 1)))


def test_allan_deviation_of_a_ramp_is_its_closed_form():
    ramp = 0.3 * PERIOD * np.arange(500)
    curve = allan_curve(grid_of([ramp] * 6, PERIOD))
    np.testing.assert_allclose(curve.deviation[:, 0], 0.3 * curve.tau / np.sqrt(2.0), rtol=1e-9)
    np.testing.assert_allclose(
        curve.deviation[:, 0] ** 2, allan_variance({"ramp": 0.09}, curve.tau, PERIOD)["ramp"], rtol=1e-9
    )


@pytest.mark.parametrize("term", list(COEFFICIENTS))
def test_allan_variance_and_its_freedom_are_as_drawn(term):
    found, curve = drawn_variances(term)
    expected = allan_variance({term: 1.0}, curve.tau, PERIOD)[term]
    for k in range(len(curve.tau) // 3, len(curve.tau) - 2, 4):  # sampled flicker is no flicker at the sampling period
        dof = degrees_of_freedom(term, 2001, round(curve.tau[k] / PERIOD))
        if term == "quantisation":
            dof = min(dof, 0.5 * curve.terms[k])
        spread = np.sqrt(2.0 / dof / len(found))
        assert found[:, k].mean() / expected[k] == pytest.approx(1.0, abs=4.0 * spread + 0.01)
        assert found[:, k].var() / expected[k] ** 2 * dof / 2.0 == pytest.approx(1.0, abs=0.45)


def test_intervals_hold_the_truth_as_often_as_they_say():
    inside = np.zeros(0)
    for seed in range(60):
        rng = np.random.default_rng(seed)
        curve = allan_curve(grid_of([draw(rng, 1500, PERIOD, white=1.0) for _ in range(6)], PERIOD))
        truth = np.sqrt(allan_variance({"white": 1.0}, curve.tau, PERIOD)["white"])
        picks = [4, 12, 20]
        for channel in range(6):
            low, high = curve.interval(["white"] * len(truth), channel).T
            inside = np.concatenate([inside, ((low < truth) & (truth < high))[picks]])
    assert inside.mean() == pytest.approx(0.683, abs=4.0 * np.sqrt(0.22 / len(inside)))


def test_stretches_are_pooled_by_their_differences(rng):
    whole = rng.normal(size=(900, 6))
    parts = (ImuStretch(begin_ns=0, samples=whole[:600]), ImuStretch(begin_ns=0, samples=whole[600:]))
    both = allan_curve(Grid(period=PERIOD, stretches=parts, filled=0, gaps=1))
    alone = [allan_curve(Grid(period=PERIOD, stretches=(part,), filled=0, gaps=0)) for part in parts]
    squares = [curve.deviation[4] ** 2 * curve.terms[4] for curve in alone]
    np.testing.assert_allclose(both.deviation[4] ** 2 * both.terms[4], sum(squares), rtol=1e-12)
    assert both.terms[4] == alone[0].terms[4] + alone[1].terms[4]
    assert len(both.tau) == len(alone[0].tau) > len(alone[1].tau)


@settings(max_examples=40, deadline=None)
@given(n=st.integers(3, 80), offset=st.floats(-1e3, 1e3), scale=st.floats(1e-6, 1e3), seed=st.integers(0, 2**31))
def test_allan_deviation_ignores_the_offset_and_follows_the_scale(n, offset, scale, seed):
    signal = np.random.default_rng(seed).normal(size=(6, n))
    base = allan_curve(grid_of(signal, PERIOD)).deviation
    moved = allan_curve(grid_of(offset + scale * signal, PERIOD)).deviation
    np.testing.assert_allclose(moved, scale * base, rtol=1e-6, atol=1e-10 * abs(offset))


def test_constant_signal_has_no_deviation_and_two_samples_are_refused():
    assert not allan_curve(grid_of(np.full((6, 50), 3.0), PERIOD)).deviation.any()
    with pytest.raises(DataError, match="2 samples in a row"):
        allan_curve(grid_of(np.zeros((6, 2)), PERIOD))
