"""Noise terms: recovered from drawn noise within their sigmas, and owned up to where the record does not show them."""

import numpy as np
import pytest
from scipy import fft, optimize, stats

from heliograph.imu.bands import band_spectrum, cosine_coefficients, ramp_coefficients
from heliograph.imu.noise_fit import fit_channel
from heliograph.imu.noise_likelihood import maximise
from heliograph.imu.noise_terms import TERMS, allan_variance, spectrum, term_spectra
from imu_noise import draw
from reference.allan import cosine_coefficients_slowly

PERIOD = 0.01
NAMES = {"white": "white", "flicker": "flicker_b", "walk": "walk", "quantisation": "quantisation", "ramp": "ramp"}


def fits(truth, *, n, seeds, period=PERIOD):
    return [
        fit_channel(band_spectrum([draw(np.random.default_rng(seed), n, period, **truth)], period)) for seed in seeds
    ]


def normalised_errors(channels, name, truth):
    """Errors of the logarithm in sigmas, of the records that show the term."""
    shown = [channel.term(name) for channel in channels if channel.term(name).value is not None]
    return np.array([np.log(t.value / truth) * t.value / t.sigma for t in shown])


def assert_calibrated(errors, least):
    """The mean square lies in its two-sided 99.9 % chi-square band, and there is no bias beyond chance."""
    assert len(errors) >= least
    low, high = stats.chi2.ppf([0.0005, 0.9995], len(errors)) / len(errors)
    assert low < np.mean(errors**2) < high
    assert abs(np.mean(errors)) < 3.3 / np.sqrt(len(errors))


@pytest.mark.parametrize("n", [2, 3, 7, 64, 101, 1000])
def test_cosine_coefficients_equal_their_definition(rng, n):
    signal = rng.normal(size=n)
    np.testing.assert_allclose(cosine_coefficients(signal), cosine_coefficients_slowly(signal), atol=1e-11)
    np.testing.assert_allclose(cosine_coefficients(signal), fft.dct(signal, norm="ortho")[1:], atol=1e-11)


@pytest.mark.parametrize("n", [2, 3, 8, 33])
def test_ramp_coefficients_equal_the_transform_of_a_ramp(n):
    np.testing.assert_allclose(ramp_coefficients(n, n - 1), cosine_coefficients(np.arange(float(n))), atol=1e-12 * n**2)


def test_walk_through_white_noise_is_diagonal_in_the_cosine_basis():
    """Eq. (5) is exact: the covariance of the coefficients is the spectrum over the period, and diagonal."""
    n, white, walk = 40, 0.7, 0.3
    steps = np.tril(np.ones((n, n - 1)), -1)  # from an unknown start, which the mean carries off
    covariance = white**2 / PERIOD * np.eye(n) + walk**2 * PERIOD * steps @ steps.T
    basis = np.stack([cosine_coefficients(e) for e in np.eye(n)], axis=1)
    frequency = np.arange(1, n) / (2.0 * n * PERIOD)
    expected = np.diag(spectrum({"white": white**2, "walk": walk**2}, frequency, PERIOD) / PERIOD)
    np.testing.assert_allclose(basis @ covariance @ basis.T, expected, atol=1e-10 * expected.max())


@pytest.mark.parametrize("name", TERMS)
def test_spectrum_and_allan_variance_of_a_term_agree(name):
    """The Allan variance is the spectrum through the transfer of two neighbouring averages."""
    frequency = (np.arange(400_000) + 0.5) * (0.5 / PERIOD / 400_000)
    m = 20
    transfer = np.sin(np.pi * frequency * m * PERIOD) ** 4 / (m * np.sin(np.pi * frequency * PERIOD)) ** 2
    density = term_spectra(frequency, PERIOD)[TERMS.index(name)]
    integral = 4.0 * np.sum(density * transfer) * (frequency[1] - frequency[0])
    assert integral == pytest.approx(allan_variance({name: 1.0}, np.array([m * PERIOD]), PERIOD)[name][0], rel=5e-3)


def test_maximum_is_where_a_general_optimiser_finds_it():
    bands = band_spectrum([draw(np.random.default_rng(3), 20_000, PERIOD, white=1.0, walk=0.3, ramp=0.02)], PERIOD)
    fit = maximise(bands, ["white", "walk"])

    def loss(logs):
        S = np.exp(logs) @ term_spectra(bands.frequency, PERIOD)[[1, 3]]
        s = np.sum(bands.ramp**2 / S)
        ramp = np.sum(bands.ramp * bands.root / S) / s
        power = bands.power + np.where(bands.ramp != 0.0, (bands.root - ramp * bands.ramp) ** 2 - bands.root**2, 0.0)
        return 0.5 * np.sum(bands.count * (np.log(S) + power / S)) + 0.5 * np.log(s)

    found = optimize.minimize(loss, np.log([0.5, 0.5]), method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 1e-10})
    np.testing.assert_allclose(np.log(fit.squares), found.x, atol=1e-3)
    assert fit.log_likelihood == pytest.approx(-found.fun, abs=1e-4)


def test_covariance_is_the_inverse_information_of_the_restricted_likelihood():
    """Eq. (7) with the projector written out as a matrix."""
    bands = band_spectrum([draw(np.random.default_rng(3), 400, PERIOD, white=1.0, walk=1.0)], PERIOD)
    fit = maximise(bands, ["white", "walk"])
    single = bands.count == 1.0
    shapes = term_spectra(bands.frequency, PERIOD)[[1, 3]]
    w = 1.0 / (fit.squares @ shapes)
    r = bands.ramp
    P = np.diag(w) - np.outer(w * r, w * r) / np.sum(w * r**2)
    repeated = np.where(single, 0.0, bands.count - 1.0)  # coefficients of a band beyond its first
    information = np.array(
        [[0.5 * np.trace(P * a @ P * b) + 0.5 * np.sum(repeated * w**2 * a * b) for a in shapes] for b in shapes]
    ) * np.outer(fit.squares, fit.squares)
    np.testing.assert_allclose(fit.log_covariance, np.linalg.inv(information), rtol=1e-6)


