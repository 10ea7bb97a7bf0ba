"""What happens to a scan around its update: thinning to a number of points."""

from dataclasses import replace

import numpy as np
import pytest

from heliograph.config import CloudConfig
from heliograph.odometry.filter.matching import Thinning
from states import room_cloud


def picks(target, cloud, count):
    thinning = Thinning(replace(CloudConfig(), target_points=target))
    return [thinning.pick(cloud) for _ in range(count)]


@pytest.fixture
def cloud(rng):
    return room_cloud(rng, 20_000)


def test_thinning_leaves_its_edge_alone_near_the_target(cloud):
    """Equal scans are thinned equally, although the number of points is up to a tenth off."""
    first = len(picks(10, cloud, 1)[0])
    for share in (0.93, 1.07):
        one, *others = picks(round(first / share), cloud, 4)
        assert len(one) == first
        for other in others:
            np.testing.assert_array_equal(other, one)


@pytest.mark.parametrize("factor", [0.2, 0.85, 1.2, 3.0])
def test_thinning_comes_to_the_target_and_stays(cloud, factor):
    target = round(factor * len(picks(10, cloud, 1)[0]))
    one, *others = picks(target, cloud, 10)
    assert len(others[0]) != len(one)
    assert abs(len(others[-1]) / target - 1.0) < 0.1
    np.testing.assert_array_equal(others[-1], others[-2])
