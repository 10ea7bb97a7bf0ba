"""The chi-square distribution against closed forms, tables and scipy."""

import math

import pytest
from scipy import stats

from heliograph.chi_square import chi_square_cdf, chi_square_quantile
from heliograph.errors import DataError


def test_chi_square_of_two_degrees_is_the_exponential():
    for x in (1e-6, 0.3, 2.0, 9.0, 40.0):
        assert chi_square_cdf(x, 2) == pytest.approx(1.0 - math.exp(-x / 2.0), rel=1e-13)
    assert chi_square_cdf(-1.0, 3) == 0.0


@pytest.mark.parametrize("dof", [1, 1.4, 2, 3, 6, 7.25, 9, 15, 100, 1000])
@pytest.mark.parametrize("probability", [1e-6, 0.01, 0.5, 0.95, 0.99, 0.9999])
def test_chi_square_quantile_agrees_with_scipy(dof, probability):
    x = chi_square_quantile(probability, dof)
    assert x == pytest.approx(stats.chi2.ppf(probability, dof), rel=1e-10)
    assert chi_square_cdf(x, dof) == pytest.approx(stats.chi2.cdf(x, dof), rel=1e-11)


@pytest.mark.parametrize(("probability", "dof"), [(0.0, 3), (1.0, 3), (math.nan, 3), (0.9, 0)])
def test_chi_square_quantile_names_what_is_out_of_range(probability, dof):
    with pytest.raises(DataError, match="0 < probability < 1"):
        chi_square_quantile(probability, dof)
