"""When a run is to begin anew: its scans find no place, or only one that the IMU contradicts."""

import pytest

from fakes import make_result
from heliograph.checks import RunWatch
from heliograph.config import CheckConfig
from heliograph.data import Event

DISPUTED = (Event(code="match-against-imu", message="a match that the IMU does not allow"),)


def watched(disputed, scans=60, sensors=frozenset({"lidar", "imu"}), **changes):
    """A watch over scans of which a share is disputed."""
    watch = RunWatch(sensors, CheckConfig())
    for k in range(scans):
        watch.add(make_result(k, **(changes if k % 10 < 10 * disputed else {})))
    return watch


@pytest.mark.parametrize("how", [{"events": DISPUTED}, {"status": "lost"}])
def test_a_run_whose_scans_are_disputed_is_to_begin_anew(how):
    assert watched(0.5, **how).contradicted
    assert not watched(0.1, **how).contradicted


def test_nothing_is_disputed_before_there_is_enough_of_it_or_without_an_imu():
    assert not watched(1.0, scans=20, events=DISPUTED).contradicted
    assert not watched(1.0, sensors=frozenset({"lidar"}), events=DISPUTED).contradicted


def test_a_run_that_is_far_does_not_begin_anew():
    assert not watched(1.0, scans=700, events=DISPUTED).contradicted
