"""The law of odometries holds for the filter, and catches who breaks it."""

from dataclasses import replace

import numpy as np
import pytest

from heliograph.config import RunConfig
from heliograph.data import Event, ImuBatch, Scan
from heliograph.odometry import Odometry, make_odometry, pose_result
from heliograph.sim import SCENARIOS, simulate
from heliograph.testing import assert_odometry


@pytest.fixture(scope="module")
def simulation():
    return simulate(SCENARIOS["room"].thinned(beams=16, columns=96, duration=1.7), seed=1)


@pytest.mark.parametrize("sensors", ["lidar,imu", "lidar", "imu"])
def test_filter_obeys_the_law_of_odometries(simulation, sensors):
    names = frozenset(sensors.split(","))
    kinds = {"lidar": Scan, "imu": ImuBatch}
    messages = [m for m in simulation if isinstance(m, tuple(kinds[name] for name in names))]
    assert_odometry(lambda: make_odometry(RunConfig(), simulation.rig, names, 1), messages)


@pytest.mark.parametrize("sensors", ["lidar,imu", "lidar", "imu"])
def test_loam_obeys_the_law_of_odometries(sensors):
    simulation = simulate(SCENARIOS["room"].thinned(beams=16, columns=256, duration=1.7), seed=1)
    names = frozenset(sensors.split(","))
    kinds = {"lidar": Scan, "imu": ImuBatch}
    messages = [m for m in simulation if isinstance(m, tuple(kinds[name] for name in names))]
    assert_odometry(lambda: make_odometry(RunConfig(odometry="loam"), simulation.rig, names, 1), messages)


class Standing(Odometry):
    """Stands still, and says so scan by scan."""

    def __init__(self):
        self.events, self.last, self.count = [], None, 0

    def add(self, message):
        if not isinstance(message, Scan):
            return []
        self.last = pose_result(message, self.count, np.eye(4), before=self.last)
        self.count += 1
        return [self.last]


class Waiting(Standing):
    """Gives everything at the end, again and again."""

    def __init__(self):
        super().__init__()
        self.results = []

    def add(self, message):
        self.results += super().add(message)
        return []

    def finish(self):
        return self.results


class Dropping(Standing):
    def add(self, message):
        results = super().add(message)
        return results if self.count != 5 else []


class ByTheBatch(Standing):
    """Its pose depends on how the driver cut the IMU's samples."""

    batches = 0

    def add(self, message):
        self.batches += isinstance(message, ImuBatch)
        shift = np.eye(4)
        shift[0, 3] = 1e-9 * self.batches
        return [replace(r, T_odom_imu=r.T_odom_imu @ shift) for r in super().add(message)]


SEEN = []


class Shared(Standing):
    """Counts in a place that all instances share."""

    def add(self, message):
        SEEN.append(message)
        return [replace(r, rms=float(len(SEEN))) for r in super().add(message)]


class Forgetful(Standing):
    def add(self, message):
        self.events = [Event(code="n", message=str(self.count))]
        return super().add(message)


class Backwards(Standing):
    def add(self, message):
        return [replace(r, end_ns=r.end_ns - 10**9 * (r.index == 3)) for r in super().add(message)]


class Mirrored(Standing):
    def add(self, message):
        return [replace(r, T_odom_imu_header=np.diag([1.0, 1.0, -1.0, 1.0])) for r in super().add(message)]


class Upright(Standing):
    def leveling(self):
        return np.full((4, 4), np.nan)


class Late(Standing):
    """After a break it waits for the stamps to be even again, for ever."""

    def add(self, message):
        if isinstance(message, Scan) and self.last is not None and message.stamp_ns - self.last.end_ns > 10**8:
            return []
        return super().add(message)


class Inventive(Standing):
    def finish(self):
        return [] if self.last is not None else [pose_result(self.scan, 0, np.eye(4))]

    def __init__(self):
        super().__init__()
        self.scan = next(iter(simulate(SCENARIOS["room"].thinned(beams=2, columns=8, duration=0.3), 1).sweeps())).scan()


def test_law_of_odometries_accepts_the_least_that_keeps_it(simulation):
    assert_odometry(Standing, list(simulation))


@pytest.mark.parametrize(
    ("violator", "words"),
    [
        (Waiting, "a second finish has results"),
        (Dropping, "indices are not 0, 1, 2"),
        (ByTheBatch, "T_odom_imu of result .* not the same to the bit"),
        (Shared, "rms of result .* not the same to the bit"),
        (Forgetful, "an event was taken back"),
        (Backwards, "ends no later than the one before"),
        (Mirrored, "reflection"),
        (Upright, "leveling"),
        (Late, "scans gave"),
        (Inventive, "without a message has results"),
    ],
)
def test_law_of_odometries_catches(simulation, violator, words):
    with pytest.raises(AssertionError, match=words):
        assert_odometry(violator, list(simulation))
