"""The law of robust kernels holds for the textbook ones and catches mistakes in them."""

import numpy as np
import pytest

from heliograph.testing import assert_jacobian, assert_robust_kernel


class LeastSquares:
    def cost(self, r):
        return 0.5 * r * r

    def weight(self, r):
        return np.ones_like(r)


class Huber:
    def cost(self, r):
        a = np.abs(r)
        return np.where(a <= 1.3, 0.5 * a * a, 1.3 * (a - 0.65))

    def weight(self, r):
        return 1.3 / np.maximum(np.abs(r), 1.3)


class Cauchy:
    def cost(self, r):
        return 0.5 * np.log1p(r * r)

    def weight(self, r):
        return 1.0 / (1.0 + r * r)


class GemanMcClure:
    def cost(self, r):
        return 0.5 * r * r * 4.0 / (4.0 + r * r)

    def weight(self, r):
        return (4.0 / (4.0 + r * r)) ** 2


class WeightOfAnother(Cauchy):
    def weight(self, r):
        return 1.0 / np.sqrt(1.0 + r * r)


class OneSided(Cauchy):
    def cost(self, r):
        return np.where(r > 0, 0.5 * np.log1p(r * r), 0.5 * r * r)


class TwiceTooLarge(LeastSquares):
    def cost(self, r):
        return r * r

    def weight(self, r):
        return 2.0 * np.ones_like(r)


class Steeper(LeastSquares):
    def cost(self, r):
        return 0.5 * r * r + r**4

    def weight(self, r):
        return 1.0 + 4.0 * r * r


@pytest.mark.parametrize("kernel", [LeastSquares(), Huber(), Cauchy(), GemanMcClure()])
def test_kernel_obeys_the_law(kernel):
    assert_robust_kernel(kernel)


@pytest.mark.parametrize("kernel", [WeightOfAnother(), OneSided(), TwiceTooLarge(), Steeper()])
def test_law_catches_a_wrong_kernel(kernel):
    with pytest.raises(AssertionError):
        assert_robust_kernel(kernel)


def test_jacobian_law_catches_a_wrong_sign(rng):
    A, x = rng.normal(size=(3, 4)), rng.normal(size=4)
    assert_jacobian(lambda y: np.sin(A @ y), x, np.cos(A @ x)[:, None] * A)
    with pytest.raises(AssertionError, match="Jacobian"):
        assert_jacobian(lambda y: np.sin(A @ y), x, -np.cos(A @ x)[:, None] * A)
