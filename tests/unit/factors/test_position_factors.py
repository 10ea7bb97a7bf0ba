"""Factors of positions and velocities obey the law of factors."""

import pytest

from heliograph.factors import LeverArmPosition, Velocity
from heliograph.factors.positions import LeverArmPositionOnArm
from heliograph.testing import assert_factor


@pytest.mark.parametrize(("factor", "vectors"), [(LeverArmPosition, 2), (LeverArmPositionOnArm, 1), (Velocity, 1)])
def test_position_factor_obeys_the_law(rng, factor, vectors):
    assert_factor(factor, rng, lambda rng, count: list(rng.normal(scale=5.0, size=(vectors, count, 3))))
