"""Kernels: the law of robust kernels, and the published values."""

import numpy as np
import pytest

from heliograph.errors import GraphError
from heliograph.graph import DCS, Cauchy, GemanMcClure, Huber, TruncatedLeastSquares, Tukey
from heliograph.testing import assert_robust_kernel
from native_factors import evaluate
from reference import factors as twin

KERNELS = [Huber, Cauchy, GemanMcClure, Tukey, DCS, TruncatedLeastSquares]


@pytest.mark.parametrize("width", [0.5, 1.345, 4.6])
@pytest.mark.parametrize("kernel", KERNELS)
def test_kernel_obeys_the_law(kernel, width):
    assert_robust_kernel(kernel(width))


def test_codes_are_those_of_the_native_side():
    assert [kernel.code for kernel in KERNELS] == [1, 2, 3, 4, 5, 6]


@pytest.mark.parametrize(
    ("kernel", "residual", "cost", "weight"),
    [
        (Huber(1.0), 3.0, 2.5, 1 / 3),
        (Cauchy(2.0), 2.0, 2.0 * np.log(2.0), 0.5),
        (GemanMcClure(2.0), 2.0, 1.0, 0.25),
        (Tukey(2.0), 3.0, 4.0 / 6.0, 0.0),
        (DCS(1.0), np.sqrt(3.0), 1.0, 0.25),
        (TruncatedLeastSquares(2.0), 3.0, 2.0, 0.0),
    ],
)
def test_kernel_values(kernel, residual, cost, weight):
    np.testing.assert_allclose([kernel.cost(residual), kernel.weight(residual)], [cost, weight], rtol=1e-14)


@pytest.mark.parametrize("width", [0.0, -1.0, np.nan, np.inf])
@pytest.mark.parametrize("kernel", KERNELS)
def test_a_width_that_is_none_is_refused(kernel, width):
    with pytest.raises(GraphError, match="width"):
        kernel(width)


@pytest.mark.parametrize("width", [0.5, 1.345, 4.6])
@pytest.mark.parametrize("kernel", KERNELS)
def test_native_costs_are_those_of_the_kernel(kernel, width):
    one = kernel(width)
    for r in (0.0, 0.3 * width, 0.999 * width, 1.001 * width, 2.0 * width, 30.0 * width):
        found = evaluate(twin.PRIOR, [(twin.VECTOR, 1)], [[np.array([r])]], [np.zeros(1)], kernel=one.code, width=width)
        assert found.chi2 == found.linearized_chi2 == r * r
        expected = pytest.approx(2.0 * one.cost(r), rel=1e-13, abs=1e-300)
        assert found.cost == expected
        assert found.linearized_cost == expected
