"""The law of sinks holds for what a run writes and shows, and catches who breaks it."""

import itertools

import numpy as np
import pytest

from heliograph.cli.progress import ProgressSink
from heliograph.config import OutputConfig
from heliograph.output import Sink
from heliograph.output.run_folder import RunFolder
from heliograph.report import write_report
from heliograph.testing import assert_sink


@pytest.mark.parametrize("threaded", [False, True])
@pytest.mark.parametrize("finishers", [(), (write_report,)], ids=["files", "report"])
def test_run_folder_obeys_the_law_of_sinks(tmp_path, threaded, finishers):
    number = itertools.count()

    def make_sink():
        return RunFolder(
            tmp_path / f"run{next(number)}", name="law", config="", output=OutputConfig(), T_imu_body=np.eye(4),
            threaded=threaded, finishers=finishers,
        )  # fmt: skip

    assert_sink(make_sink)


def test_progress_obeys_the_law_of_sinks(capsys):
    assert_sink(lambda: ProgressSink(12, "law"))


def test_law_of_sinks_accepts_one_that_does_nothing():
    assert_sink(type("Nothing", (Sink,), {}))


class Eager(Sink):
    """Takes for granted that there is a scan."""

    def __init__(self):
        self.heights = []

    def add(self, result):
        self.heights.append(result.T_odom_imu[2, 3])

    def close(self, summary):
        self.mean = sum(self.heights) / len(self.heights)


class Strict(Sink):
    """Takes a failed run for its own failure."""

    def close(self, summary):
        if summary.failure:
            raise RuntimeError(summary.failure)


class Averaging(Sink):
    """Takes for granted that a scan has points."""

    def add(self, result):
        self.lowest = result.points_imu[:, 2].min()


class Careless(Sink):
    """Changes the points that others get after it."""

    def add(self, result):
        result.points_imu.flags.writeable = True
        result.points_imu[:] = 0.0


@pytest.mark.parametrize(
    ("violator", "words"),
    [
        (Eager, "a run without a scan: close raised ZeroDivisionError"),
        (Strict, "a run that failed: close raised RuntimeError"),
        (Averaging, "one empty scan: add raised ValueError"),
        (Careless, "changed result 0"),
    ],
)
def test_law_of_sinks_catches(violator, words):
    with pytest.raises(AssertionError, match=words):
        assert_sink(violator)
