"""The same walk as every driver would have recorded it: the same trajectory, with no option given."""

import numpy as np
import pytest

from heliograph import pipeline
from heliograph.config import RunConfig
from heliograph.io import open_recording
from heliograph.output.sink import Sink
from heliograph.sim import find_scenario
from heliograph.sim.layouts import LAYOUTS
from heliograph.sim.write import write_recording

FULL = find_scenario("warehouse")
SHORT = FULL.thinned(beams=16, columns=256, duration=6.0).varied(walk={"rest": 2.0})
OTHERS = [name for name in LAYOUTS if name != "ouster"]


class Poses(Sink):
    """Keeps the ends of the scans and the poses there."""

    def __init__(self):
        self.ends_ns, self.T = [], []

    def observe(self, message):
        pass

    def add(self, result):
        self.ends_ns.append(result.end_ns)
        self.T.append(result.T_odom_imu)

    def close(self, summary):
        pass


def estimate(folder, scenario, layout):
    """Simulate in a layout and run without options; return stamps [ns], poses and the codes of the warnings."""
    recorded = write_recording(folder, scenario, seed=1, layout=layout, compress=False).folder
    kept = Poses()
    with open_recording(recorded) as recording:
        summary = pipeline.run(recording, RunConfig(), sinks=[kept])
    codes = {event.code for event in summary.events if event.severity != "info"}
    return np.array(kept.ends_ns), np.array(kept.T), codes


def assert_same(found, expected):
    ends_ns, T, codes = found
    assert np.abs(ends_ns - expected[0]).max() < 1000
    assert np.linalg.norm(T[:, :3, 3] - expected[1][:, :3, 3], axis=1).max() < 1e-3
    np.testing.assert_allclose(T[:, :3, :3], expected[1][:, :3, :3], atol=1e-3)
    return codes


@pytest.fixture(scope="module")
def short_walk(tmp_path_factory):
    walk = estimate(tmp_path_factory.mktemp("ouster"), SHORT, "ouster")
    assert np.linalg.norm(walk[1][-1][:3, 3]) > 1.5
    assert walk[2] == set()
    return walk


@pytest.mark.parametrize("layout", OTHERS)
def test_short_walk_is_the_same_in_layout(layout, short_walk, tmp_path):
    codes = assert_same(estimate(tmp_path, SHORT, layout), short_walk)
    assert codes == ({"no-point-time"} if layout == "no-time" else set())


@pytest.fixture(scope="module")
def lap(tmp_path_factory):
    return estimate(tmp_path_factory.mktemp("ouster"), FULL, "ouster")


@pytest.mark.slow
@pytest.mark.parametrize("layout", OTHERS)
def test_lap_is_the_same_in_layout(layout, lap, tmp_path):
    assert_same(estimate(tmp_path, FULL, layout), lap)