def test_white_noise_and_walk_are_recovered_within_their_sigmas():
    channels = fits({"white": 1.0, "walk": 0.3}, n=60_000, seeds=range(25))
    assert_calibrated(normalised_errors(channels, "white", 1.0), 25)
    assert_calibrated(normalised_errors(channels, "walk", 0.3), 18)
    filters = np.array([(c.walk_of_filter.value, c.walk_of_filter.sigma) for c in channels]).T
    assert_calibrated(np.log(filters[0] / 0.3) * filters[0] / filters[1], 25)
    assert sum(channel.term("flicker").value is not None for channel in channels) <= 1


def test_flicker_and_white_noise_are_recovered_within_their_sigmas():
    channels = fits({"white": 1.0, "flicker_b": 0.6}, n=60_000, seeds=range(30))
    assert_calibrated(normalised_errors(channels, "white", 1.0), 30)
    assert_calibrated(normalised_errors(channels, "flicker", 0.6), 24)
    assert sum(channel.term("walk").value is not None for channel in channels) <= 1


@pytest.mark.slow
def test_all_three_are_recovered_where_the_record_shows_them():
    truth = {"white": 1.0, "flicker_b": 1.0, "walk": 0.5}
    channels = fits(truth, n=200_000, seeds=range(20), period=0.02)
    for name, least in (("white", 20), ("flicker", 12), ("walk", 18)):
        assert_calibrated(normalised_errors(channels, name, truth[NAMES[name]]), least)


def test_quantisation_and_ramp_do_not_leak_into_the_others():
    truth = {"white": 1.0, "walk": 0.3, "quantisation": 0.02, "ramp": 0.5}
    channels = fits(truth, n=60_000, seeds=range(30))
    for name, least in (("white", 30), ("walk", 22), ("quantisation", 30)):
        assert_calibrated(normalised_errors(channels, name, truth[name]), least)
    ramps = [channel.term("ramp") for channel in channels]
    shown = [(t.value - 0.5) / t.sigma for t in ramps if t.value is not None]
    assert len(shown) >= 28
    assert np.mean(np.square(shown)) < stats.chi2.ppf(0.999, len(shown)) / len(shown)


def test_what_a_record_does_not_show_gets_a_bound_and_no_number():
    short = fits({"white": 1.0, "walk": 0.01}, n=6_000, seeds=range(20))
    assert all(channel.term("walk").value is None and channel.term("flicker").value is None for channel in short)
    assert np.mean([channel.term("walk").upper > 0.01 for channel in short]) >= 0.9
    # A longer record without a walk bounds it more tightly.
    long = fits({"white": 1.0}, n=60_000, seeds=range(5))
    bounds = [np.median([channel.term("walk").upper for channel in channels]) for channels in (short, long)]
    assert bounds[1] < 0.1 * bounds[0]


@pytest.mark.slow
def test_bounds_hold_as_often_as_they_say():
    channels = fits({"white": 1.0, "walk": 0.05}, n=60_000, seeds=range(60))
    held = np.mean([channel.term("walk").upper > 0.05 for channel in channels])
    assert held > 0.85  # 95 % asymptotically; with few degrees of freedom a little less


def test_flicker_and_walk_that_look_alike_are_not_told_apart():
    channels = fits({"white": 1.0, "walk": 0.05}, n=60_000, seeds=range(12))
    unclear = [channel for channel in channels if not channel.told_apart]
    assert unclear
    for channel in unclear:
        assert channel.term("walk").value is None and channel.term("flicker").value is None
        assert channel.walk_of_filter.value is not None
        assert {"walk", "flicker"} <= set(channel.model)


def test_narrow_peaks_are_left_out_and_named(rng):
    t = PERIOD * np.arange(60_000)
    hum = 3.0 * np.sin(2.0 * np.pi * (23.45 * t + 0.002 * np.cumsum(rng.normal(size=len(t)))))
    channel = fit_channel(band_spectrum([draw(rng, 60_000, PERIOD, white=1.0) + hum], PERIOD))
    assert channel.term("white").value == pytest.approx(1.0, rel=0.02)
    assert any(abs(line - 23.45) < 0.1 for line in channel.lines)


def test_low_pass_of_the_sensor_does_not_lower_the_white_noise(rng):
    signal = draw(rng, 60_003, PERIOD, white=1.0)
    smooth = 0.25 * signal[:-3] + 0.25 * signal[1:-2] + 0.25 * signal[2:-1] + 0.25 * signal[3:]
    channel = fit_channel(band_spectrum([smooth], PERIOD))
    assert channel.top < 14.0
    assert channel.term("white").value == pytest.approx(1.0, rel=0.08)


def test_silent_channel_tells_nothing():
    channel = fit_channel(band_spectrum([np.full(500, 2.5)], PERIOD))
    assert channel.model == {} and all(term.value is None for term in channel.terms)


@pytest.mark.parametrize("n", [3, 4, 9, 40, 130, 200])
def test_short_records_give_finite_answers(rng, n):
    channel = fit_channel(band_spectrum([rng.normal(size=n)], PERIOD))
    white = channel.term("white")
    assert white.value is not None and np.isfinite(white.sigma)
    assert all(np.isfinite(term.upper) for term in channel.terms)
